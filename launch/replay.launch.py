# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Plays a recording with /clock to the nodes, with RViz where there is one, and ends with it.

    ros2 launch dlo_ros replay.launch.py bag:=recording params_file:=params.yaml
    ros2 launch dlo_ros replay.launch.py bag:=recording params_file:=params.yaml \
        rviz:=false observe:=false rate:=0.5 namespace:=left

It is dlo.launch.py with other defaults.
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    share = FindPackageShare("dlo_ros")
    arguments = {
        "bag": DeclareLaunchArgument("bag", description="folder of a rosbag2 recording"),
        "params_file": DeclareLaunchArgument(
            "params_file",
            default_value="",
            description="ROS 2 parameter file of the nodes; "
            "empty: the bundled example rope, not yours",
        ),
        "namespace": DeclareLaunchArgument(
            "namespace", default_value="", description="namespace of the nodes and their topics"
        ),
        "image": DeclareLaunchArgument(
            "image", default_value="image_raw", description="topic of the recorded images"
        ),
        "camera_info": DeclareLaunchArgument(
            "camera_info", default_value="camera_info", description="topic of the intrinsics"
        ),
        "rate": DeclareLaunchArgument(
            "rate", default_value="1.0", description="speed, 1 is that of the recording"
        ),
        "wait": DeclareLaunchArgument(
            "wait",
            default_value="600.0",
            description="seconds to wait at most for the nodes to be ready, "
            "which compile their kernels at the first start",
        ),
        "clock": DeclareLaunchArgument(
            "clock",
            default_value="clock",
            description="topic of the recording's time, one for each namespace",
        ),
        "observe": DeclareLaunchArgument(
            "observe",
            default_value="auto",
            description="true: the observer makes the splines from the images; "
            "false: the recorded ones are played, without images and observer; "
            "auto: true where the recording has images",
        ),
        "stay": DeclareLaunchArgument(
            "stay",
            default_value="false",
            description="whether the nodes go on after the recording's end",
        ),
        "rviz": DeclareLaunchArgument(
            "rviz",
            default_value="auto",
            description="whether RViz shows curves and overlay; "
            "auto: where rviz2 is installed and there is a display",
        ),
        "large_images": DeclareLaunchArgument(
            "large_images",
            default_value="false",
            description="larger shared memory of Fast DDS, for raw images of 1 Mpx and more",
        ),
    }
    dlo = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([share, "launch", "dlo.launch.py"])),
        launch_arguments={name: LaunchConfiguration(name) for name in arguments}.items(),
    )
    return LaunchDescription([*arguments.values(), dlo])
