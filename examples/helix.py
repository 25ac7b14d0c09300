# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A rod with rest curvature and rest twist, and no load, is the helix that they define."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from report import EXACT, OURS, Result, canvas, main, save
from scene import WEIGHTLESS, clamp, lead, straight

from dlo_ros.rod.resolution import build
from dlo_ros.spline import FloatArray

SPANS = (14, 28, 56, 112)
TURNS, PITCH_ANGLE = 3.0, 0.4  # how often it winds about its axis; steepness [rad]


@dataclass(frozen=True)
class Helix(Result):
    """Mean distances over L by spans, and the finest shape beside the exact one (points, 3)."""

    errors: FloatArray
    shape: FloatArray
    exact: FloatArray


def helix(u: FloatArray, curvature: float, torsion: float) -> FloatArray:
    """Frenet's helix that starts at the origin along x and curves towards -z, shape (m, 3)."""
    rate = np.hypot(curvature, torsion)
    radius = curvature / rate**2
    round_, along = rate * u, torsion / rate * u
    # In its own axes: x towards the axis, y the way round, z along the axis.
    inward, across = radius * (1.0 - np.cos(round_)), radius * np.sin(round_)
    c, s = curvature / rate, torsion / rate  # of the angle between tangent and the way round
    return np.column_stack([c * across + s * along, c * along - s * across, -inward])


def constant(strains: FloatArray, u: FloatArray) -> FloatArray:
    """The same rest strains at all u, shape (m, 3)."""
    return np.tile(strains, (len(u), 1))


def run() -> Helix:
    """Give a straight rod its rest strains step by step, and compare where it ends."""
    length = WEIGHTLESS.rod.length
    rate = 2.0 * np.pi * TURNS / length
    curvature, torsion = rate * np.cos(PITCH_ANGLE), rate * np.sin(PITCH_ANGLE)
    errors = []
    for spans in SPANS:
        model, boundary = build(WEIGHTLESS, clamp(), spans)
        state = straight(model)
        for share in np.linspace(0.1, 1.0, 10):
            strains = share * np.array([curvature, 0.0, torsion])
            wound = replace(model, rest=partial(constant, strains))
            state = lead(wound, boundary, state, clamp())[-1].state
        u, weight = model.basis.quadrature(6)
        apart = model.basis.evaluate(state.q[:, :3], u) - helix(u, curvature, torsion)
        errors.append(float(weight @ np.linalg.norm(apart, axis=1)) / length**2)
    u = np.linspace(0.0, length, 241)
    shape = model.basis.evaluate(state.q[:, :3], u)
    summary = (
        f"mean distance to the helix {errors[-1]:.1e} L with {SPANS[-1]} spans, {TURNS:g} turns"
    )
    return Helix(summary, errors[-1], np.array(errors), shape, helix(u, curvature, torsion))


def plot(result: Helix, path: Path) -> None:
    """Both helices, and the error over the number of spans."""
    space, error = canvas(projections=("3d", None))
    space.plot(*result.shape.T, color=OURS, label="spline rod")
    space.plot(*result.exact[::6].T, ".", color=EXACT, label="helix")
    space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", aspect="equal")
    space.locator_params(nbins=4)
    space.locator_params(axis="z", nbins=2)
    space.legend(loc="upper left")
    error.loglog(SPANS, result.errors, "o-", color=OURS)
    error.set(xlabel="knot spans", ylabel="mean distance / L", xticks=SPANS, xticklabels=SPANS)
    error.minorticks_off()
    save(space, path, "Rest curvature and rest twist make a helix")


if __name__ == "__main__":
    main(run, plot)
