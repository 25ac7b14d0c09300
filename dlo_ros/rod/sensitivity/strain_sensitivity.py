# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled derivatives of what follows the shape: strains, frame, internal variables."""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements import rod_forces
from dlo_ros.rod.elements.frame_derivatives import vary_carried_frame
from dlo_ros.rod.elements.planar_assembly import PLANAR
from dlo_ros.rod.elements.rod_tables import InternalVariables
from dlo_ros.rod.elements.strains import span_twist
from dlo_ros.rod.sensitivity.sensitivity_state import central_difference, shift
from dlo_ros.rod.solve.equation_system import frictionless, material_at_rest, relaxed_material
from dlo_ros.rod.solve.generalised_alpha import update_internal_variables
from dlo_ros.rod.solve.integrator_state import another, assign


@linked()
def _remember(system, q, other, old, h, fresh, varying, d_q, d_other):
    """Let the internal variables vary along.

    Args:
        q, other: shape and strains after the step.
        old: the state before it.
        h, fresh: see `follow`.
        d_q, d_other: derivatives of the shape, shape (P, n, d), and of the other strains, shape (P,
            nb, 3).
    """
    past = old.internal
    if past.plastic.shape[0] + past.anchor.shape[0] + past.inner.shape[0] == 0:
        return
    above, below, before = another(old).internal, another(old).internal, varying.internal
    shifted, strained = np.empty(q.shape), np.empty(other.shape)
    for a in range(varying.step.size):
        for side in range(2):
            d = varying.step[a] if side == 0 else -varying.step[a]
            plastic, anchor, inner = past.plastic.copy(), past.anchor.copy(), past.inner.copy()
            shift(plastic, past.plastic, d, before.plastic[a])
            shift(anchor, past.anchor, d, before.anchor[a])
            shift(inner, past.inner, d, before.inner[a])
            matter = material_at_rest(
                system, 1 + 2 * a + side, 1.0, InternalVariables(plastic, anchor, inner)
            )
            matter = frictionless(matter) if fresh else relaxed_material(matter, h)
            shift(shifted, q, d, d_q[a])
            shift(strained, other, d, d_other[a])
            update_internal_variables(
                shifted, strained, system.rule, matter, above if side == 0 else below
            )
        d = varying.step[a]
        central_difference(above.plastic, below.plastic, d, before.plastic[a])
        central_difference(above.anchor, below.anchor, d, before.anchor[a])
        central_difference(above.inner, below.inner, d, before.inner[a])


@linked()
def _turned_strains(rule, other, turn, twist, d_other):
    """Add the strains that a change of the frame before the step causes; see `follow`."""
    line = np.empty(3)
    for a in range(turn.shape[0]):
        for e in range(0, rule.weight.size - 2, 3):
            for k in range(3):
                d_other[a, e + k, 0] += other[e + k, 1] * turn[a, e + k]
                d_other[a, e + k, 1] -= other[e + k, 0] * turn[a, e + k]
                line[k] = twist[a, e + k]
            span_twist(line, rule.twist_linear[e // 3])
            for k in range(3):
                d_other[a, e + k, 2] += line[k]


@linked()
def follow(system, after, old, h, fresh, varying, d_q, grad_s, grad_o, turn, twist):
    """Let what follows the shape vary along: strains, transported frame, internal variables.

    Args:
        after, old: state after the step, and before it.
        h: length of the step [s], 0 to an equilibrium.
        fresh: whether the DLO starts there, see `equilibrium_continuation.settle`.
        varying: derivatives; those of frame, strains and internal variables are changed.
        d_q: derivatives of the shape, shape (P, n, d).
        grad_s, grad_o: derivatives of the strains, see `spatial_assembly.assemble`.
        turn, twist: see `frame_derivatives.vary_frame`.
    """
    q, rule = after.q, system.rule
    d_stretch, d_other = rod_forces.strain_sensitivities(rule, grad_s, grad_o, d_q)
    if q.shape[1] != PLANAR:
        _turned_strains(rule, after.other, turn, twist, d_other)
        vary_carried_frame(q, rule, after.reference, d_q, grad_o, turn, twist, varying.reference)
    _remember(system, q, after.other, old, h, fresh, varying, d_q, d_other)
    assign(varying.stretch_before, varying.stretch)
    assign(varying.other_before, varying.other)
    assign(varying.stretch, d_stretch)
    assign(varying.other, d_other)
