# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Static equilibrium of a rod in space, its derivatives and its stability in one compiled call.

A planar rod is made of the one in space and expanded to it here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.planar_assembly import PLANAR, tangents
from dlo_ros.rod.elements.rod_tables import InternalVariables, Reference
from dlo_ros.rod.sensitivity.propagation import propagate_equilibrium
from dlo_ros.rod.sensitivity.sensitivity_state import SensitivityState
from dlo_ros.rod.solve import equilibrium_continuation
from dlo_ros.rod.solve.equation_system import ITSELF, growth, material_at_rest, unhindered
from dlo_ros.rod.solve.generalised_alpha import DONE
from dlo_ros.rod.solve.integrator_state import IntegratorState, another, assign
from dlo_ros.rod.solve.newton_iteration import negative_modes
from dlo_ros.spline import FloatArray


class RestState(NamedTuple):
    """A rod at rest in space; or the derivatives of one, arrays with a leading axis of P."""

    q: FloatArray  # (n, 4)
    reference: Reference
    frames: FloatArray  # (2, FRAME); (P, 2, 2, FRAME) as in `SensitivityState`
    stretch: FloatArray  # (nb,)
    other: FloatArray  # (nb, 3)
    internal: InternalVariables


@linked()
def _in_plane(q, flat):
    """The configuration itself, or x and z of it alone."""
    if not flat:
        return q
    reduced = np.empty((q.shape[0], PLANAR))
    for i in range(q.shape[0]):
        reduced[i, 0], reduced[i, 1] = q[i, 0], q[i, 2]
    return reduced


@linked()
def _in_space(planar, q):
    """Write x and z to q, with zeros for y and theta."""
    for i in range(q.shape[0]):
        q[i, 0], q[i, 1], q[i, 2], q[i, 3] = planar[i, 0], 0.0, planar[i, 1], 0.0


@linked()
def _integrator_state(state, flat):
    """A state at rest as the solver takes it, whose arrays are the state's but for a planar q."""
    q = _in_plane(state.q, flat)
    return IntegratorState(
        np.zeros(3), q, np.zeros(q.shape), np.zeros(q.shape), np.zeros(q.shape), state.reference,
        state.frames, state.stretch, np.empty(state.stretch.shape), state.other,
        np.empty(state.other.shape), state.internal,
    )  # fmt: skip


@linked()
def _vary(rod, before, now, fresh, change):
    """Write the derivatives of an equilibrium, see `settle`, to which it was led from `before`."""
    count, (n, dof) = rod.step.size, now.q.shape
    for a in range(count):
        for side in range(2):
            assign(change.frames[a, side], before.frames)
    d_q = np.zeros((count, n, dof))
    varying = SensitivityState(
        rod.step, rod.moves, rod.rates, rod.kind, d_q, d_q, d_q, d_q, change.reference,
        change.frames, change.stretch, np.empty(change.stretch.shape), change.other,
        np.empty(change.other.shape), change.internal,
    )  # fmt: skip
    propagate_equilibrium(rod.system, rod.imposed, before.q, now, before.internal, fresh, varying)
    if dof != PLANAR:
        assign(change.q, d_q)
        return
    for a in range(count):
        _in_space(d_q[a], change.q[a])


@linked(from_python=True)
def settle(rod, flat, time, rate2, tolerance, fresh, rest, change):
    """`equilibrium_continuation.settle`, then `propagate_equilibrium` from where it began.

    Args:
        rod: a `PreparedRod`, with P parameters.
        flat: whether the rod is prepared as a planar one.
        time, rate2, tolerance, fresh: see there.
        rest: `RestState` from which it is led; becomes the state at rest.
        change: output, zeros that become its derivatives.

    Returns:
        What `equilibrium_continuation.settle` returns, with the negative eigenvalues in space also
        of a planar rod.
    """
    now = _integrator_state(rest, flat)
    before = another(now)
    system, imposed = rod.system, rod.imposed
    status, iterations, negative, buckled = equilibrium_continuation.settle(
        system, imposed, before, time, rate2, tolerance, fresh, now
    )
    if status == DONE:
        if rod.step.size > 0:
            _vary(rod, before, now, fresh, change)
        if flat:
            _in_space(now.q, rest.q)
            tangents(rest.q, system.rule, rest.reference.tangent, rest.reference.rate)
            matter = material_at_rest(system, ITSELF, growth(imposed, ITSELF, time), rest.internal)
            negative = max(negative, negative_modes(
                rest.q, rod.fixed, rod.pins, system.rule, unhindered(matter), rest.reference,
                system.mass[0], system.spin[0], rate2,
            ))  # fmt: skip
    return status, iterations, negative, buckled
