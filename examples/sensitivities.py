"""Derivatives with respect to stiffness, density and damping, against differences of runs.

The gripped end of a cantilever is moved for half a second. All runs take the same steps (a loose
tolerance never shortens them), so that differences are those of the solution alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from report import EXACT, OURS, Result, canvas, main, save
from scene import ROPE, hold

from dlo_ros.command import NANOSECONDS, Motion
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.model import SENSITIVITIES
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import FloatArray, SplineBasis

SPANS = 14
PLACES = {"in the plane": (0.0, 0.0, 0.1), "in space": (0.0, 0.1, 0.05)}  # where it goes [m]
TIMES = np.arange(0.0, 0.8, 4e-3)  # [s]
STEP = 1e-4  # of the logarithm
NAMES = [name.replace("_", "\n") for name in SENSITIVITIES]


@dataclass(frozen=True)
class Sensitivities(Result):
    """Height of the tip per unit of ln(parameter) (motions, parameters, times) [m], twice.

    Args:
        errors: of the whole shape, over the parameter's largest derivative (motions, parameters).
    """

    exact: FloatArray
    differences: FloatArray
    errors: FloatArray


def shapes(
    settings: Settings, place: Sequence[float], parameters: tuple[str, ...] = ()
) -> tuple[FloatArray, FloatArray]:
    """Shapes (times, n, 3) of a run and their derivatives (parameters, times, n, 3)."""
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    straight = np.zeros((basis.control_points, 4))
    straight[:, 0] = basis.greville
    command = hold(["start"], [[[0.0, 0.0, 0.0]], [place]], times=np.array([0.0, 0.5]))
    simulation = Simulation(settings, Motion([command]), parameters=parameters, spans=SPANS)
    simulation.start([Observation(0, straight)])
    path = [simulation.advance(round(t * NANOSECONDS)) for t in TIMES]
    derivatives = np.array([p.sensitivity for p in path if p.sensitivity is not None])
    if parameters:
        derivatives = derivatives.swapaxes(0, 1)
    return np.array([p.control_points[:, :3] for p in path]), derivatives


def differences(settings: Settings, place: Sequence[float]) -> FloatArray:
    """The same derivatives by central differences of whole runs."""
    found = []
    for name in SENSITIVITIES:
        group = "rod" if hasattr(settings.rod, name) else "damping"
        old = getattr(settings, group)
        pair = []
        for sign in (1.0, -1.0):
            changed = replace(old, **{name: getattr(old, name) * np.exp(sign * STEP)})
            pair.append(shapes(replace(settings, **{group: changed}), place)[0])
        found.append((pair[0] - pair[1]) / (2.0 * STEP))
    return np.array(found)


def run() -> Sensitivities:
    """For each motion one run with derivatives, and two more for each parameter."""
    settings = replace(ROPE, simulation=replace(ROPE.simulation, tolerance=0.1))
    exact, rough = [], []
    for place in PLACES.values():
        exact.append(shapes(settings, place, SENSITIVITIES)[1])
        rough.append(differences(settings, place))
    ours, theirs = np.array(exact), np.array(rough)
    apart = np.abs(ours - theirs).max(axis=(2, 3, 4))
    errors = apart / np.abs(theirs).max(axis=(2, 3, 4))
    summary = "derivatives agree with differences of runs to " + ", ".join(
        f"{e.max():.1e} {where}" for where, e in zip(PLACES, errors, strict=True)
    )
    return Sensitivities(summary, float(errors.max()), ours[..., -1, 2], theirs[..., -1, 2], errors)


def plot(result: Sensitivities, path: Path) -> None:
    """How the tip's height depends on every parameter, in both motions."""
    panels = canvas()
    for axes, where, ours, theirs in zip(
        panels, PLACES, result.exact, result.differences, strict=True
    ):
        scales = np.abs(theirs).max(axis=1)
        for k, scale in enumerate(scales):
            rest = -2.2 * k
            axes.plot(TIMES, ours[k] / scale + rest, color=OURS, label=None if k else "derivative")
            axes.plot(TIMES[::5], theirs[k, ::5] / scale + rest, ".", color=EXACT,
                      label=None if k else "differences of runs")  # fmt: skip
        axes.set(xlabel="time [s]", title=f"clamp moved {where}", ylim=(-8.8, 1.1))
        names = [f"{name}\n{1e3 * s:.2g} mm" for name, s in zip(NAMES, scales, strict=True)]
        axes.set_yticks(-2.2 * np.arange(len(names)), names)
    panels[0].set(ylabel="d (height of the tip) / d ln(parameter), and its largest")
    panels[0].legend(loc="lower left", ncols=2)
    save(panels[0], path, "Sensitivities of a moving rod")


if __name__ == "__main__":
    main(run, plot)
