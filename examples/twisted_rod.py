# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A straight rod between clamps is twisted until it buckles into a bow in space."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from report import EXACT, FAINT, OURS, Result, canvas, main, save
from scene import ROPE, WEIGHTLESS, hold, lead, onset, straight, turned
from scipy.optimize import brentq

from dlo_ros.command import Command
from dlo_ros.rod.resolution import build
from dlo_ros.spline import FloatArray

SPANS = (14, 28, 56, 112)


@dataclass(frozen=True)
class TwistedRod(Result):
    """Errors by spans; twists over the critical one, how far the rod leaves its axis, shapes."""

    errors: FloatArray
    twists: FloatArray
    departures: FloatArray
    shapes: FloatArray


def theory() -> float:
    """Critical twist [rad] of linear stability theory, without end force.

    With w = y + i z the sideways displacement obeys B w'''' = i M w''' (M the torque), and clamps
    ask for w = w' = 0 at both ends: tan(x) = x with x = M L / (2 B).
    """
    x = brentq(lambda x: np.sin(x) - x * np.cos(x), np.pi, 1.5 * np.pi)
    rod = WEIGHTLESS.rod
    torsion = rod.shear_modulus * 2.0 * rod.second_moment
    return float(2.0 * x * rod.bending_stiffness / torsion)


def twisting(angles: FloatArray) -> Command:
    """The end is turned about the rod's axis, the ends staying L apart."""
    ends = [[0.0, 0.0, 0.0], [WEIGHTLESS.rod.length, 0.0, 0.0]]
    rotations = np.stack([turned((1, 0, 0), 0.0 * angles), turned((1, 0, 0), angles)], axis=1)
    return hold(["start", "end"], [ends] * len(angles), rotations)


def critical_twist(spans: int, expected: float) -> float:
    """The twist at which the straight rod loses its stability [rad]."""
    model, boundary = build(WEIGHTLESS, twisting(np.zeros(1)), spans)
    base = lead(model, boundary, straight(model), twisting(np.linspace(0.0, 0.9, 6) * expected))

    def stable(twist: float) -> bool:
        state = base[-1].state
        return not lead(model, boundary, state, twisting(np.array([twist])))[-1].buckled

    return onset(stable, 0.9 * expected, 1.1 * expected)


def run() -> TwistedRod:
    """Find the twist at which the rod buckles, and go beyond it under a breath of weight."""
    expected = theory()
    found = np.array([critical_twist(spans, expected) for spans in SPANS])
    errors = np.abs(found / expected - 1.0)
    twists = np.linspace(0.0, 1.3, 66)
    command = twisting(twists * expected)
    model, boundary = build(replace(ROPE, gravity=(0.0, 0.0, -1e-3)), command, 56)
    path = lead(model, boundary, straight(model), command)
    u = np.linspace(0.0, ROPE.rod.length, 201)
    shapes = np.array([model.basis.evaluate(p.state.q[:, :3], u) for p in path])
    departures = np.hypot(shapes[..., 1], shapes[..., 2]).max(axis=1) / ROPE.rod.length
    summary = (
        f"buckles at {found[-1]:.4f} rad, theory {expected:.4f} rad: within {errors[-1]:.1e} "
        f"with {SPANS[-1]} spans"
    )
    return TwistedRod(summary, float(errors[-1]), errors, twists, departures, shapes)


def plot(result: TwistedRod, path: Path) -> None:
    """The last shape in space, how far the rod leaves its axis, and the error over the spans."""
    space, curve, error = canvas(3, ("3d", None, None))
    x, y, z = result.shapes[-1].T
    space.plot(x, 1e3 * y, 1e3 * z, color=OURS, lw=2)
    space.plot(x, 0.0 * x, 0.0 * x, "--", color=FAINT)
    space.set(xlabel="x [m]", ylabel="y [mm]", zlabel="z [mm]")
    space.set_title(f"at {result.twists[-1]:.1f} times the critical twist")
    space.locator_params(nbins=5)
    curve.plot(result.twists, result.departures, color=OURS, label="spline rod")
    curve.axvline(1.0, ls="--", color=EXACT, label="linear stability theory")
    curve.set(xlabel="twist / critical twist", ylabel="departure from the axis / L")
    curve.legend()
    error.loglog(SPANS, result.errors, "o-", color=OURS)
    error.set(xlabel="knot spans", ylabel="error of the critical twist", xticks=SPANS)
    error.set_xticklabels(SPANS)
    error.minorticks_off()
    save(space, path, "A rod between clamps, twisted until it buckles")


if __name__ == "__main__":
    main(run, plot)
