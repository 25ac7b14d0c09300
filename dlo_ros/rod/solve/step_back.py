# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Corrections of Newton's method that go too far for a law, shortened.

A law whose slope jumps, as that of a friction within the DLO where the motion turns, or of a peg
where it is touched, lets the method go to and fro between both sides.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.constitutive_law import respond
from dlo_ros.rod.elements.contact_and_friction import add_contact_and_friction
from dlo_ros.rod.elements.rod_forces import strains

OVERSHOOT = 0.5  # work against a correction at its end, over that for it at its start
SHORTENINGS = 30  # of one correction: most take one or two


@njit(inline="always")
def remaining_share(promised, unforeseen, stiffer, share):
    """The share of a correction that stays, where a law is not what it was taken for.

    Along a correction, the work of the forces should fall from what it is at the start to nothing.
    Where the law turns it into more than `OVERSHOOT` of that against the correction, this ends
    where the work is zero by the straight line through both, or by that which touches it at the
    end, whichever goes farther. How much a turn stretches the rod is no reason: the next correction
    takes that back.

    Args:
        promised: work of the forces along the whole correction, at its start [J].
        unforeseen: the same at the end, of what the law does otherwise than its tangent [J].
        stiffer: by how much more the work falls there for that [J].
        share: share of the correction that was taken.
    """
    work = (1.0 - share) * promised - unforeseen
    if promised > 0.0 and work < -OVERSHOOT * promised:
        touching = share + work / (promised + stiffer) if stiffer > 0.0 else 0.0
        return max(share * promised / (promised - work), touching)
    return share


@linked()
def work_unforeseen(moved, forces, stiffness, forces_there, stiffness_there):
    """Work along a correction of what surroundings do otherwise than the line that touches them.

    Args:
        moved: the correction, zero where something is imposed, (N,).
        forces, stiffness: of the surroundings, and lower rows of their tangent, before it, (N,) and
            (N, W); those after it likewise.

    Returns:
        The work, and by how much more the tangent after it takes, along the correction [J].
    """
    work, stiffer, width = 0.0, 0.0, stiffness.shape[1]
    for i in range(moved.size):
        if moved[i] == 0.0:
            continue
        work += (forces_there[i] - forces[i]) * moved[i]
        for m in range(min(width, i + 1)):
            k = width - 1 - m
            both = moved[i] * moved[i - m] * (1.0 if m == 0 else 2.0)
            work -= stiffness[i, k] * both
            stiffer += (stiffness_there[i, k] - stiffness[i, k]) * both
    return work, stiffer


@linked()
def press(q, rule, matter, forces, stiffness):
    """Write forces of the surroundings and lower rows of their tangent, where there is room."""
    if forces.size > 0:
        forces[:] = 0.0
        stiffness[:, :] = 0.0
        add_contact_and_friction(q, rule, matter.around, matter.internal.anchor, forces, stiffness)


@linked()
def retreat(q, step, fixed, rule, matter, ref, promised, strain, line, bent, forces, stiffness):
    """Take back what of the last correction goes too far, see `remaining_share`.

    Args:
        step: the correction, (4 n,).
        strain, line: bending and twist before it, (nb, 3), and the response to them; none of them
            where the law is linear.
        bent: room for the response after it.
        forces, stiffness: see `press`, before it.

    Returns:
        The share of the correction that stays.
    """
    share, dof, size = 1.0, q.shape[1], forces.size
    moved, pressed, tangent = np.zeros(size), np.empty(size), np.empty(stiffness.shape)
    for _ in range(SHORTENINGS):
        unforeseen, stiffer = 0.0, 0.0
        if strain.shape[0] > 0:
            stretch, other = strains(q, rule, ref)
            respond(stretch, other, rule.weight, matter, bent)
        for e in range(strain.shape[0]):
            x1, x2 = other[e, 0] - strain[e, 0], other[e, 1] - strain[e, 1]
            both = line.bend_tangent[e, 1]
            more1 = bent.bend[e, 0] - line.bend[e, 0] - line.bend_tangent[e, 0] * x1 - both * x2
            more2 = bent.bend[e, 1] - line.bend[e, 1] - both * x1 - line.bend_tangent[e, 2] * x2
            unforeseen += rule.weight[e] * (more1 * x1 + more2 * x2)
            t11 = bent.bend_tangent[e, 0] - line.bend_tangent[e, 0]
            t22 = bent.bend_tangent[e, 2] - line.bend_tangent[e, 2]
            t12 = bent.bend_tangent[e, 1] - both
            stiffer += rule.weight[e] * (t11 * x1 * x1 + 2.0 * t12 * x1 * x2 + t22 * x2 * x2)
        if size > 0:
            press(q, rule, matter, pressed, tangent)
            for i in range(size):
                moved[i] = 0.0 if fixed[i] else share * step[i]
            against, more = work_unforeseen(moved, forces, stiffness, pressed, tangent)
            unforeseen += against
            stiffer += more
        stays = remaining_share(promised, unforeseen / share, stiffer / share**2, share)
        if stays == share:
            break
        for i in range(q.shape[0]):
            for c in range(dof):
                if not fixed[dof * i + c]:
                    q[i, c] -= (share - stays) * step[dof * i + c]
        share = stays
    return share
