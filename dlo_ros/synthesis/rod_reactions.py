# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Forces and torques of the grips on the discrete rod, and sensors that measure them.

A grip's force is the derivative of the potential that a time step minimises, inertia included, by
the place that it imposes; its torque the derivative by the direction that it imposes and, in space,
by its turn about the rod.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import END, NANOSECONDS, START
from dlo_ros.errors import InputError
from dlo_ros.observation import Wrenches
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis import spatial_energy
from dlo_ros.synthesis.experiment import START_STAMP
from dlo_ros.synthesis.rod_kernels import BANDS, elastic
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation
from dlo_ros.synthesis.rod_steps import PlanarPotential, evaluate
from dlo_ros.synthesis.spatial_simulation import SpatialSimulation
from dlo_ros.synthesis.true_motion import Truth, simulate
from dlo_ros.synthesis.wrench_sensor import WrenchSensor

TURN = 1e-5
"""By which a clamp is turned for the derivative [rad]."""
WITHIN = 5e-3
"""Time to either side over which a tool's acceleration is taken [s]."""


def reactions(simulation: DiscreteRodSimulation | SpatialSimulation) -> Mapping[str, FloatArray]:
    """Forces and torques of the grips on the ends of a rod at its present instant.

    Returns:
        For each end that is held (`start`, `end`): force along x, y, z [N], and torque about these
        at that end [N m], shape (6,).
    """
    boundary = simulation.boundary(simulation.time)
    if isinstance(simulation, SpatialSimulation):
        forces, torque = _in_space(simulation)
    else:
        forces, torque = _in_plane(simulation)
    return {
        end: np.concatenate([forces[node], torque(k)])
        for k, (end, node) in enumerate(((START, 0), (END, len(forces) - 1)))
        if node in boundary.positions
    }


Torque = Callable[[int], FloatArray]
"""Torque (3,) [N m] of the clamp at the start (0) or the end (1)."""


def _in_plane(simulation: DiscreteRodSimulation) -> tuple[FloatArray, Torque]:
    """Forces on the nodes (N + 1, 3) with nothing held, and torques, of a planar rod."""
    x, potential = simulation.x, simulation.potential
    free = potential._replace(held=np.zeros_like(potential.held))
    gradient = np.empty_like(x)
    evaluate(x, free, gradient, np.empty((BANDS, 2 * len(x))))
    forces = np.column_stack([gradient[:, 0], np.zeros(len(x)), gradient[:, 1]])
    return forces, lambda end: np.array([0.0, _torque(x, potential, end), 0.0])


def _in_space(simulation: SpatialSimulation) -> tuple[FloatArray, Torque]:
    """Forces and torques of a rod in space."""
    shape, spin, potential = simulation.last
    free = potential._replace(free=np.ones_like(potential.free))
    _, gradient, _ = spatial_energy.evaluate(shape, spin, free)

    def energy(end: int, turn: FloatArray) -> float:
        """Energy with a clamp turned about an axis by its length [rad]."""
        held = Rotation.from_rotvec(turn).as_matrix()
        tangent, director = potential.ends.tangent.copy(), potential.ends.director.copy()
        tangent[end], director[end] = held @ tangent[end], held @ director[end]
        turned = potential._replace(ends=spatial_energy.EndFrames(tangent, director))
        return spatial_energy.evaluate(shape, spin, turned, slopes=False)[0]

    def torque(end: int) -> FloatArray:
        if not potential.ends.held[end]:
            return np.zeros(3)
        turns = TURN * np.eye(3)
        return np.array([energy(end, t) - energy(end, -t) for t in turns]) / (2.0 * TURN)

    return gradient.reshape(len(shape.x), -1)[:, :3], torque


def _torque(x: FloatArray, p: PlanarPotential, end: int) -> float:
    """Torque of the clamp at the start (0) or the end (1) [N m]; 0 where the DLO may turn there."""
    if np.isnan(p.clamps[end]):
        return 0.0
    energy = []
    for side in (TURN, -TURN):
        clamps = p.clamps.copy()
        clamps[end] += side
        scratch = np.zeros_like(x), np.zeros((BANDS, 2 * len(x)))
        energy.append(elastic(x, p.lengths, clamps, p.stiffness, p.offsets, p.law, *scratch))
    return float(energy[0] - energy[1]) / (2.0 * TURN)


def measured(
    sensor: WrenchSensor,
    stamps: Sequence[int],
    true: Sequence[Mapping[str, FloatArray]],
    accelerations: Mapping[str, FloatArray],
    seed: int,
) -> list[Wrenches]:
    """Measurements of sensors at the grips.

    Args:
        stamps: stamps of the measurements [ns], T of them.
        true: see `reactions`, at the instants that are measured.
        accelerations: acceleration of each grip at these instants [m/s^2], shape (T, 3).
        seed: seed of noise and offset.

    Raises:
        InputError: a grip holds the DLO at some instants only.
    """
    rng = np.random.default_rng([seed, 0x57])
    result = []
    for end in (START, END):
        held = [end in now for now in true]
        if not any(held):
            continue
        if not all(held):
            raise InputError(f"wrench: the {end} is not held all the time")
        values = np.array([now[end] for now in true])
        force, torque = values[:, :3], values[:, 3:]
        force += sensor.tool_mass * accelerations[end]  # its weight is tared
        for array, noise, offset in (
            (force, sensor.force_std, sensor.force_bias_std),
            (torque, sensor.torque_std, sensor.torque_bias_std),
        ):
            array += rng.normal(0.0, 1.0, 3) * offset + rng.normal(0.0, 1.0, array.shape) * noise
        late = np.array(stamps, dtype=np.int64) + round(sensor.delay * NANOSECONDS)
        result.append(Wrenches.along_axes(end, late, np.hstack([force, torque])))
    return result


def record(
    sensor: WrenchSensor, simulation: DiscreteRodSimulation | SpatialSimulation,
    stamps: Sequence[int], length: float, seed: int,
) -> tuple[Truth, list[Wrenches]]:  # fmt: skip
    """Run a settled simulation over the stamps of images, and measure at the grips.

    Args:
        stamps: stamps of the images [ns].
        length: configured length [m].
        seed: seed of noise and offset.

    Raises:
        InputError: a grip holds the DLO at some instants only.
        SimulationError: a step did not converge.
    """
    count = int((stamps[-1] - stamps[0]) / NANOSECONDS * sensor.rate) + 1
    instants = [stamps[0] + round(k / sensor.rate * NANOSECONDS) for k in range(count)]
    borne: dict[int, Mapping[str, FloatArray]] = {}
    every = sorted({*stamps, *instants})
    truth = simulate(simulation, every, length, lambda s: borne.update({s: reactions(simulation)}))
    kept = np.isin(every, stamps)
    seen = replace(
        truth, stamps=tuple(stamps), nodes=truth.nodes[kept], velocities=truth.velocities[kept]
    )
    measure = np.isin(every, instants)
    moved = {
        end: _acceleration(simulation, node, instants) if end in borne[every[0]] else np.zeros(0)
        for end, node in ((START, 0), (END, truth.nodes.shape[1] - 1))
    }
    true = [borne[s] for s, m in zip(every, measure, strict=True) if m]
    return seen, measured(sensor, instants, true, moved, seed)


def _acceleration(
    simulation: DiscreteRodSimulation | SpatialSimulation, node: int, stamps: Sequence[int]
) -> FloatArray:
    """Acceleration of an imposed node [m/s^2], shape (T, 3)."""
    places = []
    for stamp in stamps:
        time = (stamp - START_STAMP) / NANOSECONDS
        near = [simulation.boundary(time + side).positions[node] for side in (-WITHIN, 0, WITHIN)]
        places.append((near[0] - 2.0 * near[1] + near[2]) / WITHIN**2)
    result = np.array(places)
    return result if result.shape[1] == 3 else np.insert(result, 1, 0.0, axis=1)
