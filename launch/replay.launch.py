"""Plays a recording with /clock to the three nodes, with RViz beside it where asked for.

ros2 launch dlo_ros replay.launch.py bag:=recording params_file:=params.yaml rviz:=true
"""

from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    IncludeLaunchDescription,
    RegisterEventHandler,
)
from launch.conditions import IfCondition, UnlessCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    share = FindPackageShare("dlo_ros")
    arguments = [
        DeclareLaunchArgument("bag", description="folder of a rosbag2 recording"),
        DeclareLaunchArgument(
            "params_file",
            default_value=PathJoinSubstitution([share, "config", "default.yaml"]),
            description="ROS 2 parameter file of the nodes",
        ),
        DeclareLaunchArgument(
            "rate", default_value="1.0", description="speed, 1 is that of the recording"
        ),
        DeclareLaunchArgument(
            "observe",
            default_value="true",
            description="true: the observer makes the splines from the images; "
            "false: the recorded ones are played",
        ),
        DeclareLaunchArgument(
            "rviz", default_value="false", description="whether RViz shows curves and overlay"
        ),
        DeclareLaunchArgument(
            "stay",
            default_value="false",
            description="whether the nodes go on after the recording's end",
        ),
    ]
    nodes = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([share, "launch", "dlo.launch.py"])),
        launch_arguments={
            "params_file": LaunchConfiguration("params_file"),
            "use_sim_time": "true",
        }.items(),
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", PathJoinSubstitution([share, "config", "dlo.rviz"])],
        parameters=[{"use_sim_time": True}],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    # What nodes made of it when it was recorded is made anew, so it is set aside; the recorded
    # splines alone are played where the observer is not to be used.
    made = ["predicted", "err", "young_modulus", "density", "markers", "overlay"]
    seen = ["observed", "observed_points"]
    observe = LaunchConfiguration("observe")
    players = [
        Node(
            package="dlo_ros",
            executable="play",
            output="screen",
            arguments=[LaunchConfiguration("bag"), "--rate", LaunchConfiguration("rate")],
            remappings=[(f"/dlo/{name}", f"/recorded/dlo/{name}") for name in aside],
            condition=condition,
        )
        for aside, condition in (
            ([*made, *seen], IfCondition(observe)),
            (made, UnlessCondition(observe)),
        )
    ]
    endings = [
        RegisterEventHandler(
            OnProcessExit(
                target_action=player,
                on_exit=[EmitEvent(event=Shutdown(reason="the recording has ended"))],
            ),
            condition=UnlessCondition(LaunchConfiguration("stay")),
        )
        for player in players
    ]
    return LaunchDescription([*arguments, nodes, rviz, *players, *endings])
