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
from dlo_ros.rod.grips import Imposed
from dlo_ros.rod.plane import PLANAR
from dlo_ros.rod.stepping import (
    Moving,
    System,
    Uniform,
    damped,
    extrapolated,
    grown,
    growth,
    reached,
    remembered,
    targets,
    weights,
)
from dlo_ros.rod.tables import History, Law, Material, Reference, Stiffness, Surroundings
from dlo_ros.spline import FloatArray


class Variants(NamedTuple):
    """P parameters; number 2 p of the stacked arrays is above, number 2 p + 1 below."""

    system: System  # arrays and numbers with a leading axis of 2 P
    imposed: Imposed  # likewise
    moves: FloatArray  # (P,) whether the parameter changes what is imposed
    step: FloatArray  # (P,) half the distance of the two


class Varying(NamedTuple):
    """Derivatives of a moving rod, named as in `Moving`, with a leading axis of P."""

    q: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    auxiliary: FloatArray
    reference: Reference
    frames: FloatArray  # (P, 2, 2, FRAME): the frames themselves, above and below
    stretch: FloatArray
    stretch_before: FloatArray
    other: FloatArray
    other_before: FloatArray
    history: History


@njit(cache=True, nogil=True)
def _system(s, k):
    """Variant k of a stacked system."""
    return System(
        s.rule,
        Stiffness(
            s.stiffness.stretch[k], s.stiffness.stretch_rest[k], s.stiffness.bend[k],
            s.stiffness.bend_rest[k], s.stiffness.twist[k], s.stiffness.twist_rest[k],
        ),
        Law(
            s.law.active[k], s.law.half_curvature[k], s.law.yield_curvature[k], s.law.hardening[k]
        ),
        Surroundings(
            s.around.friction[k], s.around.creep[k], s.around.pegs[k], s.around.contact[k],
            s.around.span, s.around.b, s.around.weight,
        ),
        s.mass[k], s.spin[k], s.drag[k], s.still, s.load[k],
        Uniform(s.uniform.mass[k], s.uniform.spin[k], s.uniform.drag[k], s.uniform.load[k]),
        s.fixed, s.pins, s.pin_rows, s.relaxation_time[k], s.length, s.reach[k],
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _imposed(s, k):
    return Imposed(
        s.times[k], s.positions[k], s.rotations[k], s.velocities[k], s.kinds, s.gain[k]
    )


@njit(cache=True, nogil=True)
def _plus(x, d, change):
    """Sum of x and d times its change, arrays of one shape."""
    result = np.empty(x.shape)
    a, b, c = result.ravel(), x.ravel(), change.ravel()
    for i in range(a.size):
        a[i] = b[i] + d * c[i]
    return result


@njit(cache=True, nogil=True)
def _rise(above, below, d, out):
    """Write (above - below) / (2 d) to out."""
    a, b, c = out.ravel(), above.ravel(), below.ravel()
    for i in range(a.size):
        a[i] = (b[i] - c[i]) / (2.0 * d)


@njit(cache=True, nogil=True)
def _moved(state, v, a, d):
    """The state with d times the derivatives by parameter a added; the frame apart."""
    return Moving(
        state.time, state.last_step, state.next_step, _plus(state.q, d, v.q[a]),
        _plus(state.velocity, d, v.velocity[a]), _plus(state.acceleration, d, v.acceleration[a]),
        _plus(state.auxiliary, d, v.auxiliary[a]), _frame(state, v, a, d), state.frames,
        _plus(state.stretch, d, v.stretch[a]),
        _plus(state.stretch_before, d, v.stretch_before[a]), _plus(state.other, d, v.other[a]),
        _plus(state.other_before, d, v.other_before[a]),
        History(
            _plus(state.history.plastic, d, v.history.plastic[a]),
            _plus(state.history.anchor, d, v.history.anchor[a]),
        ),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _shifted(ref, change, a, d):
    """A reference frame with d times its derivatives by parameter a added."""
    return Reference(
        _plus(ref.tangent, d, change.tangent[a]), _plus(ref.rate, d, change.rate[a]),
        _plus(ref.director, d, change.director[a]), _plus(ref.twist, d, change.twist[a]),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _frame(state, v, a, d):
    if state.q.shape[1] == PLANAR:
        return state.reference
    return _shifted(state.reference, v.reference, a, d)


@njit(cache=True, nogil=True)
def _forces(q, stretch, other, system, ref, matter, grad_s, grad_o, response, gradient, band):
    """Elastic force at q with another material and reference frame, (n d,).

    In the plane the strains do not depend on the frame, and their derivatives are known.
    """
    if q.shape[1] != PLANAR:
        forces.assemble(
            q, system.rule, ref, matter, response, gradient, band, np.empty(grad_s.shape),
            np.zeros(grad_o.shape),
        )  # fmt: skip
        return gradient.copy()
    weight = system.rule.weight
    material.respond(stretch, other, weight, matter, response)
    stress = np.zeros((1, weight.size, 3))
    stress[0, :, 0] = response.bend[:, 0]
    result = forces.stress_forces(
        system.rule, grad_s, grad_o, response.tension.reshape(1, weight.size), stress
    )[0]
    if matter.around.friction > 0.0 or matter.around.pegs.shape[0] > 0:
        surroundings.resist(q, system.rule, matter.around, matter.history.anchor, result, band)
    return result


@njit(cache=True, nogil=True)
def _solve(system, band, rhs, increments, gaps):
    """Solve the tangent system for the derivatives of the shape, in place of rhs (P, n d)."""
    eliminate(band, system.fixed, rhs, increments)
    diagonal = np.empty(system.fixed.size)
    banded.factorise(band, diagonal)
    back_substitute(band, diagonal, system.pins, gaps, rhs)


@njit(cache=True, nogil=True)
def _internal(body, q, other, ref, before, variants, varying, d_q, grad_s, grad_o):
    """Derivatives of what follows the shape: strains, transported frame, internal variables.

    Args:
        body, q, other: the rod and its shape and strains after the step.
        ref, before: reference frame and history before it.
        variants, varying: as in `vary`.
        d_q: derivatives of the shape, shape (P, n, d).
        grad_s, grad_o: derivatives of the strains, see `assembly.assemble`.
    """
    rule = body.rule
    d_stretch, d_other = forces.strain_sensitivities(rule, grad_s, grad_o, d_q)
    frame = Reference(
        varying.reference.tangent.copy(), varying.reference.rate.copy(),
        varying.reference.director.copy(), varying.reference.twist.copy(),
    )  # fmt: skip
    history = History(varying.history.plastic.copy(), varying.history.anchor.copy())
    keeps = before.plastic.shape[0] + before.anchor.shape[0] > 0
    for a in range(variants.step.size):
        d = variants.step[a]
        if q.shape[1] != PLANAR:
            up = _shifted(ref, varying.reference, a, d)
            down = _shifted(ref, varying.reference, a, -d)
            _, above = forces.strains(q, rule, up)
            _, below = forces.strains(q, rule, down)
            d_other[a] = _plus(d_other[a], 0.5 / d, _plus(above, -1.0, below))
            up = forces.transport(_plus(q, d, d_q[a]), rule, up)
            down = forces.transport(_plus(q, -d, d_q[a]), rule, down)
            _rise(up.tangent, down.tangent, d, frame.tangent[a])
            _rise(up.rate, down.rate, d, frame.rate[a])
            _rise(up.director, down.director, d, frame.director[a])
            _rise(up.twist, down.twist, d, frame.twist[a])
        if keeps:
            above = _kept(body, q, other, before, variants, varying, d_q, d_other, a, 0)
            below = _kept(body, q, other, before, variants, varying, d_q, d_other, a, 1)
            _rise(above.plastic, below.plastic, d, history.plastic[a])
            _rise(above.anchor, below.anchor, d, history.anchor[a])
    return d_stretch, d_other, frame, history


@njit(cache=True, nogil=True)
def _kept(body, q, other, before, variants, varying, d_q, d_other, a, side):
    """The history after a step for one side of parameter a."""
    d = variants.step[a] if side == 0 else -variants.step[a]
    history = History(
        _plus(before.plastic, d, varying.history.plastic[a]),
        _plus(before.anchor, d, varying.history.anchor[a]),
    )
    there = _system(variants.system, 2 * a + side)
    return remembered(_plus(q, d, d_q[a]), _plus(other, d, d_other[a]), there, history)


@njit(cache=True, nogil=True)
def vary(system, imposed, old, new, variants, varying):
    """The derivatives of a converged step.

    Args:
        system, imposed: the rod and its command.
        old, new: its states before and after the step.
        variants: of the P parameters.
        varying: derivatives before the step.

    Returns:
        The derivatives after it.
    """
    h, time, q, rule = new.last_step, new.time, new.q, system.rule
    c_mass, c_drag = weights(h)
    body = grown(system, growth(imposed, time))
    band, gradient, response, grad_s, grad_o = solver.linearise(
        q, rule, damped(body, imposed, old, h), old.reference,
        c_mass * body.mass + c_drag * body.drag, c_mass * body.spin,
    )  # fmt: skip
    count, m = variants.step.size, system.pins.shape[0]
    rhs, increments = np.zeros((count, q.size)), np.zeros((count, q.size))
    gaps = np.zeros((count, m))
    inertia, viscous = np.empty(q.shape), np.empty(q.shape)
    spare = np.empty(band.shape)
    frames = varying.frames.copy()
    for a in range(count):
        for side in range(2):
            d = variants.step[a] if side == 0 else -variants.step[a]
            share = -0.5 / d  # the difference goes to the right-hand side
            there = _imposed(variants.imposed, 2 * a + side)
            other_body = grown(_system(variants.system, 2 * a + side), growth(there, time))
            before = _moved(old, varying, a, d)
            matter = damped(other_body, there, before, h)
            q_star, v_star, lag = extrapolated(
                before.q, before.velocity, before.acceleration, before.auxiliary, h
            )
            velocity, acceleration, _ = reached(q, q_star, v_star, lag, h)
            forces.multiply_scalar(other_body.mass, other_body.spin, acceleration, inertia)
            forces.multiply_scalar(other_body.drag, system.still, velocity, viscous)
            elastic = _forces(
                q, new.stretch, new.other, system, before.reference, matter, grad_s, grad_o,
                response, gradient, spare,
            )  # fmt: skip
            inertia += viscous - other_body.load
            rhs[a] += share * (inertia.ravel() + elastic)
            if variants.moves[a]:
                _, target, gap = targets(other_body, there, time, before.q, frames[a, side])
                increments[a] -= share * target.ravel()
                gaps[a] -= share * gap
    _solve(system, band, rhs, increments, gaps)
    d_q = rhs.reshape((count, q.shape[0], q.shape[1]))
    q_star, v_star, lag = extrapolated(
        varying.q, varying.velocity, varying.acceleration, varying.auxiliary, h
    )
    d_velocity, d_acceleration, d_auxiliary = reached(d_q, q_star, v_star, lag, h)
    d_stretch, d_other, reference, history = _internal(
        body, q, new.other, old.reference, old.history, variants, varying, d_q, grad_s, grad_o
    )
    return Varying(
        d_q, d_velocity, d_acceleration, d_auxiliary, reference, frames, d_stretch,
        varying.stretch, d_other, varying.other, history,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def vary_rest(system, imposed, time, before, rest, history, variants, varying):
    """The derivatives of an equilibrium.

    Args:
        system, imposed: the rod and its command.
        time: of the equilibrium [s] from the command's start.
        before: configuration from which it was led there; its twist angles at the ends count.
        rest: the state there.
        history: internal variables with which the equilibrium was found.
        variants: of the P parameters.
        varying: derivatives before; of these the frames and the history count.

    Returns:
        The derivatives there.
    """
    q, rule = rest.q, system.rule
    body = grown(system, growth(imposed, time))
    matter = Material(body.stiffness, body.stiffness, body.law, body.around, history)
    none = np.zeros(system.mass.shape)
    band, gradient, response, grad_s, grad_o = solver.linearise(
        q, rule, matter, rest.reference, none, none
    )
    count, m = variants.step.size, system.pins.shape[0]
    rhs, increments = np.zeros((count, q.size)), np.zeros((count, q.size))
    gaps = np.zeros((count, m))
    spare = np.empty(band.shape)
    frames = varying.frames.copy()
    for a in range(count):
        for side in range(2):
            share = -0.5 / (variants.step[a] if side == 0 else -variants.step[a])
            there = _imposed(variants.imposed, 2 * a + side)
            other_body = grown(_system(variants.system, 2 * a + side), growth(there, time))
            stiff = other_body.stiffness
            matter = Material(stiff, stiff, other_body.law, other_body.around, history)
            elastic = _forces(
                q, rest.stretch, rest.other, system, rest.reference, matter, grad_s, grad_o,
                response, gradient, spare,
            )  # fmt: skip
            rhs[a] += share * (elastic - other_body.load.ravel())
            if variants.moves[a]:
                _, target, gap = targets(other_body, there, time, before, frames[a, side])
                increments[a] -= share * target.ravel()
                gaps[a] -= share * gap
    _solve(system, band, rhs, increments, gaps)
    d_q = rhs.reshape((count, q.shape[0], q.shape[1]))
    d_stretch, d_other, reference, kept = _internal(
        body, q, rest.other, rest.reference, history, variants, varying, d_q, grad_s, grad_o
    )
    zero = np.zeros(d_q.shape)
    return Varying(
        d_q, zero, zero, zero, reference, frames, d_stretch, d_stretch, d_other, d_other, kept
    )
