# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled derivatives of what follows the shape: strains, frame, internal variables."""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements import rod_forces
from dlo_ros.rod.elements.frame_derivatives import vary_carried_frame
from dlo_ros.rod.elements.planar_assembly import PLANAR
from dlo_ros.rod.elements.strains import span_twist
from dlo_ros.rod.sensitivity.law_sensitivity import propagate_internal_bending
from dlo_ros.rod.sensitivity.surroundings_sensitivity import propagate_anchors
from dlo_ros.rod.solve.integrator_state import assign


@linked()
def turned_strains(rule, other, turn, twist, d_other):
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
def follow(
    system, after, old, h, matter, d_rest, derivatives, varying, d_q, grad_s, grad_o, turn, twist
):
    """Let what follows the shape vary along: strains, transported frame, internal variables.

    Args:
        after, old: state after the step, and before it.
        h: length of the step [s], 0 to an equilibrium.
        matter: the material of the motion there.
        d_rest: derivatives of the rest curvature there, see `sensitivity_state.rest_rates`.
        derivatives: see `moment_derivatives`.
        varying: derivatives; those of frame, strains and internal variables are changed.
        d_q: derivatives of the shape, shape (P, n, d).
        grad_s, grad_o: derivatives of the strains, see `spatial_assembly.assemble`.
        turn, twist: see `frame_derivatives.vary_frame`.
    """
    q, rule = after.q, system.rule
    d_stretch, d_other = rod_forces.strain_sensitivities(rule, grad_s, grad_o, d_q)
    if q.shape[1] != PLANAR:
        turned_strains(rule, after.other, turn, twist, d_other)
        vary_carried_frame(q, rule, after.reference, d_q, grad_o, turn, twist, varying.reference)
    if old.internal.yield_centre.shape[0] + old.internal.inner.shape[0] > 0:
        propagate_internal_bending(
            d_rest, matter.law, varying.rates.law, old.internal.inner,
            varying.internal, after.other, derivatives, h, q.shape[1] == PLANAR, d_other,
        )  # fmt: skip
    if old.internal.anchor.shape[0] > 0:
        propagate_anchors(
            rule, matter.around.creep, old.internal.anchor, q, d_q, varying.internal.anchor
        )
    assign(varying.stretch_before, varying.stretch)
    assign(varying.other_before, varying.other)
    assign(varying.stretch, d_stretch)
    assign(varying.other, d_other)
