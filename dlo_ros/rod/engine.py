"""Compiled motion of the rod: generalised-alpha steps with error control and sensitivities.

See `dynamics` for the equations. Everything here serves the rod in space and in the plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from dlo_ros.rod import solver
from dlo_ros.rod.grips import THETA, Imposed, impose
from dlo_ros.rod.tables import Quadrature, Reference, Stiffness
from dlo_ros.spline import FloatArray

RHO = 0.6  # spectral radius at infinity; above 0.8 the stiff stretch blows up (numerics.md)
ALPHA_M = (2.0 * RHO - 1.0) / (RHO + 1.0)
ALPHA_F = RHO / (RHO + 1.0)
GAMMA = 0.5 + ALPHA_F - ALPHA_M
BETA = 0.25 * (GAMMA + 0.5) ** 2
SMALLEST_STEP = 1e-6  # [s]
FIRST_STEP = 1e-3  # [s]
MAX_NEWTON = 12

DONE, NO_CONVERGENCE, NO_DIRECTION = 0, 1, 2


class System(NamedTuple):
    """The rod's constants for compiled code."""

    rule: Quadrature
    stiffness: Stiffness
    mass: FloatArray  # (n, 4) band
    spin: FloatArray  # (n, 4) band
    drag: FloatArray  # (n, 4) band
    still: FloatArray  # (n, 4) zeros: theta has no drag
    weight: FloatArray  # (n, d) gravity [N]
    load: FloatArray  # (n, d) all dead loads [N]
    fixed: FloatArray  # (n d,) which degrees of freedom are held
    pins: FloatArray  # (m, n d) rows of pinned coordinates in the free ones
    pin_rows: FloatArray  # (m, n d) the same in all of them
    relaxation_time: float  # [s]
    length: float  # [m]
    reach: float  # [m]


class Moving(NamedTuple):
    """The state of a rod and of its P sensitivities; d is 4 in space, 2 in the plane."""

    time: float  # [s] from the command's start
    last_step: float
    next_step: float
    q: FloatArray  # (n, d)
    velocity: FloatArray
    acceleration: FloatArray
    auxiliary: FloatArray
    reference: Reference
    frames: FloatArray  # (2, FRAME)
    stretch: FloatArray  # (nb,) now, and one step ago
    stretch_before: FloatArray
    other: FloatArray  # (nb, 3)
    other_before: FloatArray
    d_q: FloatArray  # (P, n, d)
    d_velocity: FloatArray
    d_acceleration: FloatArray
    d_auxiliary: FloatArray
    d_stretch: FloatArray  # (P, nb)
    d_stretch_before: FloatArray
    d_other: FloatArray  # (P, nb, 3)
    d_other_before: FloatArray


@njit(cache=True, nogil=True)
def _strain_rate_weights(h, last):
    """Weights of the strains now, one and two steps ago in the strain rate [1/s]."""
    if last <= 0.0:
        return 1.0 / h, -1.0 / h, 0.0
    r = h / last
    return (1.0 + 2.0 * r) / (h * (1.0 + r)), -(1.0 + r) / h, r * r / (h * (1.0 + r))


@njit(cache=True, nogil=True)
def _damped(system, state, c0, c1, c2):
    """Stiffness and rest strains of the incremental potential of one step."""
    base, t_r = system.stiffness, system.relaxation_time
    factor = 1.0 + t_r * c0
    past_s = t_r * (c1 * state.stretch + c2 * state.stretch_before)
    past_o = t_r * (c1 * state.other + c2 * state.other_before)
    return Stiffness(
        base.stretch * factor,
        (base.stretch_rest - past_s) / factor,
        base.bend * factor,
        (base.bend_rest - past_o[:, :2]) / factor,
        base.twist * factor,
        (base.twist_rest - past_o[:, 2]) / factor,
    )


@njit(cache=True, nogil=True)
def _step(system, imposed, state, h, tolerance):
    """One step of length h.

    Returns:
        Status, the estimated error of the step [m], and the new state (the old one on failure).
    """
    c0, c1, c2 = _strain_rate_weights(h, state.last_step)
    stiff = _damped(system, state, c0, c1, c2)
    frames = state.frames.copy()
    q_star = state.q + h * state.velocity + (h * h * (0.5 - BETA)) * state.auxiliary
    v_star = state.velocity + (h * (1.0 - GAMMA)) * state.auxiliary
    lag = (ALPHA_F / (1.0 - ALPHA_F)) * state.acceleration - (
        ALPHA_M / (1.0 - ALPHA_F)
    ) * state.auxiliary
    q = q_star + (h * h * BETA) * state.auxiliary
    target = np.zeros(q.shape)
    theta = np.zeros(2)
    if q.shape[1] == 4:
        theta[0], theta[1] = state.q[0, 3], state.q[-1, 3]
    pinned = np.empty((system.pins.shape[0] // q.shape[1] if q.shape[1] == 2
                       else system.pins.shape[0] // 3, 3))  # fmt: skip
    time = state.time + h
    if not impose(imposed, time, theta, system.reach, frames, target, pinned):
        return NO_DIRECTION, np.inf, state
    gap = pin_gap(system, target, pinned)
    c_mass = (1.0 - ALPHA_M) / ((1.0 - ALPHA_F) * BETA * h * h)
    c_drag = GAMMA / (BETA * h)
    rhs, product = np.empty(q.shape), np.empty(q.shape)
    solver.multiply_scalar(system.mass, system.spin, c_mass * q_star + lag, rhs)
    solver.multiply_scalar(system.drag, system.still, c_drag * q_star - v_star, product)
    rhs += product + system.load
    iterations, negative = solver.implicit_step(
        q, target, system.fixed, system.pins, gap, system.rule, stiff, state.reference,
        system.mass, system.spin, system.drag, system.still, c_mass, c_drag, rhs, system.length,
        tolerance, MAX_NEWTON,
    )  # fmt: skip
    # A negative pivot: the step has left the branch that a smaller one would follow.
    left = negative > 0 and system.pins.shape[0] == 0 and h > 10.0 * SMALLEST_STEP
    if iterations < 0 or left:
        return NO_CONVERGENCE, np.inf, state
    auxiliary = (q - q_star) / (BETA * h * h)
    acceleration = c_mass * (q - q_star) - lag
    velocity = v_star + c_drag * (q - q_star)
    error = abs(BETA - 1.0 / 6.0) * h * h * _mean_jump(system.fixed, auxiliary, state.auxiliary)
    stretch, other = solver.strains(q, system.rule, state.reference)
    reference = solver.transport(q, system.rule, state.reference)
    d_q, d_velocity, d_acceleration = state.d_q, state.d_velocity, state.d_acceleration
    d_auxiliary, d_stretch, d_other = state.d_auxiliary, state.d_stretch, state.d_other
    new = Moving(
        time, h, h, q, velocity, acceleration, auxiliary, reference, frames, stretch,
        state.stretch, other, state.other, d_q, d_velocity, d_acceleration, d_auxiliary,
        d_stretch, state.d_stretch, d_other, state.d_other,
    )  # fmt: skip
    return DONE, error, new


@njit(cache=True, nogil=True)
def pin_gap(system, target, pinned):
    """What `pins @ q` must be: pinned positions (k, 3) less the share of what is held, (m,)."""
    m, dof = system.pins.shape[0], target.shape[1]
    gap = np.empty(m)
    flat = target.ravel()
    per = 3 if dof == 4 else 2
    for a in range(m):
        point, c = a // per, a % per
        value = pinned[point, c] if dof == 4 else pinned[point, 2 * c]
        for i in range(flat.size):
            if system.fixed[i]:
                value -= system.pin_rows[a, i] * flat[i]
        gap[a] = value
    return gap


@njit(cache=True, nogil=True)
def _mean_jump(fixed, new, old):
    """Mean change of the auxiliary acceleration over the free control points [m/s^2]."""
    total, count = 0.0, 0
    dof = new.shape[1]
    for i in range(new.shape[0]):
        if fixed[dof * i] or fixed[dof * i + 1]:
            continue
        x = 0.0
        for c in range(min(dof, 3)):
            x += (new[i, c] - old[i, c]) ** 2
        total += np.sqrt(x)
        count += 1
    return total / max(count, 1)


@njit(cache=True, nogil=True)
def _sensitivity(system, old, new, scales):
    """The derivatives of a converged step with respect to the logarithms of P parameters."""
    h, t_r = new.last_step, system.relaxation_time
    c0, c1, c2 = _strain_rate_weights(h, old.last_step)
    stiff = _damped(system, old, c0, c1, c2)
    c_mass = (1.0 - ALPHA_M) / ((1.0 - ALPHA_F) * BETA * h * h)
    c_drag = GAMMA / (BETA * h)
    band, diagonal, _, grad_s, grad_o = solver.linearise(
        new.q, system.fixed, system.rule, stiff, old.reference, system.mass, system.spin,
        system.drag, system.still, c_mass, c_drag,
    )  # fmt: skip
    q_star = old.d_q + h * old.d_velocity + (h * h * (0.5 - BETA)) * old.d_auxiliary
    v_star = old.d_velocity + (h * (1.0 - GAMMA)) * old.d_auxiliary
    lag = (ALPHA_F / (1.0 - ALPHA_F)) * old.d_acceleration - (
        ALPHA_M / (1.0 - ALPHA_F)
    ) * old.d_auxiliary
    base = system.stiffness
    rate_s = c0 * new.stretch + c1 * old.stretch + c2 * old.stretch_before
    rate_o = c0 * new.other + c1 * old.other + c2 * old.other_before
    count, nb = scales.shape[0], base.twist.size
    stress_s, stress_o = np.empty((count, nb)), np.empty((count, nb, 3))
    for a in range(count):
        by_stiffness, by_time = scales[a, 0], scales[a, 3] * t_r
        for e in range(nb):
            strain = new.stretch[e] - base.stretch_rest[e] + t_r * rate_s[e]
            past = t_r * (c1 * old.d_stretch[a, e] + c2 * old.d_stretch_before[a, e])
            stress_s[a, e] = base.stretch[e] * (by_stiffness * strain + by_time * rate_s[e] + past)
        for e in range(nb):
            for k in range(3):
                rest = base.bend_rest[e, k] if k < 2 else base.twist_rest[e]
                modulus = base.bend[e, k] if k < 2 else base.twist[e]
                strain = new.other[e, k] - rest + t_r * rate_o[e, k]
                past = t_r * (c1 * old.d_other[a, e, k] + c2 * old.d_other_before[a, e, k])
                stress_o[a, e, k] = modulus * (
                    by_stiffness * strain + by_time * rate_o[e, k] + past
                )
    rhs = -solver.stress_forces(system.rule, grad_s, grad_o, stress_s, stress_o)
    inertia, viscous = np.empty(new.q.shape), np.empty(new.q.shape)
    solver.multiply_scalar(system.mass, system.spin, new.acceleration, inertia)
    inertia -= system.weight
    solver.multiply_scalar(system.drag, system.still, new.velocity, viscous)
    product = np.empty(new.q.shape)
    for a in range(count):
        flat = rhs[a].reshape(new.q.shape)
        flat -= scales[a, 1] * inertia + scales[a, 2] * viscous
        solver.multiply_scalar(system.mass, system.spin, c_mass * q_star[a] + lag[a], product)
        flat += product
        solver.multiply_scalar(system.drag, system.still, c_drag * q_star[a] - v_star[a], product)
        flat += product
    solver.back_substitute(band, diagonal, system.fixed, system.pins, rhs)
    d_q = rhs.reshape(old.d_q.shape)
    d_stretch, d_other = solver.strain_sensitivities(system.rule, grad_s, grad_o, d_q)
    return Moving(
        new.time, new.last_step, new.next_step, new.q, new.velocity, new.acceleration,
        new.auxiliary, new.reference, new.frames, new.stretch, new.stretch_before, new.other,
        new.other_before, d_q, v_star + c_drag * (d_q - q_star), c_mass * (d_q - q_star) - lag,
        (d_q - q_star) / (BETA * h * h), d_stretch, old.d_stretch, d_other, old.d_other,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _next_stop(times, now, stop):
    """The next corner of the imposed motion, or the stop itself."""
    after = np.searchsorted(times, now + 1e-9, side="right")
    if after < times.size and now + 1e-9 < times[after] < stop - 1e-9:
        return times[after]
    return stop


@njit(cache=True, nogil=True)
def march(system, imposed, state, stops, tolerance, newton, scales, shapes, derivatives):
    """Integrate to a series of times.

    Args:
        system, imposed, state: the rod, its command, where it is.
        stops: times [s] from the command's start, growing, (S,).
        tolerance: error that one step may add [m], in the mean over the rod.
        newton: convergence of Newton's method, of L.
        scales: (P, 4) how each parameter scales stiffness, inertia with weight, drag and
            relaxation time; P = 0 carries no sensitivities.
        shapes: output, (S, n, d).
        derivatives: output, (S, P, n, d).

    Returns:
        Status, the state at the end (where it failed: the last good one), and the steps taken.
    """
    steps = 0
    for k in range(stops.size):
        while state.time < stops[k] - 1e-12:
            limit = _next_stop(imposed.times, state.time, stops[k])
            remaining = limit - state.time
            proposal = state.next_step if state.next_step > 0.0 else FIRST_STEP
            pieces = max(1.0, np.ceil(remaining / proposal * 0.999))
            h = remaining / pieces
            while True:
                steps += 1
                status, error, new = _step(system, imposed, state, h, newton)
                if status == NO_DIRECTION:
                    return status, state, steps
                if status == DONE and (error <= 2.0 * tolerance or h < 10.0 * SMALLEST_STEP):
                    break
                if status == DONE:
                    h *= max(0.2, 0.8 * (tolerance / error) ** (1.0 / 3.0))
                else:
                    h *= 0.25
                if h < SMALLEST_STEP:
                    return NO_CONVERGENCE, state, steps
            if scales.shape[0] > 0:
                new = _sensitivity(system, state, new, scales)
            growth = 2.0
            if error > 0.0:
                growth = min(2.0, 0.9 * (tolerance / error) ** (1.0 / 3.0))
            # A step cut short by a stop says nothing against a longer one.
            wanted = max(h * growth, min(proposal, h * 10.0) * 0.2)
            reached = limit if h >= remaining * (1.0 - 1e-12) else new.time
            state = _proposing(new, reached, wanted)
        shapes[k] = state.q
        for a in range(scales.shape[0]):
            derivatives[k, a] = state.d_q[a]
    return DONE, state, steps


@njit(cache=True, nogil=True)
def _proposing(s, time, next_step):
    """The state with an exact time and the step that the error control proposes."""
    return Moving(
        time, s.last_step, next_step, s.q, s.velocity, s.acceleration, s.auxiliary, s.reference,
        s.frames, s.stretch, s.stretch_before, s.other, s.other_before, s.d_q, s.d_velocity,
        s.d_acceleration, s.d_auxiliary, s.d_stretch, s.d_stretch_before, s.d_other,
        s.d_other_before,
    )  # fmt: skip


__all__ = ["DONE", "NO_CONVERGENCE", "NO_DIRECTION", "THETA", "Imposed", "Moving", "System",
           "march"]  # fmt: skip
