# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`demo`: the main job end to end, with live nodes, on a recording made on the spot or a given."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from rich.console import Console

from dlo_ros.compilation import BackgroundCompilation
from dlo_ros.demo.outcome import assess
from dlo_ros.demo.overview import write_overview
from dlo_ros.demo.photographs import photographs
from dlo_ros.demo.plan import params_beside, plan_run
from dlo_ros.demo.result import estimate_tree, last_line, read_truth, report, write_json
from dlo_ros.errors import InputError
from dlo_ros.parameters import Settings
from dlo_ros.report import write_identification_report

EXPERIMENT = "c_shape"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--bag", type=Path, help="recording to play instead of a synthetic one")
    parser.add_argument(
        "--params", type=Path, help="parameter file; params.yaml in or beside the bag by default"
    )
    parser.add_argument(
        "--output", type=Path, default=Path("build/demo"), help="folder of the results"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the demo.

    Raises:
        DloError: an input is unusable or a node died.
    """
    if arguments.params and not arguments.bag:
        raise InputError(
            f"--params {arguments.params}: is of use with a recording only; name it with --bag"
        )
    console = Console()
    output: Path = arguments.output
    output.mkdir(parents=True, exist_ok=True)
    needed = ("vision", "rod") if arguments.bag else ("synthesis", "vision", "rod")
    with BackgroundCompilation(needed) as compilation:  # goes on while the recording is made
        return _run(arguments, output, console, compilation)


def _run(
    arguments: argparse.Namespace,
    output: Path,
    console: Console,
    compilation: BackgroundCompilation,
) -> int:
    bag = arguments.bag or _synthesize(output, console)
    params = arguments.params or params_beside(bag)
    settings = Settings.load(params)
    live = plan_run(bag, params, settings, output / "log")
    from dlo_ros.demo.live import run_live  # here, so that --help and bad input need no ROS

    # Nodes that start while the others compile would wait for each other in vain.
    compilation.wait(console.print)
    heard = run_live(live, console)
    outcome = assess(bag, settings, heard)
    truth = read_truth(bag)
    console.print("Writing the report")
    pictures = photographs(bag, settings, heard, outcome) if live.has_images else {}
    name = bag.resolve().name
    page = report(
        heard, outcome, name, settings.rod.length, truth, pictures, remarks=heard.warnings
    )
    write_json(output / "estimate.json", estimate_tree(heard, outcome, name, truth))
    write_identification_report(output / "report.html", page)
    write_overview(output / "overview.png", page)
    console.print(f"{output}/estimate.json, {output}/report.html", soft_wrap=True)
    console.print(last_line(outcome, truth), highlight=False, soft_wrap=True)
    return 0


def _synthesize(output: Path, console: Console) -> Path:
    """Make the recording of the third experiment."""
    bag = output / EXPERIMENT
    console.print(f"Making the recording of {EXPERIMENT} (simulated rope, rendered images)")
    command = [sys.executable, "-m", "dlo_ros", "synthesize", EXPERIMENT]
    done = subprocess.run([*command, "--output", str(bag), "--force"])
    if done.returncode != 0:
        raise InputError(f"the recording of {EXPERIMENT} could not be made")
    return bag
