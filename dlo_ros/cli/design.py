# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`design --params FILE --output DIR [EXPERIMENT.yaml ...]`: the next manipulation to record.

It is the one that determines E and mu best, or that separates rival causes.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml

from dlo_ros.cli.design_information import Information
from dlo_ros.cli.design_purpose import Purpose
from dlo_ros.cli.design_separation import Separation, named_rivals, sized
from dlo_ros.cli.loading import load_information, prepare
from dlo_ros.cli.progress import progress_bar
from dlo_ros.cli.results import add_results_folder, check_results_folder
from dlo_ros.command import CONTROL_POINT, END, START, Command
from dlo_ros.effects.registry import STD
from dlo_ros.errors import CommandError, InputError, SimulationError
from dlo_ros.files import write_text
from dlo_ros.identification.design.expected_information import Noise, Plan, at_equilibrium
from dlo_ros.identification.design.manipulation_search import (
    Judged,
    ManipulationCandidate,
    Workspace,
    imposed,
    laid,
    rough_shape,
    search,
)
from dlo_ros.identification.design.standard_manipulations import standard
from dlo_ros.identification.estimate import search_information
from dlo_ros.parameters import EFFECTS_PREFIX, Settings
from dlo_ros.report.design import DesignedExperiment, DesignReport, write_design_report
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.synthesis.experiment import DURATIONS, Experiment, find_experiment, load_experiment
from dlo_ros.synthesis.picture_settings import LARGEST_STD

BUNDLED = ("simple", "different", "c_shape", "approach_two", "approach_four")
NEW = "EXPERIMENT.yaml"
TRIES, FEWEST_TRIES = 90, 12
"""Manipulations that a search tries; with several rivals as many for all pairs together."""

Result = TypeVar("Result", bound=Judged)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument(
        "experiments",
        nargs="*",
        metavar="EXPERIMENT.yaml",
        help="manipulations to rank; default: the bundled ones",
    )
    parser.add_argument(
        "--params", type=Path, required=True, metavar="FILE", help="parameter file of the DLO"
    )
    add_results_folder(parser)
    parser.add_argument(
        "--estimate",
        type=Path,
        metavar="FILE",
        help="estimate.json of earlier recordings, whose information counts as known",
    )
    parser.add_argument(
        "--apart",
        nargs=2,
        default=(),
        metavar=("EFFECT", "RIVAL"),
        help="two effects of which only one is the cause: rank manipulations by how well they "
        "separate these",
    )
    parser.add_argument(
        "--report",
        type=Path,
        metavar="FILE",
        help="report.json of diagnose, which says how large effects are; without --apart its "
        "cause and all rivals of that are separated",
    )
    parser.add_argument(
        "--bounds",
        type=float,
        nargs=4,
        metavar=("X0", "X1", "Z0", "Z1"),
        help="where the held ends may be [m]; default: half of L around the board's origin",
    )
    parser.add_argument(
        "--speed", type=float, default=0.5, metavar="V", help="largest speed of an end [m/s]"
    )
    parser.add_argument(
        "--duration", type=float, default=3.0, metavar="T", help="of a recording [s]"
    )
    parser.add_argument(
        "--noise", type=float, default=3e-4, metavar="S",
        help="standard deviation of the observer's points [m]",
    )  # fmt: skip
    parser.add_argument(
        "--tries", type=int, metavar="N",
        help=f"manipulations that the search tries; default: {TRIES}, of several rivals fewer, "
        "since each of them is fitted to each other one",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the search")


def run(arguments: argparse.Namespace) -> int:
    """Rank and search; returns the exit status.

    Raises:
        DloError: an input or the output is unusable.
    """
    settings = at_equilibrium(Settings.load(arguments.params))
    check_results_folder(arguments.output)
    _check(arguments)
    workspace = _workspace(arguments, settings)
    noise = Noise(std=arguments.noise)
    if arguments.apart or arguments.report is not None:
        settings, rivals = named_rivals(settings, arguments.apart, arguments.report)
        plans = _plans(arguments, settings) or [
            *_plans(arguments, settings, BUNDLED),
            *standard(settings),
        ]
        prepare()
        explanations = sized(rivals, settings, plans)
        pairs = len(explanations) * (len(explanations) - 1) // 2
        tries = arguments.tries or max(TRIES // pairs, FEWEST_TRIES)
        return _designed(
            Separation(settings, noise, explanations), plans, workspace, settings, arguments, tries
        )
    known = None
    if arguments.estimate is not None:
        known = search_information(settings) + load_information(arguments.estimate)
    plans = _plans(arguments, settings) or _plans(arguments, settings, BUNDLED)
    prepare()
    tries = arguments.tries or TRIES
    return _designed(
        Information(settings, noise, known), plans, workspace, settings, arguments, tries
    )


def _plans(
    arguments: argparse.Namespace, settings: Settings, names: Sequence[str] = ()
) -> list[Plan]:
    """The manipulations with these names, or those of the command line."""
    chosen = names or arguments.experiments
    return [experiment_plan(load_experiment(find_experiment(n)), settings) for n in chosen]


def _designed(
    purpose: Purpose[Result], plans: Sequence[Plan], workspace: Workspace, settings: Settings,
    arguments: argparse.Namespace, tries: int,
) -> int:  # fmt: skip
    """Rank and search, write and print the results; returns the exit status."""
    remarks, found = [], []
    with progress_bar() as bar:
        task = bar.add_task("Ranking", total=len(plans) + tries)
        for plan in plans:
            try:
                found.append(purpose.judge(plan, None))
            except SimulationError as err:
                remarks.append(f"'{plan.name}' is left out: {err}")
            bar.advance(task)
        bar.update(task, description="Searching")
        candidate, best = search(
            settings, workspace, purpose.judge, budget=tries, seed=arguments.seed,
            finalists=purpose.finalists,
            progress=lambda share: bar.update(task, completed=len(plans) + share * tries),
        )  # fmt: skip
    ranking = sorted([*found, best], key=lambda o: -o.gain)
    output: Path = arguments.output
    output.mkdir(parents=True, exist_ok=True)
    text = experiment_text(candidate, workspace, settings, Noise(std=arguments.noise), purpose.what)
    write_text(output / NEW, text)
    shown = purpose.presented(ranking)
    origins = ["searched" if o is best else "given" for o in ranking]
    tree = {
        "experiments": [
            {"name": e.name, "origin": origin, **e.numbers, "reason": e.reason}
            for e, origin in zip(shown.experiments, origins, strict=True)
        ],
        "best": shown.experiments[0].name,
        "new": {"name": best.plan.name, "file": NEW},
        **shown.numbers,
        "workspace": {
            "x": list(workspace.x), "z": list(workspace.z), "speed": workspace.speed,
            "turn": workspace.turn, "duration": workspace.duration,
        },
        "noise": {"std": arguments.noise, "spacing": Noise.spacing, "common": Noise.common},
    }  # fmt: skip
    write_text(output / "design.json", json.dumps(tree, indent=2, allow_nan=False) + "\n")
    report = DesignReport(
        shown.title, shown.headline, shown.headers,
        tuple(
            DesignedExperiment(e.name, origin, e.cells, e.reason, e.panels)
            for e, origin in zip(shown.experiments, origins, strict=True)
        ),
        shown.caption, (*shown.remarks, *remarks),
    )  # fmt: skip
    write_design_report(output / "report.html", report)
    for line in shown.lines:
        print(line)
    print(shown.headline)
    print(f"written to {output}: design.json, report.html, {NEW}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    for name in ("speed", "duration", "noise", "tries"):
        value = getattr(arguments, name)
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise InputError(f"--{name} is {value:g}; it must be above 0 and finite")
    # What is found is written as an experiment file, which has these limits.
    for name, (low, high), unit in (
        ("duration", DURATIONS, "s"), ("noise", (0.0, LARGEST_STD), "m"),
    ):  # fmt: skip
        value = getattr(arguments, name)
        if not low <= value <= high:
            raise InputError(f"--{name} is {value:g} {unit}; allowed is {low:g} to {high:g} {unit}")
    if arguments.seed < 0:
        raise InputError(f"--seed is {arguments.seed}; it must not be negative")
    if arguments.estimate is not None and (arguments.apart or arguments.report is not None):
        raise InputError("--estimate counts for E and mu only; leave it out to separate causes")


def _workspace(arguments: argparse.Namespace, settings: Settings) -> Workspace:
    half = 0.5 * settings.rod.length
    x0, x1, z0, z1 = arguments.bounds or (-half, half, -half, half)
    return Workspace((x0, x1), (z0, z1), speed=arguments.speed, duration=arguments.duration)


def experiment_plan(experiment: Experiment, settings: Settings) -> Plan:
    """The manipulation of an experiment file with the rod of a parameter file.

    Where the file's rope has another length all places are scaled.

    Raises:
        InputError: it imposes something that the rod's control points do not have.
    """
    rod, theirs = settings.rod, experiment.truth.rod
    scale = rod.length / theirs.length
    names = _renamed(experiment, settings)
    old = experiment.command
    try:
        command = Command(
            old.stamp, names, old.times, scale * old.positions, old.rotations,
            scale * old.velocities, rod.control_points, settings.frame_id,
        )  # fmt: skip
    except CommandError as err:
        raise InputError(f"{experiment.name}: {err}") from err
    shape = laid(scale * experiment.initial_shape, SplineBasis(rod.control_points, rod.length))
    return Plan(experiment.name, command, shape, experiment.duration, experiment.camera.rate)


def _renamed(experiment: Experiment, settings: Settings) -> tuple[str, ...]:
    n, theirs = settings.rod.control_points, experiment.truth.rod.control_points
    result = []
    for name in experiment.command.names:
        if name in (START, END) or n == theirs:
            result.append(name)
            continue
        number = int(name.removeprefix(CONTROL_POINT))
        if 2 < number < theirs - 1:
            raise InputError(
                f"{experiment.name}: imposes {name} of {theirs}; rod.control_points is {n}"
            )
        result.append(f"{CONTROL_POINT}{number if number <= 2 else number + n - theirs}")
    return tuple(result)


def experiment_text(
    candidate: ManipulationCandidate, workspace: Workspace, settings: Settings, noise: Noise,
    what: str,
) -> str:  # fmt: skip
    """A found manipulation as an experiment file, whose truth is what is assumed of the DLO.

    Args:
        candidate: the manipulation.
        workspace: its limits.
        settings: settings of the rod.
        noise: measurement noise of the observer.
        what: what the manipulation is best for, in words.
    """
    parameters: dict[str, Any] = {}
    guess: dict[str, Any] = {}
    stated = {f"{EFFECTS_PREFIX}{name}{STD}" for name in settings.tolerances}
    for name, value in settings.flat().items():
        *groups, key = name.split(".")
        if (groups or [key])[0] not in ("rod", "damping", "camera", "effects", "gravity"):
            continue
        # A tolerance is what an experimenter states, and nothing that a rope has; an effect of the
        # parameter file is known to the experimenter, too.
        sides = [guess] if name in stated else [parameters]
        if name.startswith(EFFECTS_PREFIX) and name not in stated:
            sides.append(guess)
        for node in sides:
            for group in groups:
                node = node.setdefault(group, {})
            node[key] = list(value) if isinstance(value, tuple) else value
    motion = {}
    for name, rows in imposed(candidate, workspace.duration, settings.rod.control_points).items():
        motion[name] = [_point(row, name in (START, END)) for row in rows]
    tree = {
        "name": "searched",
        "parameters": parameters,
        **({"guess": guess} if guess else {}),
        "duration": workspace.duration,
        "initial_shape": np.round(rough_shape(candidate, settings.rod.length), 5).tolist(),
        "motion": motion,
        "measurement": {"std": noise.std, "spacing": noise.spacing},
    }
    head = f"# Found by dlo_ros design: {what}.\n"
    text: str = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=100)
    return head + text


def _point(row: FloatArray, clamp: bool) -> dict[str, Any]:
    t, x, z, angle = (round(float(v), 6) for v in row)
    point: dict[str, Any] = {"time": t, "position": [x, 0.0, z]}
    return point | {"angle": angle} if clamp else point
