# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A falling cantilever keeps its energy without damping, and only loses it with damping."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from report import OURS, Result, canvas, main, save
from scene import NO_DAMPING, ROPE, clamp

from dlo_ros.command import NANOSECONDS, Motion
from dlo_ros.observation import Observation
from dlo_ros.parameters import DampingParameters, Settings
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod.state import State
from dlo_ros.spline import FloatArray, SplineBasis

SPANS = 10
FINE = 2e-5  # simulation.tolerance
TIMES = np.linspace(0.0, 1.5, 91)  # [s]
CASES = {
    "no damping": NO_DAMPING,
    "drag 0.05 N s/m$^2$": DampingParameters(air_drag=0.05, relaxation_time=0.0),
    "relaxation time 5 ms": DampingParameters(air_drag=0.0, relaxation_time=0.005),
}


@dataclass(frozen=True)
class Energy(Result):
    """Energies (cases, times) over the greatest kinetic energy, and more without damping.

    Args:
        coarse: total energy (times,) without damping, at the default tolerance.
        kinetic: kinetic energy (times,) without damping.
        growth: largest growth between two instants, of the damped cases, likewise.
    """

    total: FloatArray
    coarse: FloatArray
    kinetic: FloatArray
    growth: float


def energies(model: RodModel, state: State) -> tuple[float, float]:
    """Kinetic and total energy [J], from strains, velocities and heights."""
    rod, basis = model.settings.rod, model.basis
    u, weight = basis.quadrature()
    b = basis.matrix(u)
    speed = (b @ state.velocity) ** 2
    spin = rod.density * 2.0 * rod.second_moment * speed[:, 3]
    kinetic = 0.5 * weight @ (rod.linear_density * speed[:, :3].sum(axis=1) + spin)
    stiff, rule = model.stiffness, model.rule
    moduli = np.column_stack([stiff.bend[:, :2], stiff.twist])  # the section is round
    elastic = 0.5 * (rule.weight * stiff.stretch) @ state.strains.stretch**2
    elastic += 0.5 * rule.weight @ (moduli * state.strains.other**2).sum(axis=1)
    height = -(weight @ b @ state.q[:, :3] @ np.array(model.settings.gravity)) * rod.linear_density
    return float(kinetic), float(kinetic + elastic + height)


def swing(settings: Settings) -> FloatArray:
    """Kinetic and total energy of the fall at TIMES, shape (times, 2) [J]."""
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    shape = np.zeros((basis.control_points, 4))
    shape[:, 0] = basis.greville
    simulation = Simulation(settings, Motion([clamp()]), spans=SPANS)
    simulation.start([Observation(0, shape)])
    found = []
    for t in TIMES:
        simulation.advance(round(t * NANOSECONDS))
        assert simulation.state is not None
        found.append(energies(simulation.model, simulation.state))
    return np.array(found)


def run() -> Energy:
    """Let the rod fall with every kind of damping."""
    fine = replace(ROPE.simulation, tolerance=FINE, start="observed")
    runs = np.array(
        [swing(replace(ROPE, damping=damping, simulation=fine)) for damping in CASES.values()]
    )
    default = replace(ROPE.simulation, start="observed")
    coarse = swing(replace(ROPE, damping=NO_DAMPING, simulation=default))[:, 1]
    scale = runs[0, :, 0].max()
    total = (runs[:, :, 1] - runs[:, :1, 1]) / scale
    drift = float(np.abs(total[0]).max())
    growth = float(np.diff(total[1:], axis=1).max())
    summary = (
        f"energy drifts by {drift:.1e} of the greatest kinetic energy in 1.5 s without damping; "
        f"with damping it grows by at most {growth:.1e} between two instants"
    )
    return Energy(
        summary, drift, total, (coarse - coarse[0]) / scale, runs[0, :, 0] / scale, growth
    )


def plot(result: Energy, path: Path) -> None:
    """The energies over time, and the drift alone."""
    swing_, drift = canvas()
    for name, total in zip(CASES, result.total, strict=True):
        swing_.plot(TIMES, total, label=name)
    swing_.plot(TIMES, result.kinetic, ":", color="0.6", label="kinetic, no damping")
    swing_.set(xlabel="time [s]", ylim=(-1.1, 2.0), ylabel="energy / greatest kinetic energy")
    swing_.legend(loc="upper right")
    drift.plot(TIMES, 1e3 * result.coarse, "--", color=OURS, label="tolerance 2e-4 (default)")
    drift.plot(TIMES, 1e3 * result.total[0], color=OURS, label=f"tolerance {FINE:.0e}")
    drift.legend()
    drift.set(xlabel="time [s]", ylabel="energy / greatest kinetic energy [1e-3]")
    drift.set_title("no damping")
    save(swing_, path, "Energy of a falling cantilever")


if __name__ == "__main__":
    main(run, plot)
