# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`diagnose --params FILE --output DIR [--holdout BAG] BAG ...`: model errors and their causes."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from dlo_ros.cli.diagnosis_output import summary, write_results
from dlo_ros.cli.loading import (
    add_model_arguments,
    load_all,
    load_settings,
    prepare,
    unstated,
)
from dlo_ros.cli.loads import borne
from dlo_ros.cli.progress import progress_bar, steps
from dlo_ros.cli.results import add_results_folder, check_results_folder, written
from dlo_ros.diagnosis import diagnose
from dlo_ros.errors import InputError
from dlo_ros.inference.parallel import at_most


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="recordings to explain")
    add_model_arguments(parser)
    add_results_folder(parser)
    parser.add_argument(
        "--holdout",
        type=Path,
        action="append",
        default=[],
        metavar="BAG",
        help="recording on which the gain is measured; may be repeated; default: one of the "
        "others, or the end of the only one",
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=0,
        metavar="N",
        help="simulations at the same time; default: one per core",
    )


def run(arguments: argparse.Namespace) -> int:
    """Diagnose; returns the exit status.

    Raises:
        DloError: an input or the output is unusable.
    """
    settings = load_settings(arguments, [*arguments.bags, *arguments.holdout])
    output: Path = arguments.output
    check_results_folder(output)
    if arguments.workers < 0:
        raise InputError(
            f"--workers is {arguments.workers}; give a number of simulations at the same time, "
            "1 or more"
        )
    recordings, holdout = load_all(arguments, arguments.bags, arguments.holdout, settings)
    prepare()
    with progress_bar() as bar, at_most(arguments.workers or _cores()):
        task = bar.add_task("Diagnosing", total=1.0)
        found = diagnose(recordings, settings, holdout, progress=steps(bar, task))
    with written(output):
        loads = borne([*recordings, *holdout], found.extended.settings)
        write_results(output, settings, found, loads, unstated(arguments))
    for line in summary(found, settings.rod.length, output):
        print(line)
    print(f"\n{output / 'report.html'} shows all of it with pictures, report.json is for programs.")
    return 0


def _cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
