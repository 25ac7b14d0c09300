# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The state of a rod in compiled code, changed in place from step to step."""

from __future__ import annotations

from typing import NamedTuple

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.rod_tables import InternalVariables, Reference
from dlo_ros.rod.simd.row_operations import copy_numbers
from dlo_ros.rod.simd.vector_algebra import INLINE
from dlo_ros.spline import FloatArray


class IntegratorState(NamedTuple):
    """The state of a rod, changed in place; d is 4 in space, 2 in the plane."""

    clock: FloatArray  # (3,) [s] time from the command's start, last step, proposed next step
    q: FloatArray  # (n, d)
    velocity: FloatArray
    acceleration: FloatArray
    auxiliary: FloatArray
    reference: Reference
    frames: FloatArray  # (2, FRAME)
    stretch: FloatArray  # (nb,) now, and one step ago
    stretch_before: FloatArray
    other: FloatArray  # (nb, 3)
    other_before: FloatArray
    internal: InternalVariables


TIME, LAST, NEXT = range(3)  # of the clock


@njit(**INLINE)
def assign(target, source):
    """Copy an array into another of the same shape."""
    copy_numbers(target, source)


@linked()
def commit(new, state):
    """Let the state become the new one."""
    assign(state.clock, new.clock)
    assign(state.q, new.q)
    assign(state.velocity, new.velocity)
    assign(state.acceleration, new.acceleration)
    assign(state.auxiliary, new.auxiliary)
    if state.q.shape[1] == 4:  # in the plane the frame plays no role
        assign(state.reference.tangent, new.reference.tangent)
        assign(state.reference.rate, new.reference.rate)
        assign(state.reference.director, new.reference.director)
        assign(state.reference.twist, new.reference.twist)
    assign(state.frames, new.frames)
    assign(state.stretch, new.stretch)
    assign(state.stretch_before, new.stretch_before)
    assign(state.other, new.other)
    assign(state.other_before, new.other_before)
    assign(state.internal.yield_centre, new.internal.yield_centre)
    assign(state.internal.anchor, new.internal.anchor)
    assign(state.internal.inner, new.internal.inner)


@linked()
def another(state):
    """A copy of a state."""
    ref = state.reference
    return IntegratorState(
        state.clock.copy(), state.q.copy(), state.velocity.copy(), state.acceleration.copy(),
        state.auxiliary.copy(),
        Reference(ref.tangent.copy(), ref.rate.copy(), ref.director.copy(), ref.twist.copy()),
        state.frames.copy(),
        state.stretch.copy(), state.stretch_before.copy(), state.other.copy(),
        state.other_before.copy(),
        InternalVariables(
            state.internal.yield_centre.copy(), state.internal.anchor.copy(),
            state.internal.inner.copy(),
        ),
    )  # fmt: skip
