# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A stiff wire and a long soft rope with the same settings, and 10 to 100 control points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from elastica import cantilever
from report import EXACT, OURS, Result, canvas, main, save
from scene import ROPE, clamp, lead, straight

from dlo_ros.parameters import RodParameters
from dlo_ros.rod.resolution import build
from dlo_ros.spline import DEGREE, FloatArray

CONTROL_POINTS = (10, 31, 100)
RATIOS = (0.3, 1.0, 3.0, 10.0, 30.0, 60.0)  # L / l
LENGTH, DIAMETER, DENSITY = 1.0, 0.001, 2000.0


@dataclass(frozen=True)
class SoftAndStiff(Result):
    """Errors over L (ratios, control points), shapes with most control points (ratios, m, 3).

    Args:
        stable: whether every equilibrium was found to be stable.
    """

    errors: FloatArray
    shapes: FloatArray
    exact: FloatArray
    stable: bool


def rod_of(ratio: float) -> RodParameters:
    """The rod whose length is so many times l = (B / w)^(1/3)."""
    rod = RodParameters(LENGTH, DIAMETER, 1.0, DENSITY)
    bending = rod.linear_density * 9.81 * (LENGTH / ratio) ** 3
    return replace(rod, young_modulus=bending / rod.second_moment)


def run() -> SoftAndStiff:
    """Settle every rod with every number of control points, from straight."""
    errors = np.empty((len(RATIOS), len(CONTROL_POINTS)))
    u = np.linspace(0.0, LENGTH, 201)
    shapes, exact, stable = [], [], True
    for i, ratio in enumerate(RATIOS):
        settings = replace(ROPE, rod=rod_of(ratio))
        answer = cantilever(settings.rod, settings.rod.linear_density * 9.81)
        for k, count in enumerate(CONTROL_POINTS):
            model, boundary = build(settings, clamp(), count - DEGREE)
            found = lead(model, boundary, straight(model), clamp())[-1]
            stable &= found.stable
            errors[i, k] = answer.distance(model, found.state)
        shapes.append(model.basis.evaluate(found.state.q[:, :3], u))
        exact.append(answer.points(u))
    worst = float(errors[:, -1].max())
    summary = (
        f"mean distance to the elastica at most {worst:.1e} L with {CONTROL_POINTS[-1]} control "
        f"points, L/l from {RATIOS[0]} to {RATIOS[-1]:g}"
    )
    return SoftAndStiff(summary, worst, errors, np.array(shapes), np.array(exact), stable)


def plot(result: SoftAndStiff, path: Path) -> None:
    """Shapes, and the error over the softness."""
    shape, error = canvas()
    for k in range(len(RATIOS)):
        ours, exact = result.shapes[k], result.exact[k]
        shape.plot(ours[:, 0], ours[:, 2], color=OURS, label=None if k else "spline rod")
        shape.plot(
            exact[::10, 0], exact[::10, 2], ".", color=EXACT, label=None if k else "elastica"
        )
    shape.set(xlabel="x / L", ylabel="z / L", aspect="equal")
    shape.set_title(f"L / l from {RATIOS[0]} (right) to {RATIOS[-1]:g} (left)")
    shape.legend()
    for count, errors in zip(CONTROL_POINTS, result.errors.T, strict=True):
        error.loglog(RATIOS, errors, "o-", label=f"{count} control points")
    error.set(xlabel="L / l", ylabel="mean distance / L", xticks=RATIOS)
    error.set_xticklabels([f"{r:g}" for r in RATIOS])
    error.minorticks_off()
    error.legend()
    save(shape, path, "Stiff and soft rods with the same settings")


if __name__ == "__main__":
    main(run, plot)
