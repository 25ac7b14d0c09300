# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`play`: a bag onto live topics with /clock."""

from __future__ import annotations

import argparse
import os
from contextlib import suppress
from pathlib import Path

from dlo_ros.errors import InputError, RecordingError
from dlo_ros.recordings import topics
from dlo_ros.recordings.playback import plan
from dlo_ros.share import shared_file

WAIT = 600.0
"""Seconds to wait for nodes to be ready by default: compiling takes that long on a slow machine."""

MOST_WAIT = 86400.0
"""A day [s]."""

PROFILE = "config/fastdds_large_images.xml"
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the tool's arguments."""
    parser.add_argument("bag", metavar="BAG", nargs="?", help="folder of a rosbag2 recording")
    parser.add_argument(
        "--rate", type=float, default=1.0, metavar="R", help="speed, 1 is the recording's"
    )
    parser.add_argument("--loop", action="store_true", help="play again and again until Ctrl-C")
    parser.add_argument(
        "--start-offset",
        type=float,
        default=0.0,
        metavar="S",
        help="seconds of the recording to leave out at its start",
    )
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="T", help="only these topics (default: all)"
    )
    parser.add_argument("--no-images", action="store_true", help="leave out images and camera_info")
    parser.add_argument("--no-clock", action="store_true", help="do not publish /clock")
    parser.add_argument(
        "--wait",
        type=float,
        default=WAIT,
        metavar="SECONDS",
        help=f"how long to wait at most for nodes to be ready (default {WAIT:g}); 0: not at all",
    )
    parser.add_argument(
        "--wait-for",
        action="append",
        default=[],
        metavar="NODE",
        help="a node that must be ready, besides those of dlo_ros that listen; may be repeated",
    )
    parser.add_argument(
        "--ros-args", nargs=argparse.REMAINDER, default=[], help="ROS arguments, such as remappings"
    )


def run(arguments: argparse.Namespace) -> int:
    """Play the bag; returns the exit status.

    Raises:
        InputError: the bag or an argument is unusable, or nobody listens.
    """
    bag, selection = arguments.bag, list(arguments.topics)
    if bag is None and len(selection) > 1:
        bag = selection.pop()  # `play --topics T ... BAG`
    if not 0.0 <= arguments.wait <= MOST_WAIT:
        raise InputError(f"--wait is {arguments.wait:g}; give seconds from 0 to {MOST_WAIT:g}")
    if bag is None:
        raise RecordingError("no bag is given; name the folder of a rosbag2 recording")
    # ROS is imported here, so that --help works without it.
    from dlo_ros.nodes.message_factory import installed
    from dlo_ros.nodes.player import play

    playlist = plan(
        Path(bag),
        rate=arguments.rate,
        start_offset=arguments.start_offset,
        selection=selection,
        images=not arguments.no_images,
        playable=installed,
    )
    if any(kind in topics.IMAGE_TYPES for _, kind in playlist.topics):
        _allow_large_messages()
    print(
        f"playing {playlist.path}: {len(playlist.topics)} topics, {playlist.duration:.1f} s",
        flush=True,
    )
    ros_arguments = ["--ros-args", *arguments.ros_args] if arguments.ros_args else []
    return play(
        playlist,
        loop=arguments.loop,
        clock=not arguments.no_clock,
        patience=arguments.wait,
        awaited=arguments.wait_for,
        arguments=ros_arguments,
    )


def _allow_large_messages() -> None:
    """Give Fast DDS room for whole images, unless the user has a profile of his own.

    With its default of 512 KB most of them are lost on the way to best-effort subscribers.
    """
    if not any(os.environ.get(name) for name in PROFILE_VARIABLES):
        with suppress(InputError):
            os.environ[PROFILE_VARIABLES[0]] = str(shared_file(PROFILE))
