# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled derivatives of what follows the shape: strains, frame, internal variables."""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements import constitutive_law, rod_forces, spatial_assembly
from dlo_ros.rod.elements.planar_assembly import PLANAR
from dlo_ros.rod.elements.rod_tables import InternalVariables
from dlo_ros.rod.sensitivity.sensitivity_state import add, central_difference, shift, shift_frame
from dlo_ros.rod.solve.equation_system import frictionless, material_at_rest, relaxed_material
from dlo_ros.rod.solve.generalised_alpha import frame_at, update_internal_variables
from dlo_ros.rod.solve.integrator_state import another, another_frame, assign


@linked()
def _frames(system, q, old, varying, d_q):
    """Let the transported frame vary along; (q is in space).

    Args:
        d_q: derivatives of the shape, shape (P, n, 4).
    """
    rule, shifted = system.rule, np.empty(q.shape)
    up, down = another_frame(old.reference), another_frame(old.reference)
    change = varying.reference
    for a in range(varying.step.size):
        d = varying.step[a]
        shift_frame(up, old.reference, change, a, d)
        shift_frame(down, old.reference, change, a, -d)
        shift(shifted, q, d, d_q[a])
        frame_at(shifted, rule, up, up)
        shift(shifted, q, -d, d_q[a])
        frame_at(shifted, rule, down, down)
        central_difference(up.tangent, down.tangent, d, change.tangent[a])
        central_difference(up.rate, down.rate, d, change.rate[a])
        central_difference(up.director, down.director, d, change.director[a])
        central_difference(up.twist, down.twist, d, change.twist[a])


@linked()
def turned(system, q, old, matter, response, varying, rhs, by_frame):
    """Add to the residual what a change of the frame before the step causes (q is in space).

    Args:
        matter, response: material of the step, and room for stresses.
        rhs: right-hand sides (P, 4 n), to which the forces are added (against their sign); none
            where they are there already.
        by_frame: output, derivatives of bending and twist, shape (P, nb, 3).
    """
    rule, ref = system.rule, another_frame(old.reference)
    pull = np.zeros((2, q.size))
    for a in range(varying.step.size):
        for side in range(2):
            d = varying.step[a] if side == 0 else -varying.step[a]
            shift_frame(ref, old.reference, varying.reference, a, d)
            stretch, other = rod_forces.strains(q, rule, ref)
            add(by_frame[a].ravel(), 0.5 / d, other.ravel())
            if rhs.shape[0] > 0:
                constitutive_law.respond(stretch, other, rule.weight, matter, response)
                pull[side] = 0.0
                spatial_assembly.force(q, rule, ref, other, response, pull[side])
        if rhs.shape[0] > 0:
            for i in range(q.size):
                rhs[a, i] -= (pull[0, i] - pull[1, i]) / (2.0 * varying.step[a])


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
def follow(system, q, other, old, h, fresh, varying, d_q, grad_s, grad_o, by_frame):
    """Let what follows the shape vary along: strains, transported frame, internal variables.

    Args:
        q, other: shape and strains after the step.
        old: the state before it.
        h: length of the step [s], 0 to an equilibrium.
        fresh: whether the DLO starts there, see `equilibrium_continuation.settle`.
        varying: derivatives; those of frame, strains and internal variables are changed.
        d_q: derivatives of the shape, shape (P, n, d).
        grad_s, grad_o: derivatives of the strains, see `spatial_assembly.assemble`.
        by_frame: see `_turned`.
    """
    d_stretch, d_other = rod_forces.strain_sensitivities(system.rule, grad_s, grad_o, d_q)
    if q.shape[1] != PLANAR:
        add(d_other.ravel(), 1.0, by_frame.ravel())
        _frames(system, q, old, varying, d_q)
    _remember(system, q, other, old, h, fresh, varying, d_q, d_other)
    assign(varying.stretch_before, varying.stretch)
    assign(varying.other_before, varying.other)
    assign(varying.stretch, d_stretch)
    assign(varying.other, d_other)
