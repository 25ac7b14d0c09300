# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Derivatives of stresses by eight parameters, from numbers of the rod that all of them share."""

from __future__ import annotations

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.simd.eight_lanes import LANES, entry, load, put_entry
from dlo_ros.rod.simd.vector_algebra import INLINE

STRESS = 4  # numbers of a strain: its stiffness, itself beyond rest with damping, its rate; itself
# two steps ago until that is known


@linked()
def strains_ago(strains, count, first, out):
    """Keep a number of strains that `simd_step.accept` forgets; see `STRESS`."""
    for e in range(count):
        put_entry(out, STRESS * (first + e) + 3, entry(strains, LANES * e))


@linked()
def strains_beyond(stiffness, rest, relaxation, now, before, rate_weights, count, first, out):
    """Write the numbers of strains, see `STRESS`; those two steps ago are there already."""
    t_r, (c0, c1, c2) = entry(relaxation, 0), rate_weights
    for e in range(count):
        x, k = entry(now, LANES * e), STRESS * (first + e)
        rate = c0 * x + c1 * entry(before, LANES * e) + c2 * entry(out, k + 3)
        put_entry(out, k, entry(stiffness, LANES * e))
        put_entry(out, k + 1, x - entry(rest, LANES * e) + t_r * rate)
        put_entry(out, k + 2, rate)


@njit(**INLINE)
def stress(rows, e, stresses, number, pace):
    """Derivative of a stress by eight parameters, the shape held.

    Args:
        rows: derivatives of stiffness and rest strain, of the strain before the step and one
            before.
        e: row of the strain there.
        stresses, number: see `STRESS`, and its number there.
        pace: derivatives of the relaxation time; that times the weights of both earlier strains in
            the rate, see `simd_step.rate_weights`.
    """
    stiffer, rest, now, before = rows
    slower, past, earlier = pace
    k = STRESS * number
    return load(stiffer, e) * entry(stresses, k + 1) + entry(stresses, k) * (
        slower * entry(stresses, k + 2) + past * load(now, e) + earlier * load(before, e)
        - load(rest, e)
    )  # fmt: skip
