# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The paper's rope clamped along x: its shape at rest, and that of an elastica."""

import numpy as np
from elastica import Cantilever
from rods import PAPER, held_start, settled

ROD = PAPER.rod
B, LINE = ROD.bending_stiffness, ROD.linear_density
STRETCH = ROD.young_modulus * ROD.area
SPANS = 28
U = np.linspace(0.0, ROD.length, 41)


def cantilever(settings, spans=SPANS, **effect):
    """The shape of a rod clamped along x, as a function of u: points (m, 2)."""
    settings = settings.with_effects(effect)
    model, _, found = settled(settings, held_start(), spans)
    assert found.stable
    return lambda u: model.basis.evaluate(found.state.q, u)[:, [0, 2]], found.state


def elastica(law, force, start=0.0, length=ROD.length, breaks=()):
    """The shape of such a rod as the solution of a boundary value problem.

    Args:
        law: curvature as a function of u and moment.
        force: internal force (x, z) at u, of all loads beyond u.
        start: direction at the clamp, positive from x towards -z [rad].
        breaks: places along the rope where force or law jump.
    """
    problem = Cantilever(
        length, lambda u: u, STRETCH, force, curvature=lambda moment, u: law(u, moment),
        direction=start, breaks=breaks,
    )  # fmt: skip
    return problem.solve


def own_weight(u, line=LINE):
    return np.zeros_like(u), -line * 9.81 * (ROD.length - u)


def apart(one, other):
    """Largest distance over L."""
    return np.abs(one(U) - other(U)).max() / ROD.length
