# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled derivatives of the shape where the tangent of bending is not symmetric.

Newton's method gets along with the symmetric part K of the tangent matrix, of which it has the
factors. Where a DLO that yields or rubs within itself bends about both directors, the skew part N
of the tangent is missing: along its flow the moment answers otherwise than across. A derivative
solves (K + N) x = b. From the solution with K alone, that with N follows by the generalised method
of conjugate gradients of Concus and Golub (A generalized conjugate gradient method for
nonsymmetric systems of linear equations, 1976) and Widlund (A Lanczos method for a class of
nonsymmetric systems of linear equations, 1978), one back-substitution an iteration.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements import rod_forces
from dlo_ros.rod.sensitivity.strain_sensitivity import turned_strains
from dlo_ros.rod.solve.constraints import back_substitute

ITERATIONS = 40
CLOSE = 1e-5  # correction of a derivative, over the largest of it, that ends the iteration


@njit(from_python=False)
def skew_tangent(derivatives, law):
    """Skew part of the tangent of the bending moments, half of 12 less 21, (nb,) [N m^2].

    Args:
        derivatives: see `moment_derivatives`.
        law: see `ConstitutiveLaw`.
    """
    moment, slide = derivatives.moment, derivatives.slide
    result = np.zeros(max(moment.shape[0], slide.shape[0]))
    held = 1.0 - law.relaxing
    for e in range(moment.shape[0]):
        result[e] += 0.5 * held * (moment[e, 0, 3] - moment[e, 1, 2])
    for e in range(slide.shape[0]):
        result[e] += 0.5 * law.slide * (slide[e, 0, 1] - slide[e, 1, 0])
    return result


@linked()
def _residual(rule, grad_s, grad_o, skew, d_other, fixed):
    """Forces (P, n d) that the skew part leaves over after changes d_other (P, nb, 3)."""
    count, nb = d_other.shape[0], d_other.shape[1]
    stress_s, stress_o = np.zeros((count, nb)), np.zeros((count, nb, 3))
    for a in range(count):
        for e in range(nb):
            stress_o[a, e, 0] = -skew[e] * d_other[a, e, 1]
            stress_o[a, e, 1] = skew[e] * d_other[a, e, 0]
    forces = rod_forces.stress_forces(rule, grad_s, grad_o, stress_s, stress_o)
    for a in range(count):
        for i in range(fixed.size):
            if fixed[i]:
                forces[a, i] = 0.0
    return forces


@linked()
def add_skew_part(
    system, band, diagonal, derivatives, law, grad_s, grad_o, other, turn, twist, solution
):  # fmt: skip
    """Correct derivatives of the shape, found with the symmetric part of the tangent, in place.

    Args:
        system: the rod, see `equation_system.System`.
        band, diagonal: factors of the symmetric part, what is fixed eliminated.
        derivatives, law: see `skew_tangent`.
        grad_s, grad_o: derivatives of the strains, see `spatial_assembly.assemble`.
        other: strains (nb, 3).
        turn, twist: see `frame_derivatives.vary_frame`.
        solution: derivatives of the shape, shape (P, n d).
    """
    rule, count, size = system.rule, solution.shape[0], solution.shape[1]
    skew = skew_tangent(derivatives, law)
    if skew.size == 0 or count == 0 or not np.any(skew):
        return
    points, dof = size // 4, 4
    _, d_other = rod_forces.strain_sensitivities(
        rule, grad_s, grad_o, solution.reshape((count, points, dof))
    )
    turned_strains(rule, other, turn, twist, d_other)
    left = _residual(rule, grad_s, grad_o, skew, d_other, system.fixed)
    left_before, moved = np.zeros((count, size)), np.zeros((count, size))
    no_gaps = np.zeros((count, system.pins.shape[0]))
    weight, product = np.ones(count), np.zeros(count)
    active = np.ones(count, dtype=np.bool_)
    for iteration in range(ITERATIONS):
        answer = left.copy()
        back_substitute(band, diagonal, system.pins, no_gaps, answer)
        _, d_other = rod_forces.strain_sensitivities(
            rule, grad_s, grad_o, answer.reshape((count, points, dof))
        )
        forces = _residual(rule, grad_s, grad_o, skew, d_other, system.fixed)
        for a in range(count):
            if not active[a]:
                continue
            now = np.dot(left[a], answer[a])
            if not now > 0.0:  # nothing is left, or K is not positive: the shape is unstable
                active[a] = False
                continue
            if iteration > 0:
                weight[a] = 1.0 / (1.0 + now / (product[a] * weight[a]))
            product[a] = now
            w, change, largest = weight[a], 0.0, 0.0
            for i in range(size):
                # `moved` is the last correction of the solution.
                moved[a, i] = w * answer[a, i] + (w - 1.0) * moved[a, i]
                solution[a, i] += moved[a, i]
                after = (1.0 - w) * left_before[a, i] + w * forces[a, i]
                left_before[a, i] = left[a, i]
                left[a, i] = after
                change = max(change, abs(answer[a, i]))
                largest = max(largest, abs(solution[a, i]))
            active[a] = change > CLOSE * largest
        if not np.any(active):
            break
