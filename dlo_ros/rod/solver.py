"""Compiled solution of the rod's equations: static equilibrium, implicit steps, sensitivities.

All of it serves the rod in space, q of shape (n, 4), and the rod in the plane, q of shape (n, 2):
the number of columns says which. Imposed degrees of freedom are eliminated exactly; pins (material
points held in the middle of the DLO) are linear constraints, met exactly by a Schur complement of
the banded matrix.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dlo_ros.rod import banded, kernels, plane
from dlo_ros.rod.plane import PLANAR

MAX_STATIC_ITERATIONS = 300
FREE_ITERATIONS = 60  # of those, without a check of the energy


@njit(cache=True, nogil=True)
def _assemble(q, rule, stiff, ref, gradient, band, grad_s, grad_o):
    if q.shape[1] == PLANAR:
        return plane.assemble(q, rule, stiff, gradient, band, grad_s, grad_o)
    return kernels.assemble(q, rule, stiff, ref, gradient, band, grad_s, grad_o)


@njit(cache=True, nogil=True)
def strains(q, rule, ref):
    """Strains of a configuration; see `kernels.strains` and `plane.strains`."""
    if q.shape[1] == PLANAR:
        return plane.strains(q, rule)
    return kernels.strains(q, rule, ref)


@njit(cache=True, nogil=True)
def transport(q, rule, ref):
    """The reference frame carried to configuration q; the plane needs none."""
    if q.shape[1] == PLANAR:
        return ref
    return kernels.transport(q, rule, ref)


@njit(cache=True, nogil=True)
def _strain_gradients(q, rule):
    """Room for the derivatives of the strains."""
    nb = rule.weight.size
    if q.shape[1] == PLANAR:
        return np.empty((nb, 2)), np.zeros((nb, 1, 4))
    return np.empty((nb, 3)), np.zeros((nb, 3, 8))


@njit(cache=True, nogil=True)
def add_scalar_band(band, scalar, spin, factor):
    """Add factor times a basis matrix, `scalar` (n, 4) for positions, `spin` for theta."""
    dof, last = band.shape[0] // scalar.shape[0], band.shape[1] - 1
    positions = min(dof, 3)
    for i in range(scalar.shape[0]):
        for j in range(max(0, i - 3), i + 1):
            k, at = 3 - i + j, last - dof * (i - j)
            for c in range(positions):
                band[dof * i + c, at] += factor * scalar[i, k]
            if positions < dof:
                band[dof * i + 3, at] += factor * spin[i, k]


@njit(cache=True, nogil=True)
def multiply_scalar(scalar, spin, x, out):
    """Write basis matrix times x (n, 4) or (n, 2) to out."""
    out[:, :] = 0.0
    dof = x.shape[1]
    for i in range(scalar.shape[0]):
        for j in range(max(0, i - 3), i + 1):
            k = 3 - i + j
            for c in range(dof):
                a = scalar[i, k] if c < 3 else spin[i, k]
                out[i, c] += a * x[j, c]
                if j < i:
                    out[j, c] += a * x[i, c]


@njit(cache=True, nogil=True)
def _eliminate(band, rhs, fixed, increment):
    """Replace the equations of fixed degrees of freedom by x = increment."""
    size, last = band.shape[0], band.shape[1] - 1
    for i in range(size):
        for j in range(max(0, i - last), i):
            k = last - i + j
            if fixed[i] or fixed[j]:
                if fixed[j] and not fixed[i]:
                    rhs[i] -= band[i, k] * increment[j]
                elif fixed[i] and not fixed[j]:
                    rhs[j] -= band[i, k] * increment[i]
                band[i, k] = 0.0
    for i in range(size):
        if fixed[i]:
            band[i, last] = 1.0
            rhs[i] = increment[i]


@njit(cache=True, nogil=True)
def _constrain(band, diagonal, pins, gap, x):
    """Correct the solution x so that pins @ x = gap; returns False where that is impossible."""
    m = pins.shape[0]
    if m == 0:
        return True
    y = pins.copy()
    for a in range(m):
        banded.solve(band, diagonal, y[a])
    schur = np.empty((m, m))
    excess = np.empty(m)
    for a in range(m):
        excess[a] = np.dot(pins[a], x) - gap[a]
        for b in range(m):
            schur[a, b] = np.dot(pins[a], y[b])
    if abs(np.linalg.det(schur / np.abs(schur).max())) < 1e-200:
        return False
    force = np.linalg.solve(schur, excess)
    for a in range(m):
        for i in range(x.size):
            x[i] -= force[a] * y[a, i]
    return True


@njit(cache=True, nogil=True)
def _largest(x, dof):
    """Largest move of a control point [m] and largest change of theta [rad]."""
    move, turn = 0.0, 0.0
    for i in range(x.size):
        if i % dof == 3:
            turn = max(turn, abs(x[i]))
        else:
            move = max(move, abs(x[i]))
    return move, turn


@njit(cache=True, nogil=True)
def elastic_energy(q, rule, stiff, ref):
    """Elastic energy [J] of configuration q."""
    stretch, other = strains(q, rule, ref)
    energy = 0.0
    for e in range(rule.weight.size):
        energy += (
            0.5
            * rule.weight[e]
            * (
                stiff.stretch[e] * (stretch[e] - stiff.stretch_rest[e]) ** 2
                + stiff.bend[e, 0] * (other[e, 0] - stiff.bend_rest[e, 0]) ** 2
                + stiff.bend[e, 1] * (other[e, 1] - stiff.bend_rest[e, 1]) ** 2
                + stiff.twist[e] * (other[e, 2] - stiff.twist_rest[e]) ** 2
            )
        )
    return energy


@njit(cache=True, nogil=True)
def equilibrium(q, increment, fixed, pins, gap, rule, stiff, ref, load, mass, spin, rate2,
                length, tolerance):  # fmt: skip
    """Static equilibrium: Newton's method with a mass shift, descending in total energy.

    Args:
        q: start, overwritten with the equilibrium, shape (n, 4).
        increment: change of the fixed degrees of freedom still to be made, shape (4 n,).
        fixed: which degrees of freedom are imposed, shape (4 n,).
        pins, gap: constraint rows (m, 4 n), and what they still lack (m,).
        rule, stiff, ref: as in `assemble`.
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
    grad_s, grad_o = _strain_gradients(q, rule)
    step = np.empty(size)
    zero = np.zeros(size)
    closed = np.zeros(gap.size)
    first = np.any(increment != 0.0) or np.any(gap != 0.0)
    shift = 0.0
    energy = 0.0
    for iteration in range(1, MAX_STATIC_ITERATIONS + 1):
        energy = _assemble(q, rule, stiff, ref, gradient, band, grad_s, grad_o)
        energy -= np.dot(load, q.ravel())
        change = increment if first else zero
        lack = gap if first else closed
        accepted = False
        negative = 0
        move, turn = 0.0, 0.0
        for _ in range(60):
            work[:, :] = band
            if shift > 0.0:
                add_scalar_band(work, mass, spin, shift)
            for i in range(size):
                step[i] = load[i] - gradient[i]
            _eliminate(work, step, fixed, change)
            negative = banded.factorise(work, diagonal)
            # With pins the inertia of the unconstrained matrix says nothing.
            if negative != 0 and (pins.shape[0] == 0 or negative < 0):
                shift = max(4.0 * shift, 1e-2 * rate2)
                continue
            banded.solve(work, diagonal, step)
            if not _constrain(work, diagonal, pins, lack, step):
                return -iteration, negative, ref
            move, turn = _largest(step, q.shape[1])
            if not np.isfinite(move + turn):
                shift = max(4.0 * shift, 1e-2 * rate2)
                continue
            trial = q + step.reshape(q.shape)
            # A long step bends before it stretches back: its energy says nothing at first, so
            # the descent is demanded only of a search that does not converge by itself.
            if move > 0.1 * length or turn > 1.0:
                accepted = False
            elif first or iteration <= FREE_ITERATIONS:
                accepted = True
            else:
                new = elastic_energy(trial, rule, stiff, ref) - np.dot(load, trial.ravel())
                scale = abs(energy) + np.abs(load * q.ravel()).sum()
                accepted = new <= energy + 1e-13 * scale
            if accepted:
                q[:, :] = trial
                break
            shift = max(4.0 * shift, 1e-2 * rate2)
        if not accepted:
            return -iteration, negative, ref
        ref = transport(q, rule, ref)
        small = move < tolerance * length and turn < 10.0 * tolerance
        if small and not first:
            # Converged; the inertia without shift tells whether the equilibrium is stable.
            if shift == 0.0:
                return iteration, negative if pins.shape[0] == 0 else 0, ref
            work[:, :] = band
            step[:] = 0.0
            _eliminate(work, step, fixed, zero)
            negative = banded.factorise(work, diagonal)
            if negative > 0:
                return iteration, negative, ref
        first = False
        shift = 0.1 * shift if shift > 1e-3 * rate2 else 0.0
    return -MAX_STATIC_ITERATIONS, 0, ref


@njit(cache=True, nogil=True)
def implicit_step(q, target, fixed, pins, gap, rule, stiff, ref, mass, spin, drag, still, c_mass,
                  c_drag, rhs, length, tolerance, max_iterations):  # fmt: skip
    """Solve (c_mass M + c_drag C) q + elastic gradient(q) = rhs for one step in time.

    Args:
        q: first guess, overwritten with the solution, shape (n, 4).
        target: values of the fixed degrees of freedom, shape (n, 4).
        pins, gap: constraint rows (m, 4 n) and the values that pins @ q must take, (m,).
        rhs: shape (n, 4).
        still: basis matrix that C has for theta (zero), shape (n, 4).

    Returns:
        Iterations (negative: not converged) and the number of negative pivots at the end.
    """
    size = q.size
    gradient, band = np.empty(size), np.empty((size, 4 * q.shape[1]))
    diagonal, step = np.empty(size), np.empty(size)
    grad_s, grad_o = _strain_gradients(q, rule)
    dof = q.shape[1]
    increment = np.zeros(size)
    product = np.empty(q.shape)
    lack = np.empty(gap.size)
    for iteration in range(1, max_iterations + 1):
        _assemble(q, rule, stiff, ref, gradient, band, grad_s, grad_o)
        add_scalar_band(band, mass, spin, c_mass)
        add_scalar_band(band, drag, still, c_drag)
        multiply_scalar(mass, spin, q, product)
        flat = step.reshape(q.shape)
        for i in range(q.shape[0]):
            for c in range(dof):
                flat[i, c] = rhs[i, c] - c_mass * product[i, c] - gradient[dof * i + c]
        multiply_scalar(drag, still, q, product)
        for i in range(q.shape[0]):
            for c in range(dof):
                flat[i, c] -= c_drag * product[i, c]
                if fixed[dof * i + c]:
                    increment[dof * i + c] = target[i, c] - q[i, c]
        _eliminate(band, step, fixed, increment)
        negative = banded.factorise(band, diagonal)
        if negative < 0:
            return -iteration, negative
        banded.solve(band, diagonal, step)
        # Fixed degrees of freedom have no columns in `pins`; their share is in `gap` already.
        for a in range(gap.size):
            lack[a] = gap[a] - np.dot(pins[a], q.ravel())
        if not _constrain(band, diagonal, pins, lack, step):
            return -iteration, negative
        move, turn = _largest(step, q.shape[1])
        if not np.isfinite(move + turn) or move > length:
            return -iteration, negative
        for i in range(q.shape[0]):
            for c in range(dof):
                q[i, c] += step[dof * i + c]
        if move < tolerance * length and turn < 10.0 * tolerance:
            return iteration, negative
    return -max_iterations, 0


@njit(cache=True, nogil=True)
def linearise(q, fixed, rule, stiff, ref, mass, spin, drag, still, c_mass, c_drag):
    """Factorised tangent matrix at q, and the derivatives of the strains there.

    Returns:
        band, diagonal (factors), number of negative pivots, d stretch / dp (nb, 3), and d(kappa_1,
        kappa_2, twist)/d(p, s, theta, theta') of shape (nb, 3, 8).
    """
    size = q.size
    gradient, band = np.empty(size), np.empty((size, 4 * q.shape[1]))
    diagonal = np.empty(size)
    grad_s, grad_o = _strain_gradients(q, rule)
    _assemble(q, rule, stiff, ref, gradient, band, grad_s, grad_o)
    add_scalar_band(band, mass, spin, c_mass)
    add_scalar_band(band, drag, still, c_drag)
    _eliminate(band, gradient, fixed, np.zeros(size))
    negative = banded.factorise(band, diagonal)
    return band, diagonal, negative, grad_s, grad_o


@njit(cache=True, nogil=True)
def back_substitute(band, diagonal, fixed, pins, rhs):
    """Solve the factorised tangent system for several right-hand sides, in place.

    Args:
        rhs: shape (P, 4 n); fixed degrees of freedom get the value 0, pinned points do not move.
    """
    still = np.zeros(pins.shape[0])
    for a in range(rhs.shape[0]):
        for i in range(rhs.shape[1]):
            if fixed[i]:
                rhs[a, i] = 0.0
        banded.solve(band, diagonal, rhs[a])
        _constrain(band, diagonal, pins, still, rhs[a])


@njit(cache=True, nogil=True)
def stress_forces(rule, grad_s, grad_o, stress_s, stress_o):
    """Generalised forces, (P, 4 n) or (P, 2 n), of stresses (P, nb) and (P, nb, 3)."""
    dof = PLANAR if grad_s.shape[1] == 2 else 4
    out = np.zeros((stress_s.shape[0], dof * (rule.span.max() + 4)))
    for a in range(stress_s.shape[0]):
        if dof == PLANAR:
            plane.scatter_stress(rule, grad_s, grad_o, stress_s[a], stress_o[a], out[a])
        else:
            kernels.scatter_stress(rule, grad_s, grad_o, stress_s[a], stress_o[a], out[a])
    return out


@njit(cache=True, nogil=True)
def strain_sensitivities(rule, grad_s, grad_o, dq):
    """Strains (P, nb) and (P, nb, 3) of increments dq, (P, n, 4) or (P, n, 2), to first order."""
    count = dq.shape[0]
    stretch = np.empty((count, rule.weight.size))
    other = np.empty((count, rule.weight.size, 3))
    for a in range(count):
        if dq.shape[2] == PLANAR:
            plane.strain_increments(rule, grad_s, grad_o, dq[a], stretch[a], other[a])
        else:
            kernels.strain_increments(rule, grad_s, grad_o, dq[a], stretch[a], other[a])
    return stretch, other


@njit(cache=True, nogil=True)
def factorised_mass(mass, spin, fixed):
    """Factors (band, diagonal) of the mass matrix with fixed degrees of freedom eliminated."""
    size = fixed.size
    band, diagonal = np.zeros((size, 4 * (size // mass.shape[0]))), np.empty(size)
    zero = np.zeros(size)
    add_scalar_band(band, mass, spin, 1.0)
    _eliminate(band, np.zeros(size), fixed, zero)
    banded.factorise(band, diagonal)
    return band, diagonal
