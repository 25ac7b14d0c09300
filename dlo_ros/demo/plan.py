# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Which topics of a recording the demo plays (no ROS here)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dlo_ros.errors import InputError, RecordingError
from dlo_ros.parameters import Settings
from dlo_ros.recordings import open_bag, topics

# What a camera and a robot would publish; what nodes made of it is made anew.
INPUTS = (
    topics.IMAGE, topics.COMPRESSED, topics.CAMERA_INFO, topics.COMMAND, *topics.WRENCHES,
)  # fmt: skip
SPLINES = (topics.OBSERVED, topics.OBSERVED_POINTS, topics.COMMAND, *topics.WRENCHES)


@dataclass(frozen=True)
class LiveRun:
    """What is played to whom.

    Args:
        bag: the recording.
        duration: of it [s].
        topics: full names that are played.
        has_images: whether images are among them.
        params: parameter file of the nodes.
        settings: its content.
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

    Raises:
        RecordingError: the bag is unusable, or lacks images and splines, or the command.
    """
    with open_bag(bag) as recording:
        has_images = any(recording.find(t) for t in (topics.IMAGE, topics.COMPRESSED))
        wanted = INPUTS if has_images else SPLINES
        played = [c.topic for t in wanted for c in recording.find(t)]
        if not has_images and not recording.find(topics.OBSERVED):
            raise RecordingError(f"{bag}: has neither images nor {topics.OBSERVED}; record one")
        if not recording.find(topics.COMMAND):
            raise RecordingError(f"{bag}: has no {topics.COMMAND}; record the imposed motion")
        duration = (recording.end - recording.start) / 1e9
    return LiveRun(bag, duration, played, has_images, params.resolve(), settings, logs)
