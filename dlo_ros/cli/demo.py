# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`demo`: the main job end to end, with live nodes, on a recording made on the spot or a given."""

from __future__ import annotations

import argparse
import subprocess
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from rich.console import Console

from dlo_ros.command import Motion
from dlo_ros.compilation import BackgroundCompilation
from dlo_ros.demo.outcome import assess
from dlo_ros.demo.overview import write_overview
from dlo_ros.demo.overview_space import Views, write_space_overview
from dlo_ros.demo.photographs import photographs
from dlo_ros.demo.plan import params_beside, plan_run
from dlo_ros.demo.result import (
    estimate_tree,
    last_line,
    read_truth,
    remarks,
    report,
    write_json,
)
from dlo_ros.errors import InputError
from dlo_ros.nodes.received_data import SPECIFIC_MODULUS
from dlo_ros.own_process import command_of
from dlo_ros.parameters import Settings
from dlo_ros.recordings import read_recording, topics
from dlo_ros.report import write_identification_report

EXPERIMENT = "c_shape"
IN_SPACE = "two_grippers"

EXIT_UNKNOWN = 1
"""Exit status where the run went well, and E/mu, or ERR with it, is not known all the same."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--bag", type=Path, help="recording to play instead of a synthetic one")
    parser.add_argument(
        "--params", type=Path, help="parameter file; params.yaml in or beside the bag by default"
    )
    parser.add_argument(
        "--space",
        action="store_true",
        help="a rope in space between two moving grippers, frames of /tf, seen by two cameras",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("build/demo"), help="folder of the results"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the demo; returns the exit status, 1 where E/mu or ERR with it stays unknown.

    Raises:
        DloError: an input is unusable or a node died.
    """
    if arguments.params and not arguments.bag:
        raise InputError(
            f"--params {arguments.params}: is of use with a recording only; name it with --bag"
        )
    if arguments.space and arguments.bag:
        raise InputError("--space makes a recording of its own; leave --space or --bag out")
    console = Console()
    output: Path = arguments.output
    output.mkdir(parents=True, exist_ok=True)
    if not arguments.bag:  # what lacks ROS is told before a recording is made
        import_module("dlo_ros.demo.live")
    needed = ("vision", "rod") if arguments.bag else ("synthesis", "vision", "rod")
    with BackgroundCompilation(needed) as compilation:  # goes on while the recording is made
        return _run(arguments, output, console, compilation)


def _run(
    arguments: argparse.Namespace,
    output: Path,
    console: Console,
    compilation: BackgroundCompilation,
) -> int:
    bag = arguments.bag or _synthesize(IN_SPACE if arguments.space else EXPERIMENT, output, console)
    params = arguments.params or params_beside(bag)
    settings = Settings.load(params)
    if arguments.space and settings.command.source == "tf":
        from dlo_ros.nodes.message_factory import installed

        if not installed(topics.TRANSFORMS_TYPE):
            params, settings = _from_poses(output, settings, console)
    live = plan_run(bag, params, settings, output / "log")
    from dlo_ros.demo.live import run_live  # here, so that --help and bad input need no ROS

    # Nodes that start while the others compile would wait for each other in vain.
    compilation.wait(console.print)
    received = run_live(live, console)
    outcome = assess(bag, settings, received)
    truth = read_truth(bag)
    console.print("Writing the report")
    views: Views = {
        camera: photographs(bag, settings, received, outcome, camera)
        for camera in (settings.cameras or ("",) if live.has_images else ())
    }
    pictures = next(iter(views.values()), {})
    name = bag.resolve().name
    said = remarks(received, outcome)
    page = report(
        received, outcome, name, settings.rod.length, truth, pictures, [*said, *received.warnings],
        settings.camera_positions,
    )  # fmt: skip
    write_json(output / "estimate.json", estimate_tree(received, outcome, name, truth))
    write_identification_report(output / "report.html", page)
    if settings.cameras:
        motion = Motion(list(read_recording(bag, settings).commands))
        write_space_overview(output / "overview.png", page, views, motion, min(received.observed))
    else:
        write_overview(output / "overview.png", page)
    console.print(f"{output}/estimate.json, {output}/report.html", soft_wrap=True)
    known = received.identifiable(SPECIFIC_MODULUS)
    if not known:
        console.print(f"{bag}: E/mu is not identified; record more motion", soft_wrap=True)
    for sentence in said:
        console.print(sentence, highlight=False, soft_wrap=True)
    console.print(last_line(outcome, truth), highlight=False, soft_wrap=True)
    return 0 if known and outcome.err is not None else EXIT_UNKNOWN


def _from_poses(output: Path, settings: Settings, console: Console) -> tuple[Path, Settings]:
    """Parameters with which the nodes hear the grippers' poses on topics of their own.

    The wheels of ROS 2 for a plain Python have no tf2_msgs, without which nobody hears /tf.
    """
    console.print(
        f"tf2_msgs is not installed, so /tf cannot be played: the same poses of the grippers are "
        f"played on {topics.START_POSE} and {topics.END_POSE}",
        soft_wrap=True,
    )
    settings = replace(settings, command=replace(settings.command, source="pose"))
    params = output / "params.yaml"
    settings.dump(params, "Those of the recording, with the grippers' poses instead of /tf.")
    return params, settings


def _synthesize(experiment: str, output: Path, console: Console) -> Path:
    """Make the recording of a bundled experiment."""
    bag = output / experiment
    console.print(f"Making the recording of {experiment} (simulated rope, rendered images)")
    command = [*command_of("dlo_ros"), "synthesize", experiment]
    done = subprocess.run([*command, "--output", str(bag), "--force"])
    if done.returncode != 0:
        raise InputError(f"the recording of {experiment} could not be made")
    return bag
