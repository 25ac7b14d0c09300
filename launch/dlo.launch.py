# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Starts observer, simulator and identifier for one DLO: seen by a camera, or in a recording.

    ros2 launch dlo_ros dlo.launch.py params_file:=params.yaml
    ros2 launch dlo_ros dlo.launch.py params_file:=params.yaml video_device:=/dev/video0
    ros2 launch dlo_ros dlo.launch.py params_file:=params.yaml bag:=recording
    ros2 launch dlo_ros dlo.launch.py params_file:=left.yaml namespace:=left \
        image:=/camera/image_raw camera_info:=/camera/camera_info
    ros2 launch dlo_ros dlo.launch.py --show-args

A second DLO is a second launch with another namespace. All arguments are checked before anything
starts. A process that ends with an error ends the launch, whose exit status is then 1.
"""

import os
from pathlib import Path

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable, Shutdown
from launch.logging import get_logger
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

SHARE = Path(__file__).parent.parent
EXAMPLE = SHARE / "config" / "default.yaml"

INPUTS = (
    "image_raw",
    "image_raw/compressed",
    "camera_info",
    "depth/image_raw",
    "image_mask",
    "dlo/command",
    "dlo/points",
    "dlo/start_pose",
    "dlo/end_pose",
    "dlo/wrench_start",
    "dlo/wrench_end",
)
SEEN = ("dlo/observed", "dlo/observed_points")
INTERRUPTED = (-2, 130)
"""Statuses of a process that Ctrl-C has ended."""
MADE = (
    "predicted", "force_start", "force_end", "tension", "min_bend_radius", "rehearsal_command",
    "rehearsal", "err", "young_modulus", "density", "metrics", "markers", "overlay",
)  # fmt: skip
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
SHOWN_CAMERAS = ("left", "right")
"""Cameras whose overlays config/dlo_space.rviz shows, by the names that they have there."""
NO_CAMERA = ("/dlo/overlay", "/image_mask")
"""Images of a recording that the observer finds no DLO in."""

ARGUMENTS = (
    DeclareLaunchArgument(
        "params_file",
        default_value="",
        description="ROS 2 parameter file with at least length, diameter, E and density; "
        "empty: the bundled example rope, not yours",
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
        "wait",
        default_value="600.0",
        description="with bag: seconds to wait at most for the nodes to be ready, "
        "which compile their kernels at the first start",
    ),
    DeclareLaunchArgument(
        "clock",
        default_value="clock",
        description="with bag: topic of the recording's time, one for each namespace",
    ),
    DeclareLaunchArgument(
        "observe",
        default_value="auto",
        description="true: the observer makes the splines from the images; false: no observer "
        "is started, and with bag the recorded splines are played, without images; "
        "auto: true, with bag where the recording has images",
    ),
    DeclareLaunchArgument(
        "stay",
        default_value="true",
        description="with bag; whether the nodes go on after the recording's end",
    ),
    DeclareLaunchArgument(
        "rviz",
        default_value="false",
        description="whether RViz shows curves and overlay; "
        "auto: where rviz2 is installed and there is a display",
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
)


def generate_launch_description():
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=start)])


def start(context):
    """Check the arguments and name what is started; raises before anything runs."""
    given = context.launch_configurations
    namespace, bag = given["namespace"], given["bag"]
    parameters = parameter_file(given["params_file"])
    observes = observe(given["observe"], bag)
    rviz = with_rviz(given["rviz"])
    if given["video_device"]:
        demand("v4l2_camera", "video_device")
    sim_time = {"use_sim_time": bool(bag) or switch("use_sim_time", given["use_sim_time"])}
    clock = [("/clock", given["clock"])] if bag else []
    camera = [
        ("image_raw", given["image"]),
        ("image_raw/compressed", f"{given['image']}/compressed"),
        ("camera_info", given["camera_info"]),
    ]
    names = ["observer", "simulator", "identifier"] if observes else ["simulator", "identifier"]
    actions = [
        Node(
            package="dlo_ros",
            executable=name,
            namespace=namespace,
            output="screen",
            parameters=[str(parameters), sim_time],
            remappings=[*clock, *(camera if name == "observer" else [])],
            ros_arguments=[
                "--log-level",
                given["log_level"],
                "--enclave",
                f"{given['enclave']}/{name}",
            ],
            on_exit=required(name),
        )
        for name in names
    ]
    if given["video_device"]:
        texts = {
            name: ParameterValue(given[name], value_type=str)
            for name in ("video_device", "camera_info_url")
        }
        actions.append(
            Node(
                package="v4l2_camera",
                executable="v4l2_camera_node",
                namespace=namespace,
                output="screen",
                parameters=[texts],
                remappings=camera,
                on_exit=required("v4l2_camera_node"),
            )
        )
    if bag:
        actions.append(player(given, names, clock))
    if rviz:
        view, overlays = rviz_view(parameters)
        actions.append(
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=namespace,
                arguments=["-d", str(view)],
                parameters=[sim_time],
                remappings=[*clock, *overlays],
            )
        )
    if switch("large_images", given["large_images"]):
        profile = SHARE / "config" / "fastdds_large_images.xml"
        actions.insert(0, SetEnvironmentVariable("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile)))
    return actions


def player(given, names, clock):
    """The process that plays the recording once the named nodes are ready.

    The recording's topics go into the namespace. What nodes made when it was recorded is made anew,
    so it is set aside; the recorded splines too where the observer makes them.
    """
    observes = "observer" in names
    aside = [f"dlo/{name}" for name in MADE] + [*(SEEN if observes else ())]
    here = [*INPUTS, *(() if observes else SEEN)]
    stay = switch("stay", given["stay"])
    return Node(
        package="dlo_ros",
        executable="play",
        namespace=given["namespace"],
        output="screen",
        arguments=[
            given["bag"],
            "--rate",
            given["rate"],
            "--wait",
            given["wait"],
            *(word for name in names for word in ("--wait-for", name)),
            *([] if observes else ["--no-images"]),
        ],
        remappings=[
            *clock,
            *((f"/{topic}", topic) for topic in here),
            *((f"/{topic}", f"recorded/{topic}") for topic in aside),
        ],
        on_exit=required("play", [] if stay else [Shutdown(reason="the recording has ended")]),
    )


def required(name, afterwards=()):
    """What follows the end of a process: an error ends the launch with exit status 1."""

    def ended(event, context):
        if context.is_shutdown:
            return []
        if event.returncode in INTERRUPTED:  # by a Ctrl-C that launch itself has not taken note of
            return [Shutdown(reason=f"{name} was interrupted")]
        if event.returncode:
            raise RuntimeError(f"{name} ended with status {event.returncode}, as it says above")
        return list(afterwards)

    return ended


def parameter_file(given):
    if not given:
        get_logger("dlo_ros").warning(
            "no params_file is given: this is the bundled EXAMPLE rope (0.4 m long, 4 mm thick) "
            f"with the example's camera pose, not yours; copy {EXAMPLE}, "
            "fill it in, and give params_file:=FILE"
        )
        return EXAMPLE
    path = Path(given).expanduser()
    if not path.is_file():
        raise RuntimeError(f"params_file:={given}: no such file; give a ROS 2 parameter file")
    return path


def observe(given, bag):
    """Whether the observer makes the splines: from a camera, or from this recording."""
    if not bag:
        return given == "auto" or switch("observe", given, "auto, ")
    bag = Path(bag)
    if not bag.exists():
        raise RuntimeError(f"bag:={bag}: no such bag; give the folder of a rosbag2 recording")
    kinds = recorded(bag)
    images = any(k in IMAGES and not topic.endswith(NO_CAMERA) for topic, k in kinds.items())
    splines = any(topic.endswith("/dlo/observed") for topic in kinds)
    wanted = images or not splines if given == "auto" else switch("observe", given, "auto, ")
    if kinds and not (images or splines):
        raise RuntimeError(f"bag:={bag}: holds neither images nor dlo/observed")
    if kinds and not (images if wanted else splines):
        raise RuntimeError(
            f"bag:={bag}: holds no {'images' if wanted else 'dlo/observed'}; "
            f"give observe:={str(not wanted).lower()}"
        )
    return wanted


def recorded(bag):
    """Type of each topic of a recording; empty where only its file itself would tell."""
    try:
        content = yaml.safe_load((bag / "metadata.yaml").read_text(encoding="utf-8"))
        counts = content["rosbag2_bagfile_information"]["topics_with_message_count"]
        topics = [item["topic_metadata"] for item in counts if item["message_count"]]
        return {topic["name"]: topic["type"] for topic in topics}
    except (OSError, ValueError, TypeError, LookupError, yaml.YAMLError):
        return {}  # `play` says what is wrong with it


def rviz_view(parameters):
    """RViz's file for one camera or for several, and remappings to the cameras' overlays."""
    cameras = several_cameras(parameters)
    shown = zip(SHOWN_CAMERAS, cameras, strict=False)
    overlays = [(f"{a}/dlo/overlay", f"{b}/dlo/overlay") for a, b in shown if a != b]
    return SHARE / "config" / ("dlo_space.rviz" if cameras else "dlo.rviz"), overlays


def several_cameras(parameters):
    """The parameter `vision.cameras`; empty where the file has none, or is none for nodes."""
    try:
        for own in parameter_blocks(yaml.safe_load(parameters.read_text(encoding="utf-8"))):
            cameras = own.get("vision.cameras") or own.get("vision", {}).get("cameras") or []
            if cameras:
                return [str(name) for name in cameras]
    except (OSError, ValueError, TypeError, LookupError, AttributeError, yaml.YAMLError):
        pass
    return []


def parameter_blocks(tree):
    """The content of each `ros__parameters`, of nodes in nested namespaces, too."""
    for name, content in tree.items():
        if name == "ros__parameters":
            yield content
        elif isinstance(content, dict):
            yield from parameter_blocks(content)


def with_rviz(given):
    if given != "auto":
        if not switch("rviz", given, "auto, "):
            return False
        demand("rviz2", "rviz")
        return True
    missing = None if installed("rviz2") else "rviz2 is not installed"
    if missing is None and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        missing = "there is no display"
    if missing:
        get_logger("dlo_ros").info(f"without RViz: {missing}")
    return missing is None


def demand(package, argument):
    if not installed(package):
        raise RuntimeError(
            f"{argument} needs the package {package}, which is not installed: "
            f"sudo apt install ros-$ROS_DISTRO-{package.replace('_', '-')}"
        )


def installed(package):
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def switch(name, given, other=""):
    values = {"true": True, "1": True, "false": False, "0": False}
    if given.lower() not in values:
        raise RuntimeError(f"{name}:={given}: give {other}true or false")
    return values[given.lower()]
