# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Minimisation of the discrete rod's potential, compiled as with numba's @njit.

One implicit time step, and each step on the way to an equilibrium, is the minimum
of a `PlanarPotential`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.rod_kernels import BANDS, elastic, solve
from dlo_ros.synthesis.rod_laws import (
    BendingLaw,
    Contact,
    Friction,
    Wind,
    blow,
    drag_nodes,
    lean,
    press,
)  # fmt: skip

_TRIES = 12  # of a line search
_MOST_STEPS = 4000  # on the way to an equilibrium


class PlanarPotential(NamedTuple):
    """Elastic energy, laws, and sum(spring x^2 / 2 - load . x) over the nodes.

    Args:
        held: 1 where a node is imposed, 0 where it is free, shape (N + 1,).
        lengths: lengths of the edges [m], shape (N,).
        clamps: imposed directions [rad], NaN where free, shape (2,).
        stiffness: stiffness of each edge's stretch and of each vertex's turning angle [J].
        offsets: moments and forces of rest strain and history against each strain [J].
        spring: [N/m], shape (N + 1,), from inertia and drag.
        load: [N], shape (N + 1, 2).
        law: law of bending, where it is not linear.
        friction: friction with the board.
        contact: contact with pegs and a wall.
        wind: drag that grows with the square of speed.
    """

    held: FloatArray
    lengths: FloatArray
    clamps: FloatArray
    stiffness: tuple[FloatArray, FloatArray]
    offsets: tuple[FloatArray, FloatArray]
    spring: FloatArray
    load: FloatArray
    law: BendingLaw
    friction: Friction
    contact: Contact
    wind: Wind


def _evaluate(x: FloatArray, p: PlanarPotential, gradient: FloatArray, band: FloatArray) -> float:
    """Value of the potential [J].

    Args:
        x: nodes [m], shape (N + 1, 2).
        gradient: receives the gradient [N], shape (N + 1, 2), zero at held nodes.
        band: receives the Hessian [N/m], shape (BANDS, 2 (N + 1)), of the free nodes.
    """
    gradient[:] = 0.0
    band[:] = 0.0
    value: float = elastic(x, p.lengths, p.clamps, p.stiffness, p.offsets, p.law, gradient, band)
    if p.friction.active:
        value += drag_nodes(p.friction, x, gradient, band)
    if p.contact.active:
        value += press(p.contact, x, p.lengths, gradient, band)
        if p.contact.wall.size:
            value += lean(p.contact, x, p.lengths, gradient, band)
    if p.wind.active:
        value += blow(p.wind, x, gradient, band)
    for i in range(x.shape[0]):
        for c in range(2):
            value += (0.5 * p.spring[i] * x[i, c] - p.load[i, c]) * x[i, c]
            gradient[i, c] += p.spring[i] * x[i, c] - p.load[i, c]
            band[0, 2 * i + c] += p.spring[i]
    for i in range(x.shape[0]):
        if p.held[i] > 0.0:
            gradient[i, :] = 0.0
            for j in range(2 * i, 2 * i + 2):
                band[:, j] = 0.0
                for d in range(1, min(BANDS, j + 1)):
                    band[d, j - d] = 0.0
                band[0, j] = 1.0
    return value


def _direction(
    gradient: FloatArray, band: FloatArray, shift: FloatArray, result: FloatArray
) -> bool:
    """Newton's direction with `shift` [N/m], shape (N + 1,), added to the Hessian's diagonal.

    Returns:
        Whether that Hessian is positive definite.
    """
    nodes = shift.shape[0]
    factor = band.copy()
    for i in range(nodes):
        factor[0, 2 * i] += shift[i]
        factor[0, 2 * i + 1] += shift[i]
    right = -gradient.copy().reshape(2 * nodes)
    definite: bool = solve(factor, right)
    copy(right.reshape((nodes, 2)), result)
    return definite


def _copy(source: FloatArray, target: FloatArray) -> None:
    """Write a matrix to another one of its shape."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


def _minimise(x: FloatArray, p: PlanarPotential, tolerance: float) -> int:
    """Newton's method for one implicit step, in place.

    Returns:
        Number of iterations, or -1 where it did not converge to a step below `tolerance` [m].
    """
    nodes = x.shape[0]
    gradient, band = np.empty((nodes, 2)), np.empty((BANDS, 2 * nodes))
    direction = np.empty_like(x)
    kinked = p.law.active or p.friction.active or p.contact.active or p.wind.active
    stiffest = np.max(p.spring)
    limit = 0.5 * np.min(p.lengths)
    shift = 0.0
    known = False
    for iteration in range(100):
        if not known:
            evaluate(x, p, gradient, band)
            known = True
        if not newton(gradient, band, np.full(nodes, shift), direction):
            shift = max(4.0 * shift, stiffest)
            continue
        largest = np.max(np.abs(direction))
        scale = min(1.0, limit / max(largest, 1e-300))
        known = False
        if kinked and largest > tolerance:
            # Where a law bends sharply the full step may go too far: the slope along the
            # direction must not come out of it steeper than half of what it was, upwards.
            slope = np.sum(gradient * direction)
            start = x.copy()
            for _ in range(_TRIES):
                copy(start + scale * direction, x)
                evaluate(x, p, gradient, band)
                after = np.sum(gradient * direction)
                if after <= -0.5 * slope:
                    break
                scale *= min(max(slope / (slope - after), 0.1), 0.9)
            known = True
        else:
            x += scale * direction
        if largest <= tolerance and shift == 0.0:
            return iteration + 1
        shift = 0.0 if shift < 1e-3 * stiffest else 0.1 * shift
    return -1


def _descend(x: FloatArray, p: PlanarPotential, mass: FloatArray, rounding: float) -> bool:
    """Follow the potential downhill, in place: steps of growing pseudo time, at last Newton's.

    Args:
        mass: [kg], shape (N + 1,), that hinders each step.
        rounding: difference of potential that means nothing [J].

    Returns:
        Whether a minimum was reached.
    """
    nodes = x.shape[0]
    gradient, band = np.empty((nodes, 2)), np.empty((BANDS, 2 * nodes))
    trial_gradient, trial_band = np.empty_like(gradient), np.empty_like(band)
    direction = np.empty_like(x)
    limit = 0.2 * np.min(p.lengths)
    h = 1e-3
    value = evaluate(x, p, gradient, band)
    for _ in range(_MOST_STEPS):
        if newton(gradient, band, mass / h**2, direction):
            largest = np.max(np.abs(direction))
            trial = x + direction * (limit / max(largest, limit))
            after = evaluate(trial, p, trial_gradient, trial_band)
            if after <= value + rounding + 1e-12 * abs(value):
                copy(trial, x)
                value = after
                copy(trial_gradient, gradient)
                copy(trial_band, band)
                if h > 1e3 and largest < 1e-9:
                    return True
                h *= 1.6
                continue
        h *= 0.3
        if h < 1e-9:
            break
    return False


copy = linked()(_copy)
evaluate = linked(from_python=True)(_evaluate)
newton = linked()(_direction)
minimise = linked(from_python=True)(_minimise)
descend = linked(from_python=True)(_descend)
