# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A weightless rod clamped at one end carries a load at the other, from small to very large."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from elastica import cantilever
from report import EXACT, FAINT, OURS, Result, canvas, main, save
from scene import WEIGHTLESS, clamp, lead, straight

from dlo_ros.rod.resolution import build
from dlo_ros.spline import FloatArray

SPANS = 56
LOADS = np.geomspace(1e-3, 30.0, 10)  # P L^2 / B


@dataclass(frozen=True)
class TipLoad(Result):
    """Deflections of the tip over L (loads,): ours, the elastica's; shapes (loads, points, 3)."""

    deflections: FloatArray
    exact: FloatArray
    shapes: FloatArray
    linear_error: float


def run() -> TipLoad:
    """Settle under every load, from the equilibrium before."""
    rod = WEIGHTLESS.rod
    model, boundary = build(WEIGHTLESS, clamp(), SPANS)
    state = straight(model)
    u = np.linspace(0.0, rod.length, 101)
    deflections, exact, shapes, distances = [], [], [], []
    for load in LOADS:
        force = load * rod.bending_stiffness / rod.length**2
        loaded = replace(model, point_forces=((rod.length, (0.0, 0.0, -force)),))
        state = lead(loaded, boundary, state, clamp())[-1].state
        answer = cantilever(rod, tip_force=force)
        deflections.append(-state.q[-1, 2] / rod.length)
        exact.append(-answer.points(u)[-1, 2] / rod.length)
        shapes.append(model.basis.evaluate(state.q[:, :3], u))
        distances.append(answer.distance(model, state))
    linear = abs(deflections[0] / (LOADS[0] / 3.0) - 1.0)
    worst = max(distances)
    summary = (
        f"mean distance to the elastica at most {worst:.1e} L; "
        f"P L^3 / (3 B) at a small load within {linear:.1e}"
    )
    return TipLoad(summary, worst, np.array(deflections), np.array(exact), np.array(shapes), linear)


def plot(result: TipLoad, path: Path) -> None:
    """Shapes, and the deflection over the load."""
    shape, curve = canvas()
    for points in result.shapes:
        shape.plot(points[:, 0], points[:, 2], color=OURS)
    shape.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title="spline rod")
    curve.loglog(LOADS, LOADS / 3.0, "--", color=FAINT, label="small loads, $P L^3 / (3 B)$")
    curve.loglog(LOADS, result.deflections, color=OURS, label="spline rod")
    curve.loglog(LOADS, result.exact, ".", color=EXACT, label="elastica")
    curve.set(xlabel="$P L^2 / B$", ylabel="deflection of the tip / L", ylim=(1e-4, 3.0))
    curve.legend()
    save(shape, path, "Cantilever with a load at its tip")


if __name__ == "__main__":
    main(run, plot)
