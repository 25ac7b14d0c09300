# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How the error falls with the number of control points, and what stops it.

A spline rod is compared with the elastica for cantilevers that differ in softness alone, and with
the best that a cubic spline with so many control points can do: the elastica's projection onto
the basis, which falls with the fourth power of the spacing. The rod follows at first; then the
stretch stops it: it is integrated with one point a knot span (more would lock), and a clamp holds
|r'| = 1 whatever the tension. What is left falls with the first power of the spacing and is at
most about the strain w L / (E A) times the spacing, which is drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from elastica import cantilever
from report import FAINT, Result, canvas, main, save
from scene import ROPE, clamp, lead, straight

from dlo_ros.rod.resolution import build
from dlo_ros.spline import FloatArray, SplineBasis

SPANS = (4, 7, 14, 28, 56, 112)
YOUNG_MODULI = (1e9, 5e7, 1e6)  # [Pa]


@dataclass(frozen=True)
class Refinement(Result):
    """L/l, w L / (E A) and orders (moduli,); errors of rod and best spline (moduli, spans)."""

    ratios: FloatArray
    strains: FloatArray
    errors: FloatArray
    best: FloatArray
    orders: FloatArray


def run() -> Refinement:
    """Settle every rod with every number of spans."""
    ratios, strains, errors, best = [], [], [], []
    for young_modulus in YOUNG_MODULI:
        rod = ROPE.with_material(young_modulus, ROPE.rod.density).rod
        weight = rod.linear_density * 9.81
        answer = cantilever(rod, weight)
        ratios.append(rod.length / (rod.bending_stiffness / weight) ** (1.0 / 3.0))
        strains.append(weight * rod.length / (rod.young_modulus * rod.area))
        for spans in SPANS:
            settings = ROPE.with_material(young_modulus, ROPE.rod.density)
            model, boundary = build(settings, clamp(), spans)
            state = lead(model, boundary, straight(model), clamp())[-1].state
            errors.append(answer.distance(model, state))
            best.append(projection_error(model.basis, answer.points))
    shape = (len(YOUNG_MODULI), len(SPANS))
    found = np.array(errors).reshape(shape)
    orders = np.log2(found[:, 1] / found[:, 2])
    summary = (
        f"from 7 to 14 spans the error falls with order {orders[0]:.1f}, {orders[1]:.1f}, "
        f"{orders[2]:.1f} (L/l of {ratios[0]:.1f}, {ratios[1]:.1f}, {ratios[2]:.1f}); "
        f"with {SPANS[-1]} it is {found[:, -1].max():.1e} L or less"
    )
    return Refinement(
        summary, float(found[:, -1].max()), np.array(ratios), np.array(strains),
        found, np.array(best).reshape(shape), orders,
    )  # fmt: skip


def projection_error(basis: SplineBasis, points: Callable[[FloatArray], FloatArray]) -> float:
    """Mean distance over L of a curve to its best approximation by a spline."""
    u, weight = basis.quadrature(8)
    b, r = basis.matrix(u), points(u)
    fit = b @ np.linalg.solve(b.T @ (weight[:, None] * b), b.T @ (weight[:, None] * r))
    return float(weight @ np.linalg.norm(fit - r, axis=1)) / basis.length**2


def plot(result: Refinement, path: Path) -> None:
    """Errors over the number of spans, the rod's and the best possible, with what stops it."""
    panels = canvas(3)
    for axes, ratio, strain, errors, best in zip(
        panels, result.ratios, result.strains, result.errors, result.best, strict=True
    ):
        axes.loglog(SPANS, errors, "o-", label="spline rod")
        axes.loglog(SPANS, best, "s-", label="best cubic spline")
        fourth = best[-2] * (SPANS[-2] / np.array(SPANS)) ** 4.0
        axes.loglog(SPANS, fourth, ":", color=FAINT, label="order 4")
        axes.loglog(
            SPANS, strain / np.array(SPANS), "--", color=FAINT, label="strain x spacing / L"
        )
        axes.set(xlabel="knot spans (control points - 3)", title=f"L / l = {ratio:.1f}")
        axes.set(xticks=SPANS, xticklabels=SPANS, ylim=(1e-11, 3e-1))
        axes.minorticks_off()
    panels[0].set(ylabel="mean distance to the elastica / L")
    panels[0].legend()
    save(panels[0], path, "Refinement: a cantilever under its own weight")


if __name__ == "__main__":
    main(run, plot)
