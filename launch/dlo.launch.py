# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Starts observer, simulator and identifier for one DLO: seen by a camera, or in a recording.

    ros2 launch dlo_ros dlo.launch.py params_file:=params.yaml
    ros2 launch dlo_ros dlo.launch.py params_file:=params.yaml video_device:=/dev/video0
    ros2 launch dlo_ros dlo.launch.py params_file:=params.yaml bag:=recording
    ros2 launch dlo_ros dlo.launch.py params_file:=left.yaml namespace:=left \
        image:=/camera/image_raw camera_info:=/camera/camera_info
    ros2 launch dlo_ros dlo.launch.py --show-args

A second DLO is a second launch with another namespace.
"""

from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import (
    AndSubstitution,
    LaunchConfiguration,
    NotEqualsSubstitution,
    NotSubstitution,
    OrSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

INPUTS = (
    "image_raw",
    "image_raw/compressed",
    "camera_info",
    "image_mask",
    "dlo/command",
)
SEEN = ("dlo/observed", "dlo/observed_points")
MADE = ("predicted", "err", "young_modulus", "density", "markers", "overlay")


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
            description="take the time from /clock; with bag it is always so",
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
            "video_device",
            default_value="",
            description="camera to start with the package v4l2_camera, such as /dev/video0; "
            "empty: the camera's driver is started elsewhere",
        ),
        DeclareLaunchArgument(
            "camera_info_url",
            default_value="",
            description="intrinsics for that camera, such as file:///path/camera_info.yaml",
        ),
        DeclareLaunchArgument(
            "bag", default_value="", description="folder of a rosbag2 recording that is played"
        ),
        DeclareLaunchArgument(
            "rate", default_value="1.0", description="speed of the recording, 1 is as recorded"
        ),
        DeclareLaunchArgument(
            "observe",
            default_value="true",
            description="with bag; true: the observer makes the splines from the images; "
            "false: the recorded ones are played",
        ),
        DeclareLaunchArgument(
            "stay",
            default_value="true",
            description="with bag; whether the nodes go on after the recording's end",
        ),
        DeclareLaunchArgument(
            "rviz", default_value="false", description="whether RViz shows curves and overlay"
        ),
        DeclareLaunchArgument(
            "large_images",
            default_value="false",
            description="larger shared memory of Fast DDS, for raw images of 1 Mpx and more; "
            "the camera driver's process needs the same profile",
        ),
        DeclareLaunchArgument(
            "enclave",
            default_value="/dlo",
            description="SROS2: the nodes use ENCLAVE/observer and so on; without it of no effect",
        ),
        DeclareLaunchArgument("log_level", default_value="info", description="of all nodes"),
    ]
    namespace, image = LaunchConfiguration("namespace"), LaunchConfiguration("image")
    info, bag = LaunchConfiguration("camera_info"), LaunchConfiguration("bag")
    stay = LaunchConfiguration("stay")
    plays = NotEqualsSubstitution(bag, "")
    sim_time = {"use_sim_time": OrSubstitution(LaunchConfiguration("use_sim_time"), plays)}
    camera = [
        ("image_raw", image),
        ("image_raw/compressed", [image, "/compressed"]),
        ("camera_info", info),
    ]
    nodes = [
        Node(
            package="dlo_ros",
            executable=name,
            namespace=namespace,
            output="screen",
            parameters=[LaunchConfiguration("params_file"), sim_time],
            remappings=camera if name == "observer" else [],
            ros_arguments=[
                "--log-level",
                LaunchConfiguration("log_level"),
                "--enclave",
                [LaunchConfiguration("enclave"), f"/{name}"],
            ],
        )
        for name in ("observer", "simulator", "identifier")
    ]
    driver = Node(
        package="v4l2_camera",
        executable="v4l2_camera_node",
        namespace=namespace,
        output="screen",
        parameters=[
            {
                name: ParameterValue(LaunchConfiguration(name), value_type=str)
                for name in ("video_device", "camera_info_url")
            }
        ],
        remappings=camera,
        condition=IfCondition(NotEqualsSubstitution(LaunchConfiguration("video_device"), "")),
    )
    # A recording's topics go into the namespace. What nodes made when it was recorded is made
    # anew, so it is set aside; the recorded splines too where the observer makes them.
    observe = LaunchConfiguration("observe")
    into = [(f"/{topic}", [namespace, f"/{topic}"]) for topic in INPUTS]
    aside = [(f"/dlo/{name}", [namespace, f"/recorded/dlo/{name}"]) for name in MADE]
    players = [
        Node(
            package="dlo_ros",
            executable="play",
            output="screen",
            arguments=[bag, "--rate", LaunchConfiguration("rate")],
            remappings=[*into, *aside]
            + [(f"/{topic}", [namespace, f"{prefix}/{topic}"]) for topic in SEEN],
            condition=IfCondition(AndSubstitution(plays, wanted)),
            on_exit=[
                Shutdown(
                    reason="the recording has ended", condition=IfCondition(NotSubstitution(stay))
                )
            ],
        )
        for prefix, wanted in (("/recorded", observe), ("", NotSubstitution(observe)))
    ]
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=namespace,
        arguments=["-d", PathJoinSubstitution([share, "config", "dlo.rviz"])],
        parameters=[sim_time],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    memory = SetEnvironmentVariable(
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        PathJoinSubstitution([share, "config", "fastdds_large_images.xml"]),
        condition=IfCondition(LaunchConfiguration("large_images")),
    )
    return LaunchDescription([*arguments, memory, *nodes, driver, *players, rviz])
