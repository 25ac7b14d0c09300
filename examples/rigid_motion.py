# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The laws do not depend on where the rod is: forces turn with it, and in free fall it stays.

Forces are compared through the accelerations that they cause at the moment of release. The rod
falls freely by being held at one end that falls freely: such a hold has nothing to hold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from report import FAINT, OURS, Result, canvas, main, save
from scene import NO_DAMPING, ROPE, hold
from scipy.spatial.transform import Rotation

from dlo_ros.command import NANOSECONDS, Motion
from dlo_ros.observation import Observation
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import FloatArray, SplineBasis

SPANS = 14
FALL = 0.5  # [s]
RELEASE = replace(ROPE.simulation, tolerance=1e-5, start="observed")
BASIS = SplineBasis(ROPE.rod.control_points, ROPE.rod.length)


@dataclass(frozen=True)
class RigidMotion(Result):
    """Differences of the accelerations (turns,), over the largest; and the fall.

    Args:
        fall: largest departure from free fall [m].
        times, departures: the same over time [s], [m].
    """

    turns: FloatArray
    fall: float
    times: FloatArray
    departures: FloatArray


def acceleration(turn: Rotation, shift: FloatArray) -> FloatArray:
    """Accelerations (n, 3) at the release of a bent and stretched rod in a world that is turned."""
    x = BASIS.greville / ROPE.rod.length
    bent = ROPE.rod.length * np.column_stack([x, 0.1 * np.sin(5.0 * x) * x, 0.2 * x**2])
    shape = np.zeros((BASIS.control_points, 4))
    shape[:, :3] = turn.apply(bent) + shift
    held = hold(["control_point_1"], [[shape[0, :3]]])
    settings = replace(ROPE, gravity=tuple(turn.apply([0.0, 0.0, -9.81])), simulation=RELEASE)
    simulation = Simulation(settings, Motion([held]), spans=SPANS)
    simulation.start([Observation(0, shape)])
    assert simulation.state is not None
    result: FloatArray = turn.inv().apply(simulation.state.acceleration[:, :3])
    return result


def free_fall() -> tuple[FloatArray, FloatArray]:
    """Times [s] and largest departures [m] of a straight rod from free fall."""
    shape = np.zeros((BASIS.control_points, 4))
    shape[:, :3] = BASIS.greville[:, None] * np.array([0.8, 0.0, 0.6])
    times = np.linspace(0.0, FALL, 26)
    positions, velocities = np.zeros((2, len(times), 1, 3))
    positions[:, 0, 2], velocities[:, 0, 2] = -0.5 * 9.81 * times**2, -9.81 * times
    command = hold(["control_point_1"], positions, None, velocities, times)
    settings = replace(ROPE, damping=NO_DAMPING, simulation=RELEASE)
    simulation = Simulation(settings, Motion([command]), spans=SPANS)
    simulation.start([Observation(0, shape)])
    departures = []
    for t in times:
        moved = simulation.advance(round(t * NANOSECONDS)).control_points[:, :3] - shape[:, :3]
        moved[:, 2] += 0.5 * 9.81 * t**2
        departures.append(np.linalg.norm(moved, axis=1).max())
    return times, np.array(departures)


def run() -> RigidMotion:
    """Turn and shift the world ten times, then let the rod fall."""
    rng = np.random.default_rng(1)
    here = acceleration(Rotation.identity(), np.zeros(3))
    turns = (
        np.array(
            [
                np.abs(
                    acceleration(Rotation.random(random_state=k), rng.normal(size=3)) - here
                ).max()
                for k in range(10)
            ]
        )
        / np.abs(here).max()
    )
    times, departures = free_fall()
    summary = (
        f"forces of turned and shifted rods differ by {turns.max():.1e} of the largest; "
        f"in free fall a rod departs by {departures.max():.1e} m from a fall of 1.2 m"
    )
    return RigidMotion(summary, turns.max(), turns, departures.max(), times, departures)


def plot(result: RigidMotion, path: Path) -> None:
    """Both differences."""
    force, fall = canvas()
    force.semilogy(np.arange(1, len(result.turns) + 1), result.turns, "o", color=OURS)
    force.axhline(1e-10, ls="--", color=FAINT, label="asked for")
    force.set(xlabel="rotation and shift, by number", ylabel="difference of forces / largest")
    force.legend()
    fall.plot(result.times, 1e12 * result.departures, color=OURS)
    fall.set(xlabel="time [s]", ylabel="departure from free fall [pm]")
    save(force, path, "Rigid motion changes nothing")


if __name__ == "__main__":
    main(run, plot)
