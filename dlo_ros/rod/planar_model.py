# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The rod in its plane: the same model with x and z only, where nothing leaves the plane y = 0.

A single camera watches the DLO in that plane, so most runs are of this kind; they cost a quarter.
States keep their spatial form: they are reduced for the compiled code and expanded afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.command import Command
from dlo_ros.kernel_cache import njit
from dlo_ros.rod.boundary.conditions import DIRECTOR
from dlo_ros.rod.elements.planar_assembly import tangents
from dlo_ros.rod.elements.rod_tables import Reference
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.parameter_names import sideways
from dlo_ros.rod.state import State
from dlo_ros.spline import FloatArray

IN_PLANE = [0, 2]  # x and z of x, y, z, theta
ROUNDING = 1e-12


def in_plane(
    model: RodModel, state: State, command: Command, parameters: Sequence[str] = ()
) -> bool:
    """Whether motion, rest strains and loads all lie in the plane y = 0.

    Args:
        command: command with all effects applied.
        parameters: parameters by which derivatives are wanted; one that acts out of the plane makes
            the motion spatial.
    """
    slack = ROUNDING * model.basis.length
    return bool(
        model.planar
        and not any(sideways(model.settings, name) for name in parameters)
        and command.off_plane <= slack
        and command.turns_in_plane
        and _lies_flat(
            state.q, state.velocity, state.acceleration, state.auxiliary,
            state.reference.director, state.frames, slack,
        )
    )  # fmt: skip


@njit()
def _lies_flat(q, velocity, acceleration, auxiliary, director, frames, slack):
    for i in range(q.shape[0]):
        for c in (1, 3):
            if abs(q[i, c]) > slack or abs(velocity[i, c]) > slack:
                return False
            if abs(acceleration[i, c]) > slack or abs(auxiliary[i, c]) > slack:
                return False
    for e in range(director.shape[0]):
        if abs(director[e, 1] - 1.0) > 1e-9:
            return False
    return abs(frames[0, DIRECTOR + 1] - 1.0) < 1e-9 and abs(frames[1, DIRECTOR + 1] - 1.0) < 1e-9


def reduce(x: FloatArray, flat: bool) -> FloatArray:
    """Columns x and z of an array (..., n, 4) for the plane, all of them else; always a copy."""
    return np.array(x[..., ::2] if flat else x, order="C")


def expand(x: FloatArray, like: FloatArray) -> FloatArray:
    """An array (..., n, 2) with zeros for y and theta, or an array (..., n, 4) as it is."""
    if x.shape[-1] == like.shape[-1]:
        return x
    result = np.zeros((*x.shape[:-1], 4))
    result[..., ::2] = x
    return result


def flat_reference(model: RodModel, q: FloatArray, before: Reference) -> Reference:
    """The reference frame at a planar configuration (n, 4): its first director stays y."""
    tangent, rate = np.zeros_like(before.tangent), np.zeros_like(before.rate)
    tangents(q, model.rule, tangent, rate)
    return Reference(tangent, rate, before.director, before.twist)
