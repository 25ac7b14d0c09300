# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The state of a simulated rod and its sensitivities at one instant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.errors import InputError, SimulationError
from dlo_ros.rod.boundary.conditions import BODY, DIRECTOR, HELD, TANGENT, THETA
from dlo_ros.rod.boundary.twist_free_frame import EndFrame, twist_free
from dlo_ros.rod.elements.contact_and_friction import rest_anchor
from dlo_ros.rod.elements.rod_tables import DOF, InternalVariables, Reference
from dlo_ros.rod.elements.strains import strains
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.sensitivity.sensitivity_state import SensitivityState
from dlo_ros.spline import FloatArray

FIRST_DIRECTOR = (0.0, 1.0, 0.0)  # in the coordinates of the clamp that gives the DLO its frame


@dataclass(frozen=True)
class Strains:
    """Strains at the quadrature points: stretch (nb,), and kappa_1, kappa_2, twist (nb, 3)."""

    stretch: FloatArray
    other: FloatArray


@dataclass(frozen=True)
class State:
    """A rod at one instant.

    Args:
        stamp: simulated instant [ns].
        q, velocity, acceleration: x, y, z [m] and theta [rad], and rates, shape (n, 4).
        auxiliary: acceleration-like variable of the generalised-alpha method, shape (n, 4).
        reference: frame at the bending points.
        frames: frames of both ends, shape (2, FRAME), see `boundary.conditions`.
        strains, previous: strains now and one step ago (for the strain rate).
        internal: variables of bending and friction, see `InternalVariables`.
        last_step: length of the last step [s], 0 at a start.
        next_step: step [s] that the error control proposes, 0 where it has no opinion yet.
        sensitivity: derivatives by P parameters, where asked for; q etc. have shape (P, n, 4).
    """

    stamp: int
    q: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    auxiliary: FloatArray
    reference: Reference
    frames: FloatArray
    strains: Strains
    previous: Strains
    internal: InternalVariables
    last_step: float = 0.0
    next_step: float = 0.0
    sensitivity: SensitivityState | None = None


def strains_of(q: FloatArray, model: RodModel, reference: Reference) -> Strains:
    """Strains of a configuration (n, 4)."""
    stretch, other = strains(np.ascontiguousarray(q), model.rule, reference)
    return Strains(stretch, other)


def rest_state(
    stamp: int, q: FloatArray, model: RodModel, held: EndFrame | None = None, angle: float = 0.0
) -> State:
    """A rod at rest, free of twist, in the shape q (n, 4).

    Args:
        held: frame of the clamp that gives the DLO its own, see `twist_free_frame.material_frame`.
        angle: by which it is turned about itself against that, everywhere alike [rad].
    """
    q = np.array(q, dtype=np.float64)
    q[:, 3] = angle
    reference, frames = twist_free(q, model.basis, model.points, held)
    if held is not None:
        frames[held.end, BODY:HELD], frames[held.end, HELD] = FIRST_DIRECTOR, 1.0
    now = strains_of(q, model, reference)
    zero = np.zeros((model.basis.control_points, DOF))
    internal = internal_at_rest(q, now, model)
    return State(stamp, q, zero, zero, zero, reference, frames, now, now, internal)


def internal_at_rest(q: FloatArray, now: Strains, model: RodModel) -> InternalVariables:
    """Internal variables of a DLO that was never bent too far and feels no friction.

    Args:
        q, now: control points, shape (n, 4), and the strains at the quadrature points.
    """
    yielding, touching, lagging = model.remembers
    anchor = rest_anchor(q, model.rule) if touching else np.zeros((0, 2))
    inner = np.zeros((lagging, 6))
    if lagging:
        inner[:, 4:] = now.other[:, :2]
    return InternalVariables(np.zeros((yielding, 2)), anchor, inner)


def bent_once(state: State, model: RodModel) -> State:
    """The state of a DLO that was bent from rest into its shape at once, as far as it yields.

    The middle of the elastic range is that of `constitutive_law.yield_centre`, where it was 0.
    """
    law, internal = model.law, state.internal
    if not len(internal.yield_centre):
        return state
    bent = state.strains.other[:, :2] - model.stiffness.bend_rest
    size = np.maximum(np.linalg.norm(bent, axis=1), np.finfo(float).tiny)
    share = np.maximum(1.0 - law.yield_curvature / size, 0.0)
    return replace(state, internal=internal._replace(yield_centre=share[:, None] * bent))


def with_history(state: State, model: RodModel) -> State:
    """The state with the internal variables of this model; initial ones where it has none."""
    fresh, old = internal_at_rest(state.q, state.strains, model), state.internal
    internal = InternalVariables(
        *(a if a.shape == b.shape else b for a, b in zip(old, fresh, strict=True))
    )
    return replace(state, internal=internal)


def twist_angle(state: State, model: RodModel) -> FloatArray:
    """Axial twist of a state, see `twist_along`."""
    return twist_along(model, state.q[0, 3], state.strains.other[:, 2])


def twist_along(model: RodModel, start: FloatArray, strain: FloatArray) -> FloatArray:
    """Axial twist against the twist-free frame of the centreline, as control points [rad].

    It is the integral along u of the twist strain, from the angle at u = 0.

    Args:
        start: angle at u = 0 [rad], shape (...).
        strain: twist strain [rad/m] at the bending points, shape (..., nb).

    Returns:
        Shape (..., n).
    """
    start = np.asarray(start)[..., None]
    grown = start + strain @ model.discretisation.twist_fit.T
    return np.concatenate([start, grown], axis=-1)


def refined(state: State, model: RodModel, finer: RodModel) -> State:
    """The state in another basis, exact where its knots contain the old ones.

    Sensitivities are not carried over, nor is what bending and friction remember.

    Raises:
        SimulationError: the state is folded so sharply that it has no direction somewhere.
    """
    change = finer.basis.projection(model.basis)
    q = change @ state.q
    q[:, 3] = change @ twist_angle(state, model)
    first = state.frames[0]
    start = EndFrame(0, first[TANGENT:DIRECTOR], first[DIRECTOR:BODY])
    try:
        reference, frames = twist_free(q, finer.basis, finer.points, start)
    except InputError as err:  # nobody has put it in
        raise SimulationError(f"the simulated DLO is folded: {err}") from err
    frames[:, BODY:] = state.frames[:, BODY:]
    frames[1, THETA] = q[-1, 3]
    now = strains_of(q, finer, reference)
    return State(
        state.stamp, q, change @ state.velocity, change @ state.acceleration,
        change @ state.auxiliary, reference, frames, now, now, internal_at_rest(q, now, finer),
        0.0, state.next_step,
    )  # fmt: skip
