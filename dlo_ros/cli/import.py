# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`import --format FORMAT --params FILE --output BAG INPUT ...`: recordings of others as bags."""

from __future__ import annotations

import argparse
from pathlib import Path

from dlo_ros.errors import InputError
from dlo_ros.observation import Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.recordings.lerobot import read_lerobot
from dlo_ros.recordings.point_tables import read_point_tables, write_points_bag
from dlo_ros.recordings.ros1 import import_ros1
from dlo_ros.recordings.tables import read_csv, write_bag
from dlo_ros.recordings.wrench_table import read_wrench_tables

FORMATS = {
    "csv": "files or a folder as export --recording writes them",
    "parquet": "the folder of a data set in LeRobot's layout",
    "points": "CSV or Parquet files with a line for each point of another tracker",
    "ros1": "ROS 1 bags of one recording",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument(
        "inputs", type=Path, nargs="+", metavar="INPUT", help="files or folders to read"
    )
    parser.add_argument(
        "--format", choices=tuple(FORMATS), required=True,
        help="; ".join(f"{name}: {words}" for name, words in FORMATS.items()),
    )  # fmt: skip
    parser.add_argument(
        "--params", type=Path, required=True, metavar="FILE", help="parameter file of the DLO"
    )
    parser.add_argument("--output", type=Path, required=True, metavar="BAG", help="bag to write")
    parser.add_argument(
        "--episode", type=int, default=0, metavar="N",
        help="which episode of a data set, from 0; default: %(default)s",
    )  # fmt: skip
    parser.add_argument(
        "--topic", action="append", default=[], metavar="OURS=THEIRS",
        help="ros1: which of the bag's topics is which of ours, such as dlo/points=/tracker/cloud",
    )  # fmt: skip
    parser.add_argument("--force", action="store_true", help="replace an existing bag")


def run(arguments: argparse.Namespace) -> int:
    """Import; returns the exit status.

    Raises:
        InputError: an input or the output is unusable.
    """
    settings = Settings.load(arguments.params)
    if arguments.topic and arguments.format != "ros1":
        raise InputError("--topic is for --format ros1")
    if arguments.format == "ros1":
        return _ros1(arguments, settings)
    if arguments.format == "points":
        return _points(arguments, settings)
    wrenches: tuple[Wrenches, ...] = ()
    if arguments.format == "csv":
        commands, observations = read_csv(arguments.inputs, settings)
        wrenches = read_wrench_tables(arguments.inputs)
    else:
        if len(arguments.inputs) != 1:
            raise InputError("--format parquet takes one folder; each episode becomes a bag")
        if arguments.episode < 0:
            raise InputError(f"--episode is {arguments.episode}; episodes count from 0")
        commands, observations = read_lerobot(arguments.inputs[0], settings, arguments.episode)
    write_bag(arguments.output, settings, commands, observations, wrenches, force=arguments.force)
    points = sum(o.points is not None for o in observations)
    print(
        f"{arguments.output}: {len(observations)} observed splines, {points} with measured points, "
        f"{len(commands)} commands, {sum(len(w.stamps) for w in wrenches)} measured forces"
    )
    return 0


def _points(arguments: argparse.Namespace, settings: Settings) -> int:
    commands, lists = read_point_tables(arguments.inputs, settings)
    write_points_bag(arguments.output, settings, commands, lists, force=arguments.force)
    count = sum(len(each.positions) for each in lists)
    print(
        f"{arguments.output}: {len(lists)} lists of {count / len(lists):.0f} points in the mean, "
        f"{len(commands)} commands"
    )
    return 0


def _ros1(arguments: argparse.Namespace, settings: Settings) -> int:
    topics = dict(text.partition("=")[::2] for text in arguments.topic)
    if not all(topics.values()):
        raise InputError("--topic is written OURS=THEIRS, such as dlo/points=/tracker/cloud")
    names, left = import_ros1(
        arguments.inputs, arguments.output, topics, tuple(settings.cameras), force=arguments.force
    )
    print(f"{arguments.output}: {', '.join(f'{a} from {b}' for b, a in sorted(names.items()))}")
    if left:
        print(f"  not taken: {', '.join(left)}")
    return 0
