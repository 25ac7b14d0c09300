"""Starts observer, simulator and identifier, for a camera or for a bag that plays elsewhere.

    ros2 launch dlo_ros dlo.launch.py params_file:=params.yaml
    ros2 launch dlo_ros dlo.launch.py params_file:=left.yaml namespace:=left \
        image:=/camera/image_raw camera_info:=/camera/camera_info
"""

from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    share = FindPackageShare("dlo_ros")
    arguments = [
        DeclareLaunchArgument(
            "params_file",
            default_value=PathJoinSubstitution([share, "config", "default.yaml"]),
            description="ROS 2 parameter file with at least length, diameter, E and density",
        ),
        DeclareLaunchArgument(
            "namespace",
            default_value="",
            description="namespace of the nodes and their topics, one for each DLO",
        ),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="false",
            description="take the time from /clock: true where a bag plays",
        ),
        DeclareLaunchArgument(
            "image",
            default_value="image_raw",
            description="topic of the camera images; IMAGE/compressed is the other transport",
        ),
        DeclareLaunchArgument(
            "camera_info", default_value="camera_info", description="topic of the intrinsics"
        ),
        DeclareLaunchArgument(
            "large_images",
            default_value="false",
            description="larger shared memory of Fast DDS, for raw images of 1 Mpx and more; "
            "the camera driver's process needs the same profile",
        ),
        DeclareLaunchArgument("log_level", default_value="info", description="of all nodes"),
    ]
    common = {
        "package": "dlo_ros",
        "namespace": LaunchConfiguration("namespace"),
        "output": "screen",
        "parameters": [
            LaunchConfiguration("params_file"),
            {"use_sim_time": LaunchConfiguration("use_sim_time")},
        ],
        "ros_arguments": ["--log-level", LaunchConfiguration("log_level")],
    }
    image = LaunchConfiguration("image")
    return LaunchDescription(
        [
            *arguments,
            SetEnvironmentVariable(
                "FASTRTPS_DEFAULT_PROFILES_FILE",
                PathJoinSubstitution([share, "config", "fastdds_large_images.xml"]),
                condition=IfCondition(LaunchConfiguration("large_images")),
            ),
            Node(
                executable="observer",
                remappings=[
                    ("image_raw", image),
                    ("image_raw/compressed", [image, "/compressed"]),
                    ("camera_info", LaunchConfiguration("camera_info")),
                ],
                **common,
            ),
            Node(executable="simulator", **common),
            Node(executable="identifier", **common),
        ]
    )
