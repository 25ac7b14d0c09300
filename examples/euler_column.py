# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A straight rod between pins is pushed together until it buckles: Euler's column."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from report import EXACT, FAINT, OURS, Result, canvas, main, save
from scene import ROPE, WEIGHTLESS, hold, lead, onset, straight
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from dlo_ros.rod.resolution import build
from dlo_ros.rod.statics import Equilibrium
from dlo_ros.spline import FloatArray

SPANS = 28
PINS = ["control_point_1", "control_point_10"]
SHORTENINGS = np.linspace(0.02, 0.5, 13)  # of the distance between the pins, over L


@dataclass(frozen=True)
class EulerColumn(Result):
    """Heights over L (shortenings,) of the bow, ours and exact, and shapes."""

    heights: FloatArray
    exact: FloatArray
    shapes: FloatArray


def critical_force() -> float:
    """The compression at which the straight rod loses its stability [N]."""
    rod = WEIGHTLESS.rod

    def pushed(shortening: float) -> Equilibrium:
        command = hold(PINS, [[[0.0, 0.0, 0.0], [rod.length * (1.0 - shortening), 0.0, 0.0]]])
        model, boundary = build(WEIGHTLESS, command, SPANS)
        return lead(model, boundary, straight(model), command)[-1]

    stretch = rod.young_modulus * rod.area
    euler = np.pi**2 * rod.bending_stiffness / rod.length**2 / stretch
    strains = pushed(onset(lambda s: not pushed(s).buckled, 0.5 * euler, 1.5 * euler)).state.strains
    return -stretch * float(strains.stretch[len(strains.stretch) // 2])  # felt half-way


def height(shortening: float) -> float:
    """Height over L of the inextensible elastica between pins, by elliptic integrals."""
    m = brentq(lambda m: 2.0 - 2.0 * ellipe(m) / ellipk(m) - shortening, 1e-9, 0.95, xtol=1e-14)
    return float(np.sqrt(m) / ellipk(m))


def run() -> EulerColumn:
    """Find the force, then follow the bow that a hair's weight has chosen."""
    rod = ROPE.rod
    expected = np.pi**2 * rod.bending_stiffness / rod.length**2
    found = critical_force()
    error = abs(found / expected - 1.0)
    positions = [[[0.0, 0.0, 0.0], [rod.length * (1.0 - s), 0.0, 0.0]] for s in SHORTENINGS]
    command = hold(PINS, positions)
    model, boundary = build(replace(ROPE, gravity=(0.0, 0.0, -1e-3)), command, SPANS)
    u = np.linspace(0.0, rod.length, 101)
    path = lead(model, boundary, straight(model), command)
    shapes = np.array([model.basis.evaluate(p.state.q[:, :3], u) for p in path])
    heights = np.abs(shapes[:, 50, 2]) / rod.length
    exact = np.array([height(s) for s in SHORTENINGS])
    summary = (
        f"buckles at {1e3 * found:.4f} mN, pi^2 B / L^2 = {1e3 * expected:.4f} mN: within "
        f"{error:.1e}; height of the bow within {np.abs(heights - exact).max():.1e} L"
    )
    return EulerColumn(summary, error, heights, exact, shapes)


def plot(result: EulerColumn, path: Path) -> None:
    """Shapes, and the height of the bow over the shortening."""
    shape, bow = canvas()
    for points in result.shapes[::3]:
        shape.plot(points[:, 0], points[:, 2], color=OURS)
    shape.axhline(0.0, color=FAINT)
    shape.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title="pins pushed together")
    bow.plot(SHORTENINGS, result.heights, color=OURS, label="spline rod")
    bow.plot(SHORTENINGS, result.exact, ".", color=EXACT, label="elliptic integrals")
    bow.set(xlabel="shortening / L", ylabel="height of the bow / L", ylim=(0.0, None))
    bow.legend()
    save(shape, path, "Euler's column")


if __name__ == "__main__":
    main(run, plot)
