# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rods and commands that the tests share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dlo_ros.command import Command
from dlo_ros.parameters import RodParameters, Settings
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.resolution import build
from dlo_ros.rod.state import State, rest_state
from dlo_ros.rod.statics import material_at_rest, settle

PAPER = Settings(rod=RodParameters(0.4, 0.004, 5e7, 2500.0))  # Table III
KNOWN = replace(
    PAPER,
    rod=replace(PAPER.rod, density_std=20.0),
    damping=replace(PAPER.damping, air_drag_std=1e-4, relaxation_time_std=1e-4),
)
"""The same, of which density and damping were measured beforehand."""
SECOND = 1_000_000_000


def command(names, times, positions, rotations=None, n=10, stamp=0):
    """A command with unit rotations where none are given."""
    shape = (len(times), len(names))
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (*shape, 1)) if rotations is None else rotations
    return Command(
        stamp,
        tuple(names),
        np.asarray(times, dtype=float),
        np.asarray(positions, dtype=float).reshape(*shape, 3),
        np.asarray(quaternions, dtype=float).reshape(*shape, 4),
        np.full((*shape, 3), np.nan),
        n,
    )


def held_start(**keywords):
    """A command that clamps the start at the origin, along x."""
    return command(["start"], [0.0], [[0.0, 0.0, 0.0]], **keywords)


class Nothing:
    """A command that holds nothing."""

    names = ()
    stamp = 0
    times = np.zeros(1)
    positions = velocities = np.zeros((1, 0, 3))
    rotations = np.zeros((1, 0, 4))
    off_plane, turns_in_plane, progress = 0.0, True, np.zeros(1)

    @staticmethod
    def corners(size: float, reach: float, spreading: float) -> np.ndarray:
        return np.zeros(0)


def straight(model: RodModel, direction=(1.0, 0.0, 0.0)) -> State:
    """A straight rod at rest."""
    q = np.zeros((model.basis.control_points, 4))
    q[:, :3] = model.basis.greville[:, None] * np.asarray(direction)
    return rest_state(0, q, model)


def settled(settings: Settings, imposed: Command, spans: int, direction=(1.0, 0.0, 0.0)):
    """Model, boundary and equilibrium, led from a straight rod to the command's first instant."""
    model, boundary = build(settings, imposed, spans)
    found = settle(model, boundary, straight(model, direction), imposed, imposed.stamp)
    return model, boundary, found


def dense_stiffness(model: RodModel, state: State) -> np.ndarray:
    """The Hessian of the elastic energy as a full matrix, shape (4 n, 4 n)."""
    from dlo_ros.rod.elements.constitutive_law import room
    from dlo_ros.rod.elements.rod_forces import assemble  # compiled on import
    from dlo_ros.rod.elements.rod_tables import BAND

    size = state.q.size
    gradient, band = np.empty(size), np.empty((size, BAND + 1))
    stretch = np.empty((model.rule.weight.size, 3))
    other = np.zeros((model.rule.weight.size, 3, 8))
    assemble(
        state.q, model.rule, state.reference, material_at_rest(model, state.internal),
        room(model.rule.weight.size), np.empty(0), gradient, band, stretch, other,
    )  # fmt: skip
    full = np.zeros((size, size))
    for i in range(size):
        for j in range(max(0, i - BAND), i + 1):
            full[i, j] = full[j, i] = band[i, BAND - i + j]
    return full


__all__ = ["KNOWN", "PAPER", "SECOND", "Boundary", "Nothing", "command", "dense_stiffness",
           "held_start", "settled", "straight"]  # fmt: skip
