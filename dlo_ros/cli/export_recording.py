# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`export --recording BAG`: recordings as CSV files or as a data set in LeRobot's layout."""

from __future__ import annotations

import argparse

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.errors import InputError
from dlo_ros.parameters import Settings
from dlo_ros.recordings.lerobot import library, write_lerobot
from dlo_ros.recordings.tables import OBSERVED_FILE, write_csv
from dlo_ros.recordings.wrench_table import write_wrench_table

TABLES = ("csv", "parquet")


def write_recordings(arguments: argparse.Namespace) -> int:
    """Write the recordings of `export`'s arguments; returns the exit status.

    Raises:
        InputError: options that do not go together, or a bag or the output is unusable.
    """
    bags, output = arguments.recording or [], arguments.output
    if not bags:
        raise InputError(f"--format {arguments.format} is of a recording; name it by --recording")
    if arguments.format not in TABLES:
        raise InputError(
            f"--recording is written as {' or '.join(TABLES)}, not as {arguments.format}"
        )
    for option in ("bag", "sample", "estimate"):
        if getattr(arguments, option) is not None:
            raise InputError(f"--{option} belongs to a cable; it cannot go with --recording")
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file; give a folder for the recording")
    if arguments.format == "csv":
        if len(bags) != 1:
            raise InputError("--format csv takes one --recording; give each a folder of its own")
        if (output / OBSERVED_FILE).exists():
            raise InputError(f"{output}: holds a recording already; give another name")
    else:
        library()
    settings = Settings.load(arguments.params)
    recordings = [load_manipulation(bag, settings) for bag in bags]
    if arguments.format == "csv":
        output.mkdir(parents=True, exist_ok=True)
        write_csv(output, recordings[0].commands, recordings[0].observations)
        write_wrench_table(output, recordings[0].wrenches)
    else:
        episodes = [(r.commands, r.observations) for r in recordings]
        write_lerobot(output, episodes, settings)
    frames = sum(len(r.observations) for r in recordings)
    print(f"{output}: {len(recordings)} recordings, {frames} observed splines")
    return 0
