# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A rope between two pins tends to the catenary as its bending stiffness vanishes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from report import EXACT, OURS, Result, canvas, main, save
from scene import ROPE, hold, lead, straight
from scipy.optimize import fsolve

from dlo_ros.parameters import RodParameters
from dlo_ros.rod.resolution import build
from dlo_ros.spline import FloatArray

SPANS = 112
SPAN, RISE = 0.6, 0.1  # between the pins [m]
DIAMETERS = (8e-3, 4e-3, 2e-3, 1e-3, 0.5e-3)  # [m]


@dataclass(frozen=True)
class Catenary(Result):
    """Shapes (diameters, points, 3) [m], largest distances over L, and L/l (diameters,)."""

    ratios: FloatArray
    shapes: FloatArray
    exact: FloatArray
    distances: FloatArray


def catenary(rod: RodParameters, u: FloatArray) -> FloatArray:
    """The elastic catenary from the origin to (SPAN, RISE), in closed form, shape (m, 2)."""
    weight, stretch, length = rod.linear_density * 9.81, rod.young_modulus * rod.area, rod.length

    def shape(forces: FloatArray, u: FloatArray) -> FloatArray:
        h, v = forces  # tension along x, and along z at the first pin
        z = v + weight * u
        x = h * u / stretch + h / weight * (np.arcsinh(z / h) - np.arcsinh(v / h))
        y = (z**2 - v**2) / (2.0 * weight * stretch) + (np.hypot(h, z) - np.hypot(h, v)) / weight
        return np.column_stack([x, y])

    scale = weight * length
    found = fsolve(
        lambda f: shape(scale * f, np.array([length]))[0] - (SPAN, RISE), (0.2, -0.5), xtol=1e-13
    )
    return shape(scale * found, u)


def run() -> Catenary:
    """Bring the ends of a straight rope together and let it hang."""
    ends = np.linspace([0.98, 0.0, -0.05], [SPAN, 0.0, RISE], 8)
    positions = [[[0.0, 0.0, 0.0], end] for end in ends]
    ratios, shapes, exact, distances = [], [], [], []
    for diameter in DIAMETERS:
        settings = replace(ROPE, rod=RodParameters(1.0, diameter, 2e7, 2000.0))
        rod = settings.rod
        command = hold(["control_point_1", "control_point_10"], positions)
        model, boundary = build(settings, command, SPANS)
        state = lead(model, boundary, straight(model), command)[-1].state
        u = np.linspace(0.0, rod.length, 201)
        shapes.append(model.basis.evaluate(state.q[:, :3], u))
        exact.append(catenary(rod, u))
        distances.append(np.linalg.norm(shapes[-1][:, ::2] - exact[-1], axis=1).max())
        weight = rod.linear_density * 9.81
        ratios.append(rod.length / (rod.bending_stiffness / weight) ** (1.0 / 3.0))
    error = distances[-1]
    summary = f"largest distance to the elastic catenary {error:.1e} L at L/l = {ratios[-1]:.0f}"
    arrays = (np.array(a) for a in (ratios, shapes, exact, distances))
    return Catenary(summary, error, *arrays)


def plot(result: Catenary, path: Path) -> None:
    """Shapes of the stiffest and the softest rope, and the distance over the softness."""
    shape, error = canvas()
    for k, style in ((0, "--"), (-1, "-")):
        ours = result.shapes[k]
        label = f"spline rod, L/l = {result.ratios[k]:.0f}"
        shape.plot(ours[:, 0], ours[:, 2], style, color=OURS, label=label)
    shape.plot(*result.exact[-1][::10].T, ".", color=EXACT, label="catenary")
    shape.set(xlabel="x [m]", ylabel="z [m]", aspect="equal")
    shape.legend()
    error.loglog(result.ratios, result.distances, "o-", color=OURS, label="spline rod")
    slope = result.distances[-1] * (result.ratios / result.ratios[-1]) ** -3.0
    error.loglog(result.ratios, slope, "--", color=EXACT, label="proportional to B")
    error.set(xlabel="L / l", ylabel="largest distance / L")
    error.legend()
    save(shape, path, "Without bending stiffness a rope hangs as a catenary")


if __name__ == "__main__":
    main(run, plot)
