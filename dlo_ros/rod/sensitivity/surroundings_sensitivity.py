# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled derivatives of friction, contact and quadratic drag, and of anchors, by parameters.

The shape at the end of a step is held. Friction varies with its limit and with the anchor before;
bodies that the DLO touches with their own numbers only; quadratic drag with the way of the DLO
before the step, from which its direction t, the speed across and the point without drag follow.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.contact_and_friction import (
    add_contact_and_friction,
    friction,
    rest_anchor,
)
from dlo_ros.rod.elements.drag_springs import add_pushes, no_springs, points
from dlo_ros.rod.elements.element_stiffness import FIRST
from dlo_ros.rod.elements.rod_tables import Surroundings
from dlo_ros.rod.elements.strains import three
from dlo_ros.rod.simd.vector_algebra import FLAGS, dot, mix, mix3, times
from dlo_ros.rod.solve.generalised_alpha import drag_prediction, weights

STILL = 1e-300  # speed [m/s] below which a direction of motion counts for nothing


@linked()
def add_surroundings_forces(system, old, new, h, varying, rhs):
    """Subtract the derivatives of the surroundings' forces, the shape held, from rhs (P, n d).

    Args:
        system: the rod.
        old, new: states before and after the step.
        h: length of the step [s].
        varying: the derivatives before.
    """
    around, rates, q, rule = system.around, varying.rates, new.q, system.rule
    anchor, brake = old.internal.anchor, around.brake[0]
    if anchor.shape[0] > 0:
        _add_friction(
            rule, around.friction[0], around.creep[0], anchor, q, rates.friction,
            varying.internal.anchor, rhs,
        )  # fmt: skip
    if brake != 0.0 or np.any(rates.brake != 0.0):
        prediction = drag_prediction(old.q, old.velocity, old.acceleration, old.auxiliary, h)
        changes = drag_prediction(
            varying.q, varying.velocity, varying.acceleration, varying.auxiliary, h
        )
        _add_quadratic_drag(rule, brake, prediction, q, h, rates.brake, changes, rhs)
    if np.any(rates.bodies != 0.0):
        _add_contact(rule, around, q, varying.step, rates.bodies, rhs)


@linked()
def _add_friction(rule, limit, creep, anchor, q, d_limit, d_anchor, rhs):
    place, dof = rest_anchor(q, rule), q.shape[1]
    for e in range(rule.weight.size):
        f0, f1, t00, t01, t11, _ = friction(
            place[e, 0], place[e, 1], anchor[e, 0], anchor[e, 1], 1.0, creep
        )
        for a in range(rhs.shape[0]):
            more, moved = d_limit[a], d_anchor[a, e]
            pull0 = more * f0 - limit * (t00 * moved[0] + t01 * moved[1])
            pull1 = more * f1 - limit * (t01 * moved[0] + t11 * moved[1])
            for i in range(4):
                at, share = dof * (rule.span[e] + i), rule.weight[e] * rule.b[e, i]
                rhs[a, at] -= share * pull0
                rhs[a, at + dof // 2] -= share * pull1


@linked()
def _add_contact(rule, s, q, step, touched, rhs):
    """Pegs and walls, from the forces of both variants of a parameter."""
    spare, anchor = np.empty((q.size, 4 * q.shape[1])), np.empty((0, 2))
    for a in range(rhs.shape[0]):
        if touched[a] == 0.0:
            continue
        for side in range(2):
            k = 1 + 2 * a + side
            around = Surroundings(
                0.0, s.creep[k], s.pegs[k], s.contact[k], s.span, s.b, s.weight, s.walls[k], 0.0,
                no_springs(),
            )  # fmt: skip
            force = np.zeros(q.size)
            add_contact_and_friction(q, rule, around, anchor, force, spare)
            share = (0.5 if side == 0 else -0.5) / step[a]
            for i in range(q.size):
                rhs[a, i] -= share * force[i]


@linked(**FLAGS)
def _add_quadratic_drag(rule, brake, prediction, q, h, d_brake, changes, rhs):
    (_, rate), dof, forces = weights(h), q.shape[1], np.zeros(FIRST)
    last, (there, speed, still), (d_there, d_speed, d_still) = dof // 2, prediction, changes
    b, b1 = rule.b, rule.b1
    for e in range(0, rule.weight.size, 3):
        span = rule.span[e]
        slope, s = points(there, span, b1, e, last), points(speed, span, b, e, last)
        away = mix(1.0, points(q, span, b, e, last), -1.0, points(still, span, b, e, last))
        shorter = 1.0 / np.sqrt(dot(slope, slope))
        t = times(shorter, slope)
        along, ahead = dot(s, t), dot(away, t)
        s = mix(1.0, s, -along, t)
        fast = np.sqrt(dot(s, s))  # across the DLO, from here on
        s = times(1.0 / (fast + STILL), s)
        aside, push = mix(1.0, away, -ahead, t), rate * three(rule.weight, e)
        for a in range(rhs.shape[0]):
            ds, dy = points(d_speed[a], span, b, e, last), points(d_still[a], span, b, e, last)
            dt = points(d_there[a], span, b1, e, last)
            dt = times(shorter, mix(1.0, dt, -dot(t, dt), t))
            faster = brake * (dot(s, ds) - along * dot(s, dt)) + d_brake[a] * fast
            turned = mix3(1.0, dy, ahead, dt, dot(dt, away) - dot(t, dy), t)
            pull = mix(-push * faster, aside, push * brake * fast, turned)
            add_pushes(pull, rule, e, dof, forces, rhs[a])


@linked()
def propagate_anchors(rule, creep, anchor, q, d_q, d_anchor):
    """Let the anchors of friction vary along; see `contact_and_friction.drag_along`.

    Args:
        rule: quadrature tables.
        creep: displacement at which friction acts fully [m], which no parameter changes.
        anchor: anchors before, shape (nb, 2).
        q, d_q: shape after the motion, and its derivatives (P, n, d).
        d_anchor: derivatives of the anchors (P, nb, 2), changed.
    """
    place = rest_anchor(q, rule)
    for a in range(d_q.shape[0]):
        moved = rest_anchor(d_q[a], rule)
        for e in range(anchor.shape[0]):
            d0, d1 = place[e, 0] - anchor[e, 0], place[e, 1] - anchor[e, 1]
            size = np.sqrt(d0 * d0 + d1 * d1)
            if size <= creep:
                continue
            n0, n1 = d0 / size, d1 / size
            v0, v1 = moved[e, 0] - d_anchor[a, e, 0], moved[e, 1] - d_anchor[a, e, 1]
            turn = (n0 * v1 - n1 * v0) * creep / size
            d_anchor[a, e, 0] = moved[e, 0] + turn * n1
            d_anchor[a, e, 1] = moved[e, 1] - turn * n0
