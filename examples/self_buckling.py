# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""An upright column that is too long buckles under its own weight."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from elastica import cantilever
from report import EXACT, FAINT, OURS, Result, canvas, main, save
from scene import ROPE, hold, lead, onset, straight, turned

from dlo_ros.command import Command
from dlo_ros.rod.resolution import build
from dlo_ros.rod.state import rest_state
from dlo_ros.spline import FloatArray

SPANS = 28
GREENHILL = 7.8373  # L^3 w / B, where w is the weight per length
LEAN = 1e-3  # [rad]


def clamped(*angles: float) -> Command:
    """The foot is held at the origin, upwards at angles against x [rad]."""
    rotations = turned((0.0, -1.0, 0.0), np.array(angles))[:, None]
    return hold(["start"], [[[0.0, 0.0, 0.0]]] * len(angles), rotations)


UPRIGHT = clamped(0.5 * np.pi)
LEANING = clamped(0.5 * np.pi - LEAN)
BENDING = clamped(*np.linspace(0.0, 0.5 * np.pi - LEAN, 8))


@dataclass(frozen=True)
class SelfBuckling(Result):
    """Lengths over the critical one, sideways place of the tip over L, and shapes beyond."""

    lengths: FloatArray
    tips: FloatArray
    exact: FloatArray
    shapes: FloatArray


def critical_length() -> float:
    """The length at which the upright column loses its stability [m]."""

    def stable(length: float) -> bool:
        settings = replace(ROPE, rod=replace(ROPE.rod, length=length))
        model, boundary = build(settings, UPRIGHT, SPANS)
        return not lead(model, boundary, straight(model, (0.0, 0.0, 1.0)), UPRIGHT)[-1].buckled

    return onset(stable, 0.2, 0.3)


def run() -> SelfBuckling:
    """Find where the column buckles, and follow a column that leans by a thousandth of a radian."""
    rod = ROPE.rod
    expected = (GREENHILL * rod.bending_stiffness / (rod.linear_density * 9.81)) ** (1.0 / 3.0)
    found = critical_length()
    error = abs(found / expected - 1.0)
    lengths, tips, exact, shapes = np.linspace(1.4, 0.8, 25), [], [], []
    answer, q = None, None
    for share in lengths:  # from long, bent over, to short
        leaning = replace(rod, length=share * expected)
        model, boundary = build(replace(ROPE, rod=leaning), LEANING, SPANS)
        if q is None or answer is None:
            state = lead(model, boundary, straight(model), BENDING)[-1].state
        else:
            state = rest_state(0, q * (leaning.length / answer.length), model)
        q = lead(model, boundary, state, LEANING)[-1].state.q
        answer = cantilever(
            leaning, rod.linear_density * 9.81, angle=0.5 * np.pi - LEAN, guess=answer
        )
        u = np.linspace(0.0, leaning.length, 61)
        tips.append(q[-1, 0] / leaning.length)
        exact.append(answer.points(u)[-1, 0] / leaning.length)
        shapes.append(model.basis.evaluate(q[:, :3], u))
    summary = f"buckles at {found:.5f} m, (7.8373 B/w)^(1/3) = {expected:.5f} m: within {error:.1e}"
    return SelfBuckling(summary, error, lengths, np.array(tips), np.array(exact), np.array(shapes))


def plot(result: SelfBuckling, path: Path) -> None:
    """Shapes of the leaning column, and where its tip goes."""
    shape, tip = canvas()
    for points in result.shapes[::4]:
        shape.plot(points[:, 0], points[:, 2], color=OURS)
    shape.axhline(0.0, color=FAINT)
    shape.set(
        xlabel="x [m]", ylabel="z [m]", aspect="equal", title=f"clamped {LEAN:g} rad off upright"
    )
    tip.plot(result.lengths, result.tips, color=OURS, label="spline rod")
    tip.plot(result.lengths, result.exact, ".", color=EXACT, label="elastica")
    tip.axvline(1.0, ls="--", color=FAINT, label="linear stability theory")
    tip.set(xlabel="length / critical length", ylabel="sideways place of the tip / L")
    tip.legend()
    save(shape, path, "A column that buckles under its own weight")


if __name__ == "__main__":
    main(run, plot)
