# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A recorded motion along a smooth path through its points, for what its corners would exaggerate.

Between points a command is linear. Of a recorded motion the points are samples, and the robot was
as fast at each of them from either side; a velocity that jumps there instead would accelerate what
is held within a single step of a simulation, by a multiple of the forces that a motion has.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from dlo_ros.command import END, START, Command

CORNER = 2e-3
"""Distance of a motion's straight pieces from a smooth path through its points, over the length of
the DLO, from which a point is a corner: ten times what a robot arm leaves that is recorded at the
rate of a camera."""
FINE = 2.5e-3
"""Longest time between points of a smooth motion [s]: what is left of a turning clamp's corners."""
MOST_PARTS = 40


def smoothed(command: Command, length: float) -> Command:
    """The motion along a smooth path through all points but its corners, and at their times.

    Args:
        command: the motion; where points carry velocities, these stay.
        length: length of the DLO [m], by which corners are judged; there the velocity still jumps.
    """
    times = command.times
    if len(times) < 3:
        return command
    rotations = command.rotations.copy()
    rotations[:, [name in (START, END) for name in command.names]] = command.clamp_rotations
    poses = np.concatenate([command.positions, rotations], axis=2)
    rates = np.gradient(poses, times, axis=0, edge_order=2)  # of parabolas through neighbours
    sharp = np.isin(times, command.corners(CORNER * length, length))
    sharp[[0, -1]] = True  # what holds before and after has no velocity
    rates[sharp] = np.nan
    given = np.isfinite(command.velocities)
    rates[..., :3] = np.where(given, command.velocities, rates[..., :3])
    new_times, new_poses, new_rates = [times[:1]], [poses[:1]], []
    for k, h in enumerate(np.diff(times)):
        slope = (poses[k + 1] - poses[k]) / h
        ends = [np.where(np.isfinite(rates[j]), rates[j], slope) for j in (k, k + 1)]
        way = CubicHermiteSpline(times[k : k + 2], poses[k : k + 2], ends)
        parts = int(np.clip(np.ceil(h / FINE), 1, MOST_PARTS))
        at = np.linspace(times[k], times[k + 1], parts + 1)
        new_times.append(at[1:])
        new_poses.append(way(at[1:]))
        new_rates.append(way(at[:-1], 1))
    new_rates.append(rates[-1:])
    fine, velocities = np.concatenate(new_times), np.concatenate(new_rates)[..., :3]
    # Where a velocity jumps, a point has none: it would be that on both sides.
    velocities[np.isin(fine, times)] = rates[..., :3]
    positions, rotations = np.split(np.concatenate(new_poses), [3], axis=2)
    norms = np.linalg.norm(rotations, axis=2, keepdims=True)
    rotations = np.divide(rotations, norms, out=np.zeros_like(rotations), where=norms > 0.0)
    return replace(
        command, times=fine, positions=positions, rotations=rotations, velocities=velocities
    )
