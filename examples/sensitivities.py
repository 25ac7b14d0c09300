# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Derivatives of a motion with respect to whatever shapes it, against differences of runs.

Material, damping, gravity, length, the pose of a clamp, and a number of an effect: a mass
that hangs on the rope. A gripped end is moved for half a second. All runs take the same steps
and solve them exactly, so that differences are those of the solution alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from report import EXACT, OURS, Result, canvas, main, save
from scene import ROPE, hold

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod import dynamics, integration
from dlo_ros.rod.sensitivity_parameters import MATERIAL, variation_of
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import FloatArray, SplineBasis

SPANS = 14
MOVED = np.array([0.0, 0.5])  # [s]
MOTIONS = {
    "in the plane": hold(["start"], [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.1]]], times=MOVED),
    "in space": hold(["start"], [[[0.0, 0.0, 0.0]], [[0.0, 0.1, 0.05]]], times=MOVED),
    "in space, both ends clamped": hold(
        ["start", "end"],
        [[[0.0, 0.0, 0.0], [0.25, 0.0, 0.0]], [[0.0, 0.1, 0.05], [0.25, 0.0, 0.0]]],
        times=MOVED,
    ),
}
TIMES = np.arange(0.0, 0.8, 4e-3)  # [s]
POINT = 6  # control point that is drawn, of ten
STEP = 1e-4  # of the logarithm, or of the parameter's own size
HUNG = {"point_mass": {"mass": 0.004, "position": 0.3}}
SIZES = {"start.z": 0.4, "start.angle": 1.0, "effects.point_mass.mass": 0.004}
PARAMETERS = (*MATERIAL, "gravity", "length", *SIZES)


@dataclass(frozen=True)
class Sensitivities(Result):
    """Height of a point per unit of a parameter (motions, parameters, times) [m], twice.

    The unit is that of the logarithm, the rope's length, a radian or the mass itself.

    Args:
        errors: error of the whole shape, over the parameter's largest derivative (motions,
            parameters).
    """

    exact: FloatArray
    differences: FloatArray
    errors: FloatArray


def shapes(
    settings: Settings, command: Command, parameters: tuple[str, ...] = ()
) -> tuple[FloatArray, FloatArray]:
    """Shapes (times, n, 3) of a run and their derivatives (parameters, times, n, 3)."""
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    straight = np.zeros((basis.control_points, 4))
    straight[:, 0] = basis.greville
    simulation = Simulation(settings, Motion([command]), parameters=parameters, spans=SPANS)
    simulation.start([Observation(0, straight)])
    path = [simulation.advance(round(t * NANOSECONDS)) for t in TIMES]
    derivatives = np.array([p.sensitivity for p in path if p.sensitivity is not None])
    if parameters:
        derivatives = derivatives.swapaxes(0, 1)
    return np.array([p.control_points[:, :3] for p in path]), derivatives


def differences(settings: Settings, command: Command) -> FloatArray:
    """The same derivatives by central differences of whole runs."""
    found = []
    for name in PARAMETERS:
        vary, step = variation_of(settings, name).vary, STEP * SIZES.get(name, 1.0)
        above, below = (shapes(*vary(settings, command, side * step))[0] for side in (1.0, -1.0))
        found.append((above - below) / (2.0 * STEP))
    return np.array(found)


@patch.object(dynamics, "in_lanes", lambda *_: False)
@patch.object(integration, "STEP_SHARE", 1e3)
@patch.object(integration, "NEWTON_SHARE", 1e-11)
def run() -> Sensitivities:
    """For each motion one run with derivatives, and two more for each parameter."""
    settings = replace(ROPE, simulation=replace(ROPE.simulation, tolerance=0.1), effects=HUNG)
    sizes = np.array([SIZES.get(name, 1.0) for name in PARAMETERS])[:, None, None, None]
    exact, rough = [], []
    for command in MOTIONS.values():
        exact.append(sizes * shapes(settings, command, PARAMETERS)[1])
        rough.append(differences(settings, command))
    ours, theirs = np.array(exact), np.array(rough)
    apart = np.abs(ours - theirs).max(axis=(2, 3, 4))
    errors = apart / np.abs(theirs).max(axis=(2, 3, 4))
    summary = "derivatives agree with differences of runs to " + ", ".join(
        f"{e.max():.1e} {where}" for where, e in zip(MOTIONS, errors, strict=True)
    )
    return Sensitivities(
        summary, float(errors.max()), ours[..., POINT, 2], theirs[..., POINT, 2], errors
    )


def plot(result: Sensitivities, path: Path) -> None:
    """How a point's height depends on every parameter, in every motion."""
    panels = canvas(3)
    for axes, where, ours, theirs in zip(
        panels, MOTIONS, result.exact, result.differences, strict=True
    ):
        scales = np.abs(theirs).max(axis=1)
        for k, scale in enumerate(scales):
            rest = -2.2 * k
            axes.plot(TIMES, ours[k] / scale + rest, color=OURS, label=None if k else "derivative")
            axes.plot(TIMES[::5], theirs[k, ::5] / scale + rest, ".", color=EXACT,
                      label=None if k else "differences of runs")  # fmt: skip
        count = len(PARAMETERS)
        axes.set(xlabel="time [s]", title=f"moved {where}", ylim=(-2.2 * count - 0.6, 1.1))
        names = [name.removeprefix("effects.").replace("_", " ") for name in PARAMETERS]
        sizes = [f"{name}\n{1e3 * s:.2g} mm" for name, s in zip(names, scales, strict=True)]
        axes.set_yticks(-2.2 * np.arange(count), sizes, fontsize=7)
    panels[0].set(ylabel="change of height per unit of the parameter")
    panels[0].legend(loc="lower left", ncols=2, fontsize=7)
    save(panels[0], path, "Sensitivities of a moving rod")


if __name__ == "__main__":
    main(run, plot)
