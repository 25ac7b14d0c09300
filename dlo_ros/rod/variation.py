"""Compiled sensitivities of steps and of equilibria, by the factorisation of the tangent matrix.

Every parameter is given by two variants of the rod and of its command, a little above and a little
below its value. At the solution, with the shape held, the residual of the equations is evaluated
with both; their difference is the explicit derivative, and one back-substitution gives that of the
shape. Strains, internal variables and the transported frame vary along. Because the shape is the
same in both, nothing large cancels, and whatever an effect does to the rod is covered.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from dlo_ros.rod import banded, forces, material, solver, surroundings
from dlo_ros.rod.constraints import back_substitute, eliminate
from dlo_ros.rod.moving import LAST, TIME, Moving, another, assign
from dlo_ros.rod.plane import PLANAR
from dlo_ros.rod.stepping import damped, extrapolated, frame_at, reached, remembered, weights
from dlo_ros.rod.surroundings import rest_anchor
from dlo_ros.rod.system import ITSELF, growth, inertia_of, matter_of, residual, targets, untouched
from dlo_ros.rod.tables import History, Reference
from dlo_ros.spline import FloatArray


class Varying(NamedTuple):
    """Derivatives of a moving rod by P parameters, changed in place; named as in `Moving`."""

    step: FloatArray  # (P,) half the distance of a parameter's two variants
    moves: FloatArray  # (P,) not 0 where the parameter changes what is imposed
    q: FloatArray  # (P, n, d)
    velocity: FloatArray
    acceleration: FloatArray
    auxiliary: FloatArray
    reference: Reference  # likewise with a leading axis of P
    frames: FloatArray  # (P, 2, 2, FRAME): the frames themselves, above and below
    stretch: FloatArray
    stretch_before: FloatArray
    other: FloatArray
    other_before: FloatArray
    history: History


@njit(cache=True, nogil=True)
def _rise(above, below, d, out):
    """Write (above - below) / (2 d) to out."""
    a, b, c = out.ravel(), above.ravel(), below.ravel()
    for i in range(a.size):
        a[i] = (b[i] - c[i]) / (2.0 * d)


@njit(cache=True, nogil=True)
def _shift(target, source, d, change):
    """Write source + d * change to target, arrays of one shape."""
    a, b, c = target.ravel(), source.ravel(), change.ravel()
    for i in range(a.size):
        a[i] = b[i] + d * c[i]


@njit(cache=True, nogil=True)
def _shift_state(target, state, v, a, d):
    """Write the state with d times the derivatives by parameter a added to target."""
    _shift(target.q, state.q, d, v.q[a])
    _shift(target.velocity, state.velocity, d, v.velocity[a])
    _shift(target.acceleration, state.acceleration, d, v.acceleration[a])
    _shift(target.auxiliary, state.auxiliary, d, v.auxiliary[a])
    _shift(target.stretch, state.stretch, d, v.stretch[a])
    _shift(target.stretch_before, state.stretch_before, d, v.stretch_before[a])
    _shift(target.other, state.other, d, v.other[a])
    _shift(target.other_before, state.other_before, d, v.other_before[a])
    _shift(target.history.plastic, state.history.plastic, d, v.history.plastic[a])
    _shift(target.history.anchor, state.history.anchor, d, v.history.anchor[a])
    if state.q.shape[1] != PLANAR:
        _shift_frame(target.reference, state.reference, v.reference, a, d)


@njit(cache=True, nogil=True)
def _shift_frame(target, ref, change, a, d):
    _shift(target.tangent, ref.tangent, d, change.tangent[a])
    _shift(target.rate, ref.rate, d, change.rate[a])
    _shift(target.director, ref.director, d, change.director[a])
    _shift(target.twist, ref.twist, d, change.twist[a])


@njit(cache=True, nogil=True)
def _forces(q, stretch, other, rule, ref, matter, grad_s, grad_o, response, gradient, band):
    """Elastic force at q with another material and reference frame, (n d,).

    In the plane the strains do not depend on the frame, and their derivatives are known.
    """
    if q.shape[1] != PLANAR:
        forces.assemble(
            q, rule, ref, matter, response, np.empty(0), gradient, band, np.empty(grad_s.shape),
            np.zeros(grad_o.shape),
        )  # fmt: skip
        return gradient.copy()
    weight = rule.weight
    material.respond(stretch, other, weight, matter, response)
    stress = np.zeros((1, weight.size, 3))
    stress[0, :, 0] = response.bend[:, 0]
    result = forces.stress_forces(
        rule, grad_s, grad_o, response.tension.reshape(1, weight.size), stress
    )[0]
    if matter.around.friction > 0.0 or matter.around.pegs.shape[0] > 0:
        surroundings.resist(q, rule, matter.around, matter.history.anchor, result, band)
    return result


@njit(cache=True, nogil=True)
def _solve(system, band, rhs, increments, gaps):
    """Solve the tangent system for the derivatives of the shape, in place of rhs (P, n d)."""
    eliminate(band, system.fixed, rhs, increments)
    diagonal = np.empty(system.fixed.size)
    banded.factorise(band, diagonal)
    back_substitute(band, diagonal, system.pins, gaps, rhs)


@njit(cache=True, nogil=True)
def _follow(system, q, other, old, varying, d_q, grad_s, grad_o):
    """Let what follows the shape vary along: strains, transported frame, internal variables.

    Args:
        q, other: shape and strains after the step.
        old: the state before it.
        varying: derivatives; those of q, frame, strains and history are changed.
        d_q: derivatives of the shape, shape (P, n, d).
        grad_s, grad_o: derivatives of the strains, see `assembly.assemble`.
    """
    rule = system.rule
    d_stretch, d_other = forces.strain_sensitivities(rule, grad_s, grad_o, d_q)
    above, below = another(old), another(old)
    shifted, strained = np.empty(q.shape), np.empty(other.shape)
    for a in range(varying.step.size):
        d = varying.step[a]
        if q.shape[1] != PLANAR:
            _shift_frame(above.reference, old.reference, varying.reference, a, d)
            _shift_frame(below.reference, old.reference, varying.reference, a, -d)
            _, up = forces.strains(q, rule, above.reference)
            _, down = forces.strains(q, rule, below.reference)
            for e in range(rule.weight.size):
                for c in range(3):
                    d_other[a, e, c] += (up[e, c] - down[e, c]) / (2.0 * d)
            _shift(shifted, q, d, d_q[a])
            frame_at(shifted, rule, above.reference, above.reference)
            _shift(shifted, q, -d, d_q[a])
            frame_at(shifted, rule, below.reference, below.reference)
            change = varying.reference
            _rise(above.reference.tangent, below.reference.tangent, d, change.tangent[a])
            _rise(above.reference.rate, below.reference.rate, d, change.rate[a])
            _rise(above.reference.director, below.reference.director, d, change.director[a])
            _rise(above.reference.twist, below.reference.twist, d, change.twist[a])
        if old.history.plastic.shape[0] + old.history.anchor.shape[0] > 0:
            before = varying.history
            for side in range(2):
                amount = d if side == 0 else -d
                end = above.history if side == 0 else below.history
                plastic, anchor = old.history.plastic.copy(), old.history.anchor.copy()
                _shift(plastic, old.history.plastic, amount, before.plastic[a])
                _shift(anchor, old.history.anchor, amount, before.anchor[a])
                matter = matter_of(system, 1 + 2 * a + side, 1.0, History(plastic, anchor))
                _shift(shifted, q, amount, d_q[a])
                _shift(strained, other, amount, d_other[a])
                remembered(shifted, strained, rule, matter, end)
            _rise(above.history.plastic, below.history.plastic, d, before.plastic[a])
            _rise(above.history.anchor, below.history.anchor, d, before.anchor[a])
    assign(varying.stretch_before, varying.stretch)
    assign(varying.other_before, varying.other)
    assign(varying.stretch, d_stretch)
    assign(varying.other, d_other)


@njit(cache=True, nogil=True)
def vary(system, imposed, old, new, varying):
    """Let the derivatives follow a converged step.

    Args:
        system, imposed: the rod and its command, with two variants for each parameter.
        old, new: its states before and after the step.
        varying: the derivatives before; become those after.
    """
    h, time, q, rule = new.clock[LAST], new.clock[TIME], new.q, system.rule
    c_mass, c_drag = weights(h)
    inertia, spin = inertia_of(system, ITSELF, growth(imposed, ITSELF, time), c_mass, c_drag)
    band, gradient, response, grad_s, grad_o = solver.linearise(
        q, rule, damped(system, ITSELF, imposed, old, h), old.reference, inertia, spin
    )
    count, m = varying.step.size, system.pins.shape[0]
    rhs, increments = np.zeros((count, q.size)), np.zeros((count, q.size))
    gaps, spare = np.zeros((count, m)), np.empty(band.shape)
    before = another(old)
    for a in range(count):
        for side in range(2):
            k, d = 1 + 2 * a + side, varying.step[a] if side == 0 else -varying.step[a]
            share = 0.5 / d
            _shift_state(before, old, varying, a, d)
            matter = damped(system, k, imposed, before, h)
            q_star, v_star, lag = extrapolated(
                before.q, before.velocity, before.acceleration, before.auxiliary, h
            )
            velocity, acceleration, _ = reached(q, q_star, v_star, lag, h)
            pull = residual(system, k, growth(imposed, k, time), velocity, acceleration).ravel()
            elastic = _forces(
                q, new.stretch, new.other, rule, before.reference, matter, grad_s, grad_o,
                response, gradient, spare,
            )  # fmt: skip
            for i in range(q.size):
                rhs[a, i] -= share * (pull[i] + elastic[i])
            if varying.moves[a] != 0.0:
                _, target, gap = targets(
                    system, k, imposed, time, before.q, varying.frames[a, side]
                )
                _add(increments[a], share, target.ravel())
                _add(gaps[a], share, gap)
    _solve(system, band, rhs, increments, gaps)
    d_q = rhs.reshape((count, q.shape[0], q.shape[1]))
    _follow(system, q, new.other, old, varying, d_q, grad_s, grad_o)
    q_star, v_star, lag = extrapolated(
        varying.q, varying.velocity, varying.acceleration, varying.auxiliary, h
    )
    velocity, acceleration, auxiliary = reached(d_q, q_star, v_star, lag, h)
    assign(varying.q, d_q)
    assign(varying.velocity, velocity)
    assign(varying.acceleration, acceleration)
    assign(varying.auxiliary, auxiliary)


@njit(cache=True, nogil=True)
def _add(target, factor, source):
    for i in range(target.size):
        target[i] += factor * source[i]


@njit(cache=True, nogil=True)
def vary_rest(system, imposed, before, rest, history, fresh, varying):
    """Let the derivatives be those of an equilibrium.

    Args:
        system, imposed: the rod and its command, with two variants for each parameter.
        before: configuration from which it was led there; its twist angles at the ends count.
        rest: the state there.
        history: internal variables with which the equilibrium was found.
        fresh: see `resting.settle`.
        varying: derivatives before, of which the frames count; become those at rest.
    """
    q, rule, time = rest.q, system.rule, rest.clock[TIME]
    none = np.zeros((q.shape[0], 4))
    matter = matter_of(system, ITSELF, growth(imposed, ITSELF, time), history)
    if fresh:
        matter = untouched(matter)
    band, gradient, response, grad_s, grad_o = solver.linearise(
        q, rule, matter, rest.reference, none, none
    )
    count, m = varying.step.size, system.pins.shape[0]
    rhs, increments = np.zeros((count, q.size)), np.zeros((count, q.size))
    gaps, spare, still = np.zeros((count, m)), np.empty(band.shape), np.zeros(q.shape)
    for a in range(count):
        for side in range(2):
            k = 1 + 2 * a + side
            share = 0.5 / (varying.step[a] if side == 0 else -varying.step[a])
            factor = growth(imposed, k, time)
            matter = matter_of(system, k, factor, history)
            if fresh:
                matter = untouched(matter)
            elastic = _forces(
                q, rest.stretch, rest.other, rule, rest.reference, matter, grad_s, grad_o,
                response, gradient, spare,
            )  # fmt: skip
            pull = residual(system, k, factor, still, still).ravel()
            for i in range(q.size):
                rhs[a, i] -= share * (pull[i] + elastic[i])
            if varying.moves[a] != 0.0:
                _, target, gap = targets(
                    system, k, imposed, time, before, varying.frames[a, side]
                )
                _add(increments[a], share, target.ravel())
                _add(gaps[a], share, gap)
    _solve(system, band, rhs, increments, gaps)
    d_q = rhs.reshape((count, q.shape[0], q.shape[1]))
    start = Moving(
        rest.clock, rest.q, rest.velocity, rest.acceleration, rest.auxiliary, rest.reference,
        rest.frames, rest.stretch, rest.stretch_before, rest.other, rest.other_before, history,
    )  # fmt: skip
    _follow(system, q, rest.other, start, varying, d_q, grad_s, grad_o)
    if fresh and history.anchor.shape[0] > 0:
        shifted = np.empty(q.shape)
        for a in range(count):
            d = varying.step[a]
            _shift(shifted, q, d, d_q[a])
            above = rest_anchor(shifted, rule)
            _shift(shifted, q, -d, d_q[a])
            _rise(above, rest_anchor(shifted, rule), d, varying.history.anchor[a])
    assign(varying.q, d_q)
    assign(varying.stretch_before, varying.stretch)
    assign(varying.other_before, varying.other)
