# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A rod clamped horizontally bends under its own weight as the planar elastica does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from elastica import cantilever
from report import EXACT, OURS, Result, canvas, main, save
from scene import ROPE, clamp, lead, straight

from dlo_ros.rod.resolution import build
from dlo_ros.spline import FloatArray

SPANS = 56
YOUNG_MODULI = (1e10, 2e8, 5e7, 1e7, 1e6)  # [Pa]


@dataclass(frozen=True)
class Cantilever(Result):
    """Shapes (moduli, points, 3) [m] and distances over L (moduli,)."""

    ratios: FloatArray
    shapes: FloatArray
    exact: FloatArray
    distances: FloatArray


def run() -> Cantilever:
    """Settle one rod for every modulus and solve its boundary value problem."""
    u = np.linspace(0.0, ROPE.rod.length, 101)
    ratios, shapes, exact, distances = [], [], [], []
    for young_modulus in YOUNG_MODULI:
        settings = ROPE.with_material(young_modulus, ROPE.rod.density)
        rod = settings.rod
        model, boundary = build(settings, clamp(), SPANS)
        state = lead(model, boundary, straight(model), clamp())[-1].state
        weight = rod.linear_density * 9.81
        answer = cantilever(rod, weight)
        ratios.append(rod.length / (rod.bending_stiffness / weight) ** (1.0 / 3.0))
        shapes.append(model.basis.evaluate(state.q[:, :3], u))
        exact.append(answer.points(u))
        distances.append(answer.distance(model, state))
    worst = max(distances)
    summary = f"mean distance to the elastica at most {worst:.1e} L, for L/l up to {ratios[-1]:.1f}"
    arrays = (np.array(a) for a in (ratios, shapes, exact, distances))
    return Cantilever(summary, worst, *arrays)


def plot(result: Cantilever, path: Path) -> None:
    """Shapes, and the distance over the softness."""
    shape, error = canvas()
    for k, ratio in enumerate(result.ratios):
        ours, exact = result.shapes[k], result.exact[k]
        first = k == 0
        shape.plot(ours[:, 0], ours[:, 2], color=OURS, label="spline rod" if first else None)
        shape.plot(
            exact[::5, 0], exact[::5, 2], ".", color=EXACT, label="elastica" if first else None
        )
        shape.annotate(
            f"{ratio:.2g}", ours[-1, ::2], (4, -9), textcoords="offset points", fontsize=9
        )
    shape.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title="labels: L / l")
    shape.legend()
    error.loglog(result.ratios, result.distances, "o-", color=OURS)
    error.set(xlabel="L / l", ylabel="mean distance / L", title=f"{SPANS} knot spans")
    save(shape, path, "Cantilever under its own weight")


if __name__ == "__main__":
    main(run, plot)
