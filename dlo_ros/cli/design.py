# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`design --params FILE --output DIR [EXPERIMENT.yaml ...]`: the next manipulation to record."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dlo_ros.cli.loading import load_information, prepare
from dlo_ros.cli.progress import progress_bar
from dlo_ros.cli.results import add_results_folder, check_results_folder
from dlo_ros.command import CONTROL_POINT, END, START, Command
from dlo_ros.errors import CommandError, InputError, SimulationError
from dlo_ros.files import write_text
from dlo_ros.identification.batched_forecast import forecast_each
from dlo_ros.identification.design.design_reason import length_over_scale, reason
from dlo_ros.identification.design.expected_information import (
    Noise,
    Outlook,
    Plan,
    at_equilibrium,
    outlook,
)
from dlo_ros.identification.design.manipulation_search import (
    ManipulationCandidate,
    Workspace,
    imposed,
    laid,
    rough_shape,
    search,
)
from dlo_ros.identification.estimate import search_information
from dlo_ros.identification.identifiability import rounded
from dlo_ros.parameters import Settings
from dlo_ros.report.design import (
    DesignedExperiment,
    DesignReport,
    Panel,
    write_design_report,
)
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.synthesis.experiment import Experiment, find_experiment, load_experiment

BUNDLED = ("simple", "different", "c_shape", "approach_two", "approach_four")
NEW = "EXPERIMENT.yaml"
PANELS = 4  # instants that the report shows
FACTORS = (0.5, 1.0, 2.0)  # of E/mu in its pictures
QUANTITIES = ("young_modulus", "density", "specific_modulus")
KNOWN_STD = 0.5  # relative standard deviation above which a number is no knowledge


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
        "--tries", type=int, default=90, metavar="N", help="manipulations that the search tries"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the search")


def run(arguments: argparse.Namespace) -> int:
    """Rank and search; returns the exit status.

    Raises:
        DloError: an input or the output is unusable.
    """
    settings = at_equilibrium(Settings.load(arguments.params))
    output: Path = arguments.output
    check_results_folder(output)
    _check(arguments)
    workspace = _workspace(arguments, settings)
    noise = Noise(std=arguments.noise)
    known = None
    if arguments.estimate is not None:
        known = search_information(settings) + load_information(arguments.estimate)
    names = arguments.experiments or BUNDLED
    plans = [experiment_plan(load_experiment(find_experiment(n)), settings) for n in names]
    prepare()
    remarks, found = [], []
    with progress_bar() as bar:
        task = bar.add_task("Ranking", total=len(plans) + arguments.tries)
        for plan in plans:
            try:
                found.append(outlook(plan, settings, noise, known=known))
            except SimulationError as err:
                remarks.append(f"'{plan.name}' is left out: {err}")
            bar.advance(task)
        bar.update(task, description="Searching")
        best = search(
            settings, workspace, noise, known=known, budget=arguments.tries, seed=arguments.seed,
            progress=lambda share: bar.update(task, completed=len(plans) + share * arguments.tries),
        )  # fmt: skip
    ranking = sorted([*found, best.outlook], key=lambda o: -o.gain)
    output.mkdir(parents=True, exist_ok=True)
    new = output / NEW
    write_text(new, experiment_text(best.candidate, workspace, settings, noise))
    weakest = min(ranking, key=lambda o: o.gain)
    tree = _tree(ranking, best.outlook, weakest, settings, workspace, noise)
    write_text(output / "design.json", json.dumps(tree, indent=2, allow_nan=False) + "\n")
    report = _report(ranking, best.outlook, weakest, settings, remarks)
    write_design_report(output / "report.html", report)
    print("Expected information of each experiment, the largest first:")
    width = max(len(entry["name"]) for entry in tree["experiments"])
    for entry in tree["experiments"]:
        std = entry["std"]["specific_modulus"]
        words = "nothing of E/mu" if std is None else f"E/mu to {rounded(100 * std)} %"
        print(f"  {entry['name']:<{width}}  {words} (information {entry['information']:.1f} bit)")
    print(report.headline)
    print(f"written to {output}: design.json, report.html, {NEW}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    for name in ("speed", "duration", "noise", "tries"):
        if not getattr(arguments, name) > 0:
            raise InputError(f"--{name} is {getattr(arguments, name)}; it must be above 0")
    if arguments.seed < 0:
        raise InputError(f"--seed is {arguments.seed}; it must not be negative")


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
    candidate: ManipulationCandidate, workspace: Workspace, settings: Settings, noise: Noise
) -> str:
    """A found manipulation as an experiment file, whose truth is what is assumed of the DLO."""
    parameters: dict[str, Any] = {}
    for name, value in settings.flat().items():
        group, _, key = name.partition(".")
        if group in ("rod", "damping", "camera", "effects", "gravity"):
            plain = list(value) if isinstance(value, tuple) else value
            if not key:
                parameters[group] = plain
                continue
            node = parameters.setdefault(group, {})
            *inner, last = key.split(".")
            for part in inner:
                node = node.setdefault(part, {})
            node[last] = plain
    motion = {}
    for name, rows in imposed(candidate, workspace.duration, settings.rod.control_points).items():
        motion[name] = [_point(row, name in (START, END)) for row in rows]
    tree = {
        "name": "searched",
        "parameters": parameters,
        "duration": workspace.duration,
        "initial_shape": np.round(rough_shape(candidate, settings.rod.length), 5).tolist(),
        "motion": motion,
        "measurement": {"std": noise.std, "spacing": noise.spacing},
    }
    head = "# Found by dlo_ros design: the most informative manipulation for E and mu.\n"
    text: str = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=100)
    return head + text


def _point(row: FloatArray, clamp: bool) -> dict[str, Any]:
    t, x, z, angle = (round(float(v), 6) for v in row)
    point: dict[str, Any] = {"time": t, "position": [x, 0.0, z]}
    return point | {"angle": angle} if clamp else point


def _tree(
    ranking: list[Outlook], new: Outlook, weakest: Outlook, settings: Settings,
    workspace: Workspace, noise: Noise,
) -> dict[str, Any]:  # fmt: skip
    return {
        "experiments": [
            {
                "name": o.plan.name,
                "origin": "searched" if o is new else "given",
                "information": o.gain,
                "std": dict(zip(QUANTITIES, _determined(o), strict=True)),
                "response": o.response,
                "reason": reason(o, weakest, settings),
            }
            for o in ranking
        ],
        "best": ranking[0].plan.name,
        "new": {"name": new.plan.name, "file": NEW},
        "length_over_scale": length_over_scale(settings),
        "workspace": {
            "x": list(workspace.x), "z": list(workspace.z), "speed": workspace.speed,
            "turn": workspace.turn, "duration": workspace.duration,
        },
        "noise": {"std": noise.std, "spacing": noise.spacing, "common": noise.common},
    }  # fmt: skip


def _report(
    ranking: list[Outlook], new: Outlook, weakest: Outlook, settings: Settings,
    remarks: list[str],
) -> DesignReport:  # fmt: skip
    best = ranking[0]
    headline = f"{best.plan.name}: {reason(best, weakest, settings)}"
    shown = tuple(
        DesignedExperiment(
            o.plan.name,
            "searched" if o is new else "given",
            o.gain,
            _determined(o),
            0.01 * o.response * settings.rod.length,
            reason(o, weakest, settings),
            panels(o, settings),
        )
        for o in ranking
    )
    general = (
        f"The DLO is {rounded(length_over_scale(settings))} times as long as l = (B/w)^(1/3), over "
        "which its weight bends it. Standard deviations hold for E as given; information is "
        "averaged over half, the given and twice the given E/mu, without changes of shape that a "
        "slightly tilted board or a slight bend at rest would cause as well."
    )
    return DesignReport(headline, shown, (general, *remarks))


def _determined(o: Outlook) -> tuple[float | None, float | None, float | None]:
    # E and mu that only a guess fixes are not determined by the manipulation.
    # By eigenvalues: what is known very well and not at all stands side by side in it.
    known, modes = np.linalg.eigh(0.5 * (o.information + o.information.T))
    free = (modes**2 / (np.maximum(known, 0.0) + 1e-6)).sum(axis=1)
    alone = (math.sqrt(free[0]), math.sqrt(free[1]), 0.0)
    values = (o.std[name] for name in QUANTITIES)
    young, density, ratio = (
        v if v < KNOWN_STD and a < 10.0 else None for v, a in zip(values, alone, strict=True)
    )
    return young, density, ratio


def panels(o: Outlook, settings: Settings) -> tuple[Panel, ...]:
    """Instants of a manipulation with a softer, the given and a stiffer DLO."""
    sets = [
        settings.with_material(f * settings.rod.young_modulus, settings.rod.density)
        for f in FACTORS
    ]
    slow = replace(o.plan, rate=max((PANELS - 1) / max(o.plan.duration, 1e-3), 0.1))
    found = forecast_each(slow.manipulation(), sets)
    if any(f is None for f in found):
        return ()
    shapes = [f.predicted for f in found if f is not None]
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    matrix = basis.matrix(np.linspace(0.0, basis.length, 60))
    result = []
    for k in range(min(len(s) for s in shapes)):
        soft, given, stiff = (matrix @ s[k][:, [0, 2]] for s in shapes)
        result.append(Panel(k / slow.rate, (soft, given, stiff)))
    return tuple(result)
