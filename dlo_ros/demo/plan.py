# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The choice of a recording's topics that the demo plays (no ROS here)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dlo_ros.errors import InputError, RecordingError
from dlo_ros.nodes.message_factory import installed
from dlo_ros.parameters import Settings
from dlo_ros.recordings import open_bag, topics

# Topics of cameras; splines that nodes made of them are made anew.
IMAGES = (topics.IMAGE, topics.COMPRESSED)
SPLINES = (topics.OBSERVED, topics.OBSERVED_POINTS)

COMMANDS: Mapping[str, tuple[str, ...]] = {
    "topic": (topics.COMMAND,),
    "tf": (topics.MOVING_TRANSFORMS, topics.TRANSFORMS),
    "pose": (topics.START_POSE, topics.END_POSE, topics.MOVING_TRANSFORMS, topics.TRANSFORMS),
}
"""Topics of the imposed motion, by `command.source`."""


@dataclass(frozen=True)
class LiveRun:
    """The recording, the topics and the parameters of a live run.

    Args:
        bag: the recording.
        duration: duration of the recording [s].
        topics: full names that are played.
        has_images: whether images are among them.
        params: parameter file of the nodes.
        settings: content of the parameter file.
        logs: folder for what the processes print.
    """

    bag: Path
    duration: float
    topics: Sequence[str]
    has_images: bool
    params: Path
    settings: Settings
    logs: Path


def params_beside(bag: Path) -> Path:
    """The parameter file in a bag's folder, or the one beside it.

    Raises:
        RecordingError: there is no such bag.
        InputError: there is none.
    """
    if not bag.exists():
        raise RecordingError(f"{bag}: no such bag; give the folder of a rosbag2 recording")
    for candidate in (bag / "params.yaml", bag.resolve().parent / "params.yaml"):
        if candidate.is_file():
            return candidate
    raise InputError(f"{bag}: has no params.yaml in it or beside it; give one with --params")


def plan_run(bag: Path, params: Path, settings: Settings, logs: Path) -> LiveRun:
    """Choose the topics to play: images where there are some, else observed splines.

    Args:
        bag: the recording.
        params: parameter file of the nodes.
        settings: content of the parameter file; it names the cameras and says where the command
            comes from.
        logs: folder for what the processes print.

    Raises:
        RecordingError: the bag is unusable, or lacks images and splines, or the command.
        InputError: the command comes from /tf, and this machine cannot hear that.
    """
    with open_bag(bag) as recording:

        def held(*wanted: str) -> list[str]:
            # Transforms are those of the whole system, all other topics may have a namespace.
            return [
                c.topic
                for topic in wanted
                for c in (
                    recording.find(topic)
                    if not topic.startswith("/")
                    else [c for c in recording.connections if c.topic == topic and c.msgcount]
                )
            ]

        views = {name: held(*_of_camera(name, IMAGES)) for name in settings.cameras or ("",)}
        missing = next((name for name, found in views.items() if not found), None)
        has_images = missing is None
        if has_images:
            infos = (topics.of_camera(name, topics.CAMERA_INFO) for name in views)
            seen = [*(topic for found in views.values() for topic in found), *held(*infos)]
            if not settings.cameras and settings.vision.depth == "auto":
                seen += held(topics.DEPTH)
        else:
            seen = held(*SPLINES)
            if not held(topics.OBSERVED):
                of = f" of camera '{missing}'" if missing else ""
                raise RecordingError(
                    f"{bag}: has neither images{of} nor {topics.OBSERVED}; record one"
                )
        command = COMMANDS[settings.command.source]
        known = [t for t in command if not t.startswith("/") or installed(topics.TRANSFORMS_TYPE)]
        if not known:
            raise InputError(
                f"{params}: command.source is 'tf', but the package tf2_msgs is missing, which a "
                "full ROS 2 has"
            )
        motion_topics = held(*known)
        if not motion_topics:
            raise RecordingError(f"{bag}: has no {command[0]}; record the imposed motion")
        duration = (recording.end - recording.start) / 1e9
        played = [*seen, *motion_topics, *held(*topics.WRENCHES)]
    return LiveRun(bag, duration, played, has_images, params.resolve(), settings, logs)


def _of_camera(name: str, wanted: Sequence[str]) -> list[str]:
    return [topics.of_camera(name, topic) for topic in wanted]
