# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled derivatives of inelastic moments, and of their internal variables, by parameters.

The parts of the moment that the linear stiffness does not contain, the curvature x held, vary with
the numbers of the law and with the internal variables before. Of a share R that relaxes within T

    B (-R (x - rest) + gain (x - x before) + keep m),   keep = exp(-step / T),
    gain = R (1 - keep) T / step

is the moment, of which m is what of it was left before (see `generalised_alpha.damped`).
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked


@njit(inline="always")
def _relaxation(law, rates, h, a):
    """Keep and gain of a step of length h, and their derivatives by parameter a; 0 at rest."""
    if h == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    keep = np.exp(-h / law.lasting)
    gone = -np.expm1(-h / law.lasting) / h
    d_keep = keep * h / law.lasting**2 * rates.lasting[a]
    gain = law.relaxing * gone * law.lasting
    d_gain = gone * (rates.relaxing[a] * law.lasting + law.relaxing * rates.lasting[a])
    return keep, gain, d_keep, d_gain - law.relaxing * d_keep * law.lasting / h


@linked()
def add_law_stresses(base, more, law, rates, inner, past, other, derivatives, h, flat, stress_o):
    """Add the derivatives of inelastic moments, the strains held.

    Args:
        base, more: `Stiffness` in all variants, and its derivatives.
        law, rates: the law of the rod itself, and its derivatives.
        inner, past: internal variables before the step, see `InternalVariables`, and the
            derivatives of all of them.
        other: strains after the step, shape (nb, 3).
        derivatives: see `moment_derivatives`.
        h: length of the step [s].
        flat: whether the rod lies in the plane, where it has a curvature about one director only.
        stress_o: derivatives (P, nb, 3) to which they are added.
    """
    moment, slide, directors = derivatives.moment, derivatives.slide, 1 if flat else 2
    left, d_left = np.zeros(2), np.zeros(2)
    held = 1.0 - law.relaxing
    for a in range(stress_o.shape[0]):
        out = stress_o[a]
        if law.relaxing != 0.0 or rates.relaxing[a] != 0.0:
            keep, gain, d_keep, d_gain = _relaxation(law, rates, h, a)
            for e in range(inner.shape[0]):
                for c in range(directors):
                    x = other[e, c] - base.bend_rest[0, e, c]
                    step = other[e, c] - inner[e, 4 + c]
                    left[c] = gain * step + keep * inner[e, c] - law.relaxing * x
                    d_left[c] = (
                        d_gain * step - gain * past.inner[a, e, 4 + c] + d_keep * inner[e, c]
                        + keep * past.inner[a, e, c] - rates.relaxing[a] * x
                        + law.relaxing * more.bend_rest[a, e, c]
                    )  # fmt: skip
                for c in range(directors):
                    out[e, c] += more.bend[a, e, c] * left[c] + base.bend[0, e, c] * d_left[c]
                    out[e, c] += (
                        more.bend[a, e, 2] * left[1 - c] + base.bend[0, e, 2] * d_left[1 - c]
                    )
        for e in range(slide.shape[0]):
            z, before = slide[e], past.inner[a, e]
            for c in range(directors):
                out[e, c] += rates.slide[a] * z[c, 5] + law.slide * (
                    z[c, 2] * before[2] + z[c, 3] * before[3] + z[c, 4] * rates.turn[a, e]
                    - z[c, 0] * before[4] - z[c, 1] * before[5]
                )  # fmt: skip
        for e in range(moment.shape[0]):
            m, before = moment[e], past.yield_centre[a, e]
            s1, s2, r1, r2 = (
                more.bend[a, e, 0], more.bend[a, e, 1], more.bend_rest[a, e, 0],
                more.bend_rest[a, e, 1],
            )  # fmt: skip
            for c in range(directors):
                x = other[e, c] - base.bend_rest[0, e, c]
                linear = more.bend[a, e, c] * x - base.bend[0, e, c] * more.bend_rest[a, e, c]
                out[e, c] -= rates.relaxing[a] * (m[c, 9] - base.bend[0, e, c] * x)
                out[e, c] += held * (
                    m[c, 0] * s1 + m[c, 1] * s2 - m[c, 2] * r1 - m[c, 3] * r2
                    + m[c, 4] * before[0] + m[c, 5] * before[1]
                    + m[c, 6] * rates.yield_curvature[a, e] + m[c, 7] * rates.hardening[a]
                    + m[c, 8] * rates.half_curvature[a, e] - linear
                )  # fmt: skip


@linked()
def propagate_internal_bending(
    d_rest, law, rates, inner, change, other, derivatives, h, flat, d_other
):
    """Let the internal variables of bending vary along.

    Args:
        d_rest: derivatives of the rest curvature, shape (P, nb, 2).
        law, rates, inner, other, derivatives, flat: see `add_law_stresses`.
        change: derivatives of the internal variables, of which those of bending are changed.
        h: length of the step [s], 0 to an equilibrium.
        d_other: derivatives of the strains after the step, shape (P, nb, 3).
    """
    yields, slide, directors = derivatives.yield_centre, derivatives.slide, 1 if flat else 2
    for a in range(d_other.shape[0]):
        for e in range(yields.shape[0]):
            p, before = yields[e], change.yield_centre[a, e]
            p1, p2 = before[0], before[1]
            x1 = d_other[a, e, 0] - d_rest[a, e, 0]
            x2 = d_other[a, e, 1] - d_rest[a, e, 1]
            for c in range(directors):
                before[c] = (
                    p[c, 0] * x1 + p[c, 1] * x2 + p[c, 2] * p1 + p[c, 3] * p2
                    + p[c, 4] * rates.yield_curvature[a, e]
                )  # fmt: skip
        for e in range(slide.shape[0]):
            z, before = slide[e], change.inner[a, e]
            x1, x2 = d_other[a, e, 0] - before[4], d_other[a, e, 1] - before[5]
            z1, z2 = before[2], before[3]
            for c in range(directors):
                before[2 + c] = (
                    z[c, 0] * x1 + z[c, 1] * x2 + z[c, 2] * z1 + z[c, 3] * z2
                    + z[c, 4] * rates.turn[a, e]
                )  # fmt: skip
        relaxes = law.relaxing != 0.0 or rates.relaxing[a] != 0.0
        keep, gain, d_keep, d_gain = _relaxation(law, rates, h if relaxes else 0.0, a)
        for e in range(inner.shape[0]):
            before = change.inner[a, e]
            for c in range(directors):
                if relaxes:
                    step, more = other[e, c] - inner[e, 4 + c], d_other[a, e, c] - before[4 + c]
                    before[c] = (
                        d_keep * inner[e, c] + keep * before[c] + d_gain * step + gain * more
                    )
                before[4 + c] = d_other[a, e, c]
