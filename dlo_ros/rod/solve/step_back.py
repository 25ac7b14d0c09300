# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Corrections of Newton's method that go too far for a law of bending, shortened.

A law whose slope jumps, as that of a friction within the DLO where the motion turns, lets the
method go to and fro between both sides.
"""

from __future__ import annotations

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.constitutive_law import respond
from dlo_ros.rod.elements.rod_forces import strains

OVERSHOOT = 0.5  # work against a correction at its end, over that for it at its start


@njit(inline="always")
def remaining_share(promised, unforeseen, share):
    """The share of a correction that stays, where a law of bending is not what it was taken for.

    Along a correction, the work of the forces should fall from what it is at the start to nothing.
    Where the law turns it into more than `OVERSHOOT` of that against the correction, this ends
    where a straight course of the work is zero. How much a turn stretches the rod is no reason: the
    next correction takes that back.

    Args:
        promised: work of the forces along the whole correction, at its start [J].
        unforeseen: work, along the share, of moments that are not those of the tangent [J].
        share: share of the correction that was taken.
    """
    work = (1.0 - share) * promised - unforeseen / share
    if promised > 0.0 and work < -OVERSHOOT * promised:
        return share * promised / (promised - work)
    return share


@linked()
def retreat(q, step, fixed, rule, matter, ref, promised, strain, line, bent):
    """Take back what of the last correction goes too far for the law, see `remaining_share`.

    Args:
        step: the correction, (4 n,).
        strain, line: bending and twist before it, (nb, 3), and the response to them.
        bent: room for the response after it.

    Returns:
        The share of the correction that stays.
    """
    share, dof = 1.0, q.shape[1]
    while True:
        stretch, other = strains(q, rule, ref)
        respond(stretch, other, rule.weight, matter, bent)
        unforeseen = 0.0
        for e in range(stretch.size):
            x1, x2 = other[e, 0] - strain[e, 0], other[e, 1] - strain[e, 1]
            both = line.bend_tangent[e, 1]
            more1 = bent.bend[e, 0] - line.bend[e, 0] - line.bend_tangent[e, 0] * x1 - both * x2
            more2 = bent.bend[e, 1] - line.bend[e, 1] - both * x1 - line.bend_tangent[e, 2] * x2
            unforeseen += rule.weight[e] * (more1 * x1 + more2 * x2)
        stays = remaining_share(promised, unforeseen, share)
        if stays == share:
            return share
        for i in range(q.shape[0]):
            for c in range(dof):
                if not fixed[dof * i + c]:
                    q[i, c] -= (share - stays) * step[dof * i + c]
        share = stays
