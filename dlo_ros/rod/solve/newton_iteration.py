# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled solution of the rod's equations: static equilibrium and implicit steps.

All of it serves the rod in space and in the plane, see `elements.rod_forces`.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.constitutive_law import room
from dlo_ros.rod.elements.contact_and_friction import may_be_touched
from dlo_ros.rod.elements.rod_forces import (
    add_scalar_band,
    assemble,
    energy_of,
    multiply_scalar,
    predict_tensions,
    strain_gradients,
    strains,
    transport,
)
from dlo_ros.rod.solve import banded_factorisation
from dlo_ros.rod.solve.constraints import (
    compliance,
    constrain,
    constrained_negative_modes,
    eliminate,
    stiffen,
)
from dlo_ros.rod.solve.integrator_state import assign
from dlo_ros.rod.solve.step_back import press, retreat

MAX_STATIC_ITERATIONS = 300
MAX_NEWTON = 50
FARTHEST = 0.1  # of L: distance that a control point may move in one iteration
BETWEEN = 2.0  # widths of a knot span beyond a control point that the DLO may reach
PATIENCE = 15  # iterations after which corrections must shrink
# Directions softer than this, in squared frequencies over `rate2`, count as neutral: a bow that may
# turn about its ends' axis is not unstable by rounding.
NEUTRAL, NEUTRAL_STEPS = 1e-5, 3
LEAST_SHIFT = 1e-2  # likewise, where the stiffness is not positive
FREE_ITERATIONS = 60  # of those, without a check of the energy


@linked()
def _largest(x, dof):
    """Largest move of a control point [m] and largest change of theta [rad]."""
    move, turn = 0.0, 0.0
    for i in range(x.size):
        if i % dof == 3:
            turn = max(turn, abs(x[i]))
        else:
            move = max(move, abs(x[i]))
    return move, turn


@njit(from_python=False)
def longest_move(q, length, around):
    """Largest distance that a control point may move in one iteration [m]: not over a peg.

    A peg that is farther away than that from all control points, and from the DLO between them, is
    in nobody's way.
    """
    result, last = FARTHEST * length, q.shape[1] // 2  # x, z in the plane; x, y, z in space
    beside = BETWEEN * length / (q.shape[0] - 3)
    for peg in around.pegs:
        near = np.inf
        for i in range(q.shape[0]):
            near = min(near, np.hypot(q[i, 0] - peg[0], q[i, last] - peg[1]))
        result = min(result, max(0.5 * peg[2], near - peg[2] - beside))
    return result


@linked()
def equilibrium(q, increment, fixed, pins, gap, rule, matter, ref, load, mass, spin, rate2,
                length, tolerance):  # fmt: skip
    """Static equilibrium: Newton's method with a mass shift, descending in total energy.

    Args:
        q: start, overwritten with the equilibrium, shape (n, 4).
        increment: change of the fixed degrees of freedom still to be made, shape (4 n,).
        fixed: whether a degree of freedom is imposed, shape (4 n,).
        pins, gap: constraint rows (m, 4 n), and what they still lack (m,).
        rule, matter, ref: as in `assemble`.
        load: generalised dead load [N], shape (4 n,).
        mass, spin: basis matrices of the shift, shape (n, 4).
        rate2: scale of the shift [1/s^2].
        length: L [m].
        tolerance: convergence when a full Newton step is smaller than tolerance * L.

    Returns:
        Number of iterations, negative where it did not converge; number of negative eigenvalues
        of the stiffness there (0: stable); and the reference frame carried along.
    """
    size = q.size
    gradient, band = np.empty(size), np.empty((size, 4 * q.shape[1]))
    work, diagonal = np.empty((size, 4 * q.shape[1])), np.empty(size)
    grad_s, grad_o = strain_gradients(q, rule)
    response, spare, exact = room(rule.weight.size), room(rule.weight.size), np.empty(0)
    steps, step = np.empty((1, size)), np.empty(size)
    changes, still = increment.reshape(1, size), np.zeros((1, size))
    closed = np.zeros(gap.size)
    first = np.any(increment != 0.0) or np.any(gap != 0.0)
    shift, neutral = 0.0, 0
    for iteration in range(1, MAX_STATIC_ITERATIONS + 1):
        # The exact Hessian: with predicted tensions long steps would lose the branch.
        energy = assemble(q, rule, ref, matter, response, exact, gradient, band, grad_s, grad_o)
        energy -= np.dot(load, q.ravel())
        lack, longest = gap if first else closed, longest_move(q, length, matter.around)
        accepted = False
        negative = 0
        move, turn = 0.0, 0.0
        for _ in range(60):
            assign(work, band)
            if shift > 0.0:
                add_scalar_band(work, mass, spin, shift)
            for i in range(size):
                steps[0, i] = load[i] - gradient[i]
            eliminate(work, fixed, steps, changes if first else still)
            stiffen(work, steps, pins, lack.reshape(1, lack.size))
            negative = banded_factorisation.factorise(work, diagonal)
            y, schur = compliance(work, diagonal, pins)
            negative = constrained_negative_modes(negative, schur)
            if negative != 0:
                shift = max(4.0 * shift, LEAST_SHIFT * rate2)
                continue
            step = steps[0]
            banded_factorisation.solve(work, diagonal, step)
            if not constrain(pins, y, schur, lack, step):
                return -iteration, negative, ref
            move, turn = _largest(step, q.shape[1])
            if not np.isfinite(move + turn):
                shift = max(4.0 * shift, LEAST_SHIFT * rate2)
                continue
            trial = q + step.reshape(q.shape)
            # A long step bends before it stretches back: its energy says nothing at first, so
            # the descent is demanded only of a search that does not converge by itself.
            if move > longest or turn > 1.0:
                accepted = False
            elif first or iteration <= FREE_ITERATIONS:
                accepted = True
            else:
                new = energy_of(trial, rule, ref, matter, spare) - np.dot(load, trial.ravel())
                scale = abs(energy) + np.abs(load * q.ravel()).sum()
                accepted = new <= energy + 1e-13 * scale
            if accepted:
                assign(q, trial)
                break
            shift = max(4.0 * shift, LEAST_SHIFT * rate2)
        if not accepted:
            return -iteration, negative, ref
        ref = transport(q, rule, ref)
        small = move < tolerance * length and turn < 10.0 * tolerance
        if neutral > 0 or (small and not first):
            if shift == 0.0:
                return iteration, negative, ref
            # Converged; the inertia without shift shows whether the equilibrium is stable.
            for least in (0.0, NEUTRAL * rate2):
                assign(work, band)
                add_scalar_band(work, mass, spin, least)
                eliminate(work, fixed, steps, still)
                stiffen(work, steps[:0], pins, closed.reshape(1, closed.size))
                negative = banded_factorisation.factorise(work, diagonal)
                negative = constrained_negative_modes(negative, compliance(work, diagonal, pins)[1])
                if negative == 0:
                    break
            if negative > 0:
                return iteration, negative, ref
            if least > 0.0:
                # A few more steps, ever less held back, which along what is neutral go nowhere.
                neutral += 1
                if neutral > NEUTRAL_STEPS:
                    return iteration, 0, ref
                shift *= 0.1
                continue
        first = False
        shift = 0.1 * shift if shift > 1e-3 * rate2 else 0.0
    return -MAX_STATIC_ITERATIONS, 0, ref


@linked(from_python=True)
def implicit_step(q, target, fixed, pins, gap, rule, matter, ref, inertia, spin, rhs, length,
                  tolerance):  # fmt: skip
    """Solve inertia q + elastic gradient(q) = rhs for one step in time.

    Args:
        q: first guess, overwritten with the solution, shape (n, 4).
        target: values of the fixed degrees of freedom, shape (n, 4).
        pins, gap: constraint rows (m, 4 n) and the values that pins @ q must take, (m,).
        rule, matter, ref: as in `assemble`.
        inertia, spin: mass over time squared plus drag over time, for positions and for theta,
            shape (n, 4).
        rhs: shape (n, 4).
        length: L [m].
        tolerance: the last correction may leave an error of tolerance * L.

    Returns:
        Iterations (negative: not converged) and the number of negative eigenvalues at the end.
    """
    size, dof = q.size, q.shape[1]
    gradient, band = np.empty(size), np.empty((size, 4 * dof))
    diagonal, steps, increments = np.empty(size), np.empty((1, size)), np.zeros((1, size))
    grad_s, grad_o = strain_gradients(q, rule)
    response, tension_room = room(rule.weight.size), np.empty(rule.weight.size)
    predicted_tensions = tension_room[:0]
    product = np.empty(q.shape)
    y, schur = pins, np.empty((0, 0))
    lack = np.empty(gap.size)
    law = matter.law
    many = rule.weight.size if law.active != 0.0 or law.slide != 0.0 else 0
    pressed = size if may_be_touched(matter.around) else 0
    smooth = many + pressed == 0
    strain, bent, pull = np.empty((many, 3)), room(many), np.empty(0 if smooth else size)
    forces, stiffness = np.empty(pressed), np.empty((pressed, 4 * dof))
    before, promised = 0.0, 0.0
    for iteration in range(1, MAX_NEWTON + 1):
        # The first correction moves what is imposed, too, which does not come back.
        if not smooth and iteration > 2:
            before *= retreat(
                q, steps[0], fixed, rule, matter, ref, promised, strain, response, bent, forces,
                stiffness,
            )  # fmt: skip
        if many > 0:
            assign(strain, strains(q, rule, ref)[1])
        press(q, rule, matter, forces, stiffness)
        assemble(q, rule, ref, matter, response, predicted_tensions, gradient, band, grad_s, grad_o)
        add_scalar_band(band, inertia, spin, 1.0)
        multiply_scalar(inertia, spin, q, product)
        for i in range(q.shape[0]):
            for c in range(dof):
                k = dof * i + c
                steps[0, k] = rhs[i, c] - product[i, c] - gradient[k]
                if fixed[k]:
                    increments[0, k] = target[i, c] - q[i, c]
        eliminate(band, fixed, steps, increments)
        negative = banded_factorisation.factorise(band, diagonal)
        if negative < 0:
            return -iteration, negative
        step = steps[0]
        if not smooth:
            assign(pull, step)
        banded_factorisation.solve(band, diagonal, step)
        # Fixed degrees of freedom have no columns in `pins`; their share is in `gap` already.
        if gap.size > 0:
            for a in range(gap.size):
                lack[a] = gap[a] - np.dot(pins[a], q.ravel())
            y, schur = compliance(band, diagonal, pins)
            if not constrain(pins, y, schur, lack, step):
                return -iteration, negative
        move, turn = _largest(step, dof)
        if not np.isfinite(move + turn) or move > length:
            return -iteration, negative
        promised = 0.0
        for i in range(q.shape[0]):
            for c in range(dof):
                k = dof * i + c
                q[i, c] = target[i, c] if fixed[k] else q[i, c] + step[k]
                if not (smooth or fixed[k]):
                    promised += pull[k] * step[k]
        predicted_tensions = tension_room
        predict_tensions(rule, response, grad_s, steps, predicted_tensions)
        # Where corrections shrink, the next one is smaller than this one in the same ratio.
        now = max(move / length, 0.1 * turn)
        left = now if iteration == 1 else now * min(now / before, 1.0)
        if left < tolerance:
            return iteration, constrained_negative_modes(negative, schur)
        if iteration > PATIENCE and now > 0.9 * before:
            return -iteration, 0
        before = now
    return -MAX_NEWTON, 0


@linked()
def linearise(q, rule, matter, ref, inertia, spin):
    """Tangent matrix at q, and the derivatives of the strains there.

    Args:
        q, rule, matter, ref, inertia, spin: as in `implicit_step`.

    Returns:
        Band (4 n, 16), elastic gradient (4 n,), response, d stretch / dp (nb, 3), and d(kappa_1,
        kappa_2, twist)/d(p, s, theta, theta') of shape (nb, 3, 8).
    """
    gradient, band = np.empty(q.size), np.empty((q.size, 4 * q.shape[1]))
    grad_s, grad_o = strain_gradients(q, rule)
    response = room(rule.weight.size)
    exact = np.empty(0)
    assemble(q, rule, ref, matter, response, exact, gradient, band, grad_s, grad_o)
    add_scalar_band(band, inertia, spin, 1.0)
    return band, gradient, response, grad_s, grad_o


@linked()
def negative_modes(q, fixed, pins, rule, matter, ref, mass, spin, rate2):
    """Number of negative eigenvalues of the stiffness at q, with what is held."""
    none = np.zeros((q.shape[0], 4))
    band, _, _, _, _ = linearise(q, rule, matter, ref, none, none)
    add_scalar_band(band, mass, spin, NEUTRAL * rate2)
    nothing = np.zeros((0, q.size))
    eliminate(band, fixed, nothing, nothing)
    stiffen(band, nothing, pins, nothing)
    diagonal = np.empty(q.size)
    negative = banded_factorisation.factorise(band, diagonal)
    return constrained_negative_modes(negative, compliance(band, diagonal, pins)[1])


@linked()
def softest(q, fixed, pins, rule, matter, ref, mass, spin, rate2):
    """The motion in which an unstable equilibrium is softest, its largest move 1.

    Inverse iteration with a mass shift that makes the stiffness positive.
    """
    none = np.zeros((q.shape[0], 4))
    band, _, _, _, _ = linearise(q, rule, matter, ref, none, none)
    shift, work, diagonal = 1e-3 * rate2, np.empty(band.shape), np.empty(q.size)
    nothing = np.zeros((0, q.size))
    for _ in range(60):
        assign(work, band)
        add_scalar_band(work, mass, spin, shift)
        eliminate(work, fixed, nothing, nothing)
        stiffen(work, nothing, pins, nothing)
        negative = banded_factorisation.factorise(work, diagonal)
        y, schur = compliance(work, diagonal, pins)
        if constrained_negative_modes(negative, schur) == 0:
            break
        shift *= 2.0
    mode = np.empty(q.shape)
    for i in range(q.shape[0]):  # anything without symmetry
        for c in range(q.shape[1]):
            mode[i, c] = np.sin(1.7 * i + 2.3 * c + 0.4)
    product = np.empty(q.shape)
    for _ in range(12):
        multiply_scalar(mass, spin, mode, product)
        flat = product.ravel()
        for i in range(flat.size):
            if fixed[i]:
                flat[i] = 0.0
        banded_factorisation.solve(work, diagonal, flat)
        constrain(pins, y, schur, np.zeros(pins.shape[0]), flat)
        move, _ = _largest(flat, q.shape[1])
        if move == 0.0:
            break
        for i in range(q.shape[0]):
            for c in range(q.shape[1]):
                mode[i, c] = flat[q.shape[1] * i + c] / move
    return mode


@linked()
def lightest_move(mass, spin, fixed, pins, increment, gap):
    """Largest move of a control point in the lightest motion that makes an imposed change [m].

    It is to that motion that the first step of `equilibrium` tends as its mass shift grows. What a
    pin lacks takes control points beside it about twice as far, and more where a mass hangs there.

    Args:
        mass, spin, fixed, pins, increment, gap: as in `equilibrium`.
    """
    size = fixed.size
    band, diagonal = np.zeros((size, 4 * (size // mass.shape[0]))), np.empty(size)
    steps = np.zeros((1, size))
    add_scalar_band(band, mass, spin, 1.0)
    eliminate(band, fixed, steps, increment.reshape(1, size))
    banded_factorisation.factorise(band, diagonal)
    y, schur = compliance(band, diagonal, pins)
    step = steps[0]
    banded_factorisation.solve(band, diagonal, step)
    if not constrain(pins, y, schur, gap, step):
        return 0.0  # no motion closes the gap, as the search itself will find
    move, _ = _largest(step, size // mass.shape[0])
    return move


@linked()
def factorised_mass(mass, spin, fixed, rhs):
    """Factors (band, diagonal) of the mass matrix, imposed degrees of freedom eliminated."""
    size = fixed.size
    band, diagonal = np.zeros((size, 4 * (size // mass.shape[0]))), np.empty(size)
    add_scalar_band(band, mass, spin, 1.0)
    eliminate(band, fixed, rhs, np.zeros(rhs.shape))
    banded_factorisation.factorise(band, diagonal)
    return band, diagonal
