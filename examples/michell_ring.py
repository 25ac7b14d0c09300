# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A ring that is twisted too far leaves its plane (Michell 1889): at 2 pi sqrt(3) B / C.

A straight rod is bent into a circle, one end is turned by the twist and joined to the other. Both
ends are then at one place with one tangent and their material frames are fixed to each other. Any
motion of such a ring is a rigid motion and a motion that keeps the joint where it is, and a rigid
motion costs nothing: so the ring is stable when the rod with both ends clamped at one place,
along one tangent, is. One freedom is left: turning about the tangent of the joint, every section
spinning back about itself, costs nothing for a round rod. A breath of weight, with the ring
hanging from the joint, decides it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from report import EXACT, FAINT, OURS, Result, canvas, main, save
from scene import ROPE, hold, lead, onset, turned

from dlo_ros.command import Command
from dlo_ros.errors import SimulationError
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.resolution import build
from dlo_ros.rod.state import State, rest_state, twist_angle
from dlo_ros.spline import FloatArray

SPANS = 112
BREATH = replace(ROPE, gravity=(0.0, 0.0, -1e-2))  # a thousandth of the earth's


@dataclass(frozen=True)
class MichellRing(Result):
    """Twists over the critical one, departures over L, twists left and lost [rad], shapes [m]."""

    twists: FloatArray
    departures: FloatArray
    left: FloatArray
    lost: float
    shapes: FloatArray


def theory() -> float:
    """Critical twist [rad]."""
    rod = ROPE.rod
    return float(
        2.0 * np.pi * np.sqrt(3.0) * rod.bending_stiffness
        / (rod.shear_modulus * 2.0 * rod.second_moment)
    )  # fmt: skip


def twisting(angles: FloatArray) -> Command:
    """Both ends at the origin along x, the last one turned by angles (T,) [rad]."""
    rotations = np.stack([turned((1, 0, 0), 0.0 * angles), turned((1, 0, 0), angles)], axis=1)
    return hold(["start", "end"], np.zeros((len(angles), 2, 3)), rotations)


def ring(spans: int) -> tuple[RodModel, Boundary, State]:
    """Model, boundary, and a circle below the origin, free of twist."""
    model, boundary = build(BREATH, twisting(np.zeros(1)), spans)
    length = ROPE.rod.length
    u = np.linspace(0.0, length, 20 * spans + 1)
    angle, radius = 2.0 * np.pi * u / length, length / (2.0 * np.pi)
    circle = radius * np.column_stack([np.sin(angle), 0.0 * u, np.cos(angle) - 1.0])
    q = np.zeros((model.basis.control_points, 4))
    q[:, :3] = model.basis.fit(u, circle)
    return model, boundary, rest_state(0, q, model)


def critical_twist(expected: float) -> float:
    """The twist at which the plane ring loses its stability [rad]."""
    model, boundary, state = ring(SPANS)
    base = lead(model, boundary, state, twisting(np.linspace(0.0, 0.9, 10) * expected))[-1].state

    def stable(twist: float) -> bool:
        try:
            found = lead(model, boundary, base, twisting(np.array([twist])))[-1]
        except SimulationError:
            return False  # it left the plane and found no rest on the way
        kept = abs(twist_angle(found.state, model)[-1] - twist) < 1.0
        return not found.buckled and kept

    return onset(stable, 0.9 * expected, 1.1 * expected)


def run() -> MichellRing:
    """Find the twist at which the ring buckles, and go beyond it."""
    expected = theory()
    found = critical_twist(expected)
    error = abs(found / expected - 1.0)
    model, boundary, state = ring(56)
    twists = np.concatenate([np.linspace(0.0, 0.95, 20), np.linspace(0.96, 1.2, 25)])
    path = lead(model, boundary, state, twisting(twists * expected))
    u = np.linspace(0.0, ROPE.rod.length, 201)
    shapes = np.array([model.basis.evaluate(p.state.q[:, :3], u) for p in path])
    departures = np.abs(shapes[..., 1]).max(axis=1) / ROPE.rod.length
    left = np.array([twist_angle(p.state, model)[-1] for p in path])
    lost = twists[-1] * expected - left[-1]
    summary = (
        f"buckles at {found:.4f} rad, 2 pi sqrt(3) B/C = {expected:.4f} rad: within {error:.1e}; "
        f"beyond, the ring passes through itself and loses {lost:.3f} "
        "rad, 4 pi = 12.566"
    )
    return MichellRing(summary, error, twists, departures, left, lost, shapes)


def plot(result: MichellRing, path: Path) -> None:
    """The shape near the loss of stability, how far the ring leaves its plane, the twist left."""
    space, curve, twist = canvas(3, ("3d", None, None))
    most = int(np.argmax(result.departures))
    magnify = np.array([1.0, 0.05 / result.departures[most], 1.0])
    space.plot(*result.shapes[0].T, color=FAINT, label="without twist")
    label = f"at {result.twists[most]:.2f}, departure $\\times$ {magnify[1]:.0f}"
    space.plot(*(result.shapes[most] * magnify).T, color=OURS, lw=2, label=label)
    space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", aspect="equal")
    space.locator_params(nbins=3)
    space.locator_params(axis="y", nbins=2)
    space.legend(loc="upper left")
    curve.semilogy(result.twists[1:], result.departures[1:], ".-", color=OURS)
    curve.set(xlabel="twist / critical twist", ylabel="departure from the plane / L")
    expected = theory()
    twist.plot(result.twists, result.left, ".-", color=OURS, label="left in the ring")
    twist.plot(result.twists, result.twists * expected, ":", color=FAINT, label="imposed")
    twist.plot(
        result.twists, result.twists * expected - 4.0 * np.pi, "--", color=FAINT,
        label=r"imposed less $4 \pi$",
    )  # fmt: skip
    twist.set(xlabel="twist / critical twist", ylabel="twist [rad]", ylim=(0.0, None))
    for axes in (curve, twist):
        axes.axvline(1.0, ls="--", color=EXACT, label=r"$2 \pi \sqrt{3} B / C$")
    twist.legend()
    save(space, path, "Michell's ring: a circle twisted until it leaves its plane")


if __name__ == "__main__":
    main(run, plot)
