"""One compiled step of the rod in time, after the generalised-alpha method.

See `dynamics` for the equations. Everything here serves the rod in space and in the plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from dlo_ros.rod import forces, solver
from dlo_ros.rod.constraints import back_substitute, pin_gap
from dlo_ros.rod.grips import impose
from dlo_ros.rod.material import remember
from dlo_ros.rod.surroundings import drag_along
from dlo_ros.rod.tables import (
    History,
    Law,
    Material,
    Quadrature,
    Reference,
    Stiffness,
    Surroundings,
)
from dlo_ros.spline import FloatArray

RHO = 0.6  # spectral radius at infinity; above 0.8 the stiff stretch blows up (numerics.md)
ALPHA_M = (2.0 * RHO - 1.0) / (RHO + 1.0)
ALPHA_F = RHO / (RHO + 1.0)
GAMMA = 0.5 + ALPHA_F - ALPHA_M
BETA = 0.25 * (GAMMA + 0.5) ** 2
SMALLEST_STEP = 1e-6  # [s]
MAX_NEWTON = 12

DONE, NO_CONVERGENCE, NO_DIRECTION = 0, 1, 2


class Uniform(NamedTuple):
    """What grows with the free length where the DLO slips through a grip; d is 4 or 2."""

    mass: FloatArray  # (n, 4) band
    spin: FloatArray  # (n, 4) band
    drag: FloatArray  # (n, 4) band
    load: FloatArray  # (n, d) [N]


class System(NamedTuple):
    """The rod's constants for compiled code."""

    rule: Quadrature
    stiffness: Stiffness
    law: Law
    around: Surroundings
    mass: FloatArray  # (n, 4) band
    spin: FloatArray  # (n, 4) band
    drag: FloatArray  # (n, 4) band
    still: FloatArray  # (n, 4) zeros: theta has no drag
    load: FloatArray  # (n, d) all dead loads [N]
    uniform: Uniform
    fixed: FloatArray  # (n d,) which degrees of freedom are held
    pins: FloatArray  # (m, n d) rows of pinned coordinates in the free ones
    pin_rows: FloatArray  # (m, n d) the same in all of them
    relaxation_time: float  # [s]
    length: float  # [m]
    reach: float  # [m]


class Moving(NamedTuple):
    """The state of a rod; d is 4 in space, 2 in the plane."""

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
    history: History


@njit(cache=True, nogil=True)
def strain_rate_weights(h, last):
    """Weights of the strains now, one and two steps ago in the strain rate [1/s]."""
    if last <= 0.0:
        return 1.0 / h, -1.0 / h, 0.0
    r = h / last
    return (1.0 + 2.0 * r) / (h * (1.0 + r)), -(1.0 + r) / h, r * r / (h * (1.0 + r))


@njit(cache=True, nogil=True)
def growth(imposed, time):
    """Free length at a time over that of the system: material slips in along with the motion."""
    gain, times = imposed.gain, imposed.times
    after = np.searchsorted(times, time, side="right")
    if after == 0 or after == times.size:
        return 1.0 + gain[max(after - 1, 0)]
    s = (time - times[after - 1]) / (times[after] - times[after - 1])
    return 1.0 + gain[after - 1] + s * (gain[after] - gain[after - 1])


@njit(cache=True, nogil=True)
def damped(system, imposed, state, h):
    """The material of the incremental potential of one step of length h."""
    c0, c1, c2 = strain_rate_weights(h, state.last_step)
    base, t_r = system.stiffness, system.relaxation_time
    factor = 1.0 + t_r * c0
    now = state.time + h
    # Material that slips in is no strain.
    slip = c0 * growth(imposed, now) + c1 * growth(imposed, state.time)
    slip += c2 * growth(imposed, state.time - state.last_step)
    nb = base.stretch.size
    merged = Stiffness(
        np.empty(nb), np.empty(nb), np.empty((nb, 2)), np.empty((nb, 2)), np.empty(nb),
        np.empty(nb),
    )  # fmt: skip
    for e in range(nb):
        past = c1 * state.stretch[e] + c2 * state.stretch_before[e] - slip
        merged.stretch[e] = base.stretch[e] * factor
        merged.stretch_rest[e] = (base.stretch_rest[e] - t_r * past) / factor
        for k in range(2):
            past = c1 * state.other[e, k] + c2 * state.other_before[e, k]
            merged.bend[e, k] = base.bend[e, k] * factor
            merged.bend_rest[e, k] = (base.bend_rest[e, k] - t_r * past) / factor
        past = c1 * state.other[e, 2] + c2 * state.other_before[e, 2]
        merged.twist[e] = base.twist[e] * factor
        merged.twist_rest[e] = (base.twist_rest[e] - t_r * past) / factor
    return Material(merged, base, system.law, system.around, state.history)


@njit(cache=True, nogil=True)
def grown(system, factor):
    """The system with its free length multiplied, over the same material coordinate.

    Curvature is a property of the shape; stretch and twist count per unit of the new length.
    """
    if factor == 1.0:
        return system
    s, more = system.stiffness, factor - 1.0
    stiffness = Stiffness(
        s.stretch / factor, factor * (1.0 + s.stretch_rest) - 1.0, s.bend * factor, s.bend_rest,
        s.twist / factor, s.twist_rest * factor,
    )  # fmt: skip
    u = system.uniform
    return System(
        system.rule, stiffness, system.law, system.around, system.mass + more * u.mass,
        system.spin + more * u.spin, system.drag + more * u.drag, system.still,
        system.load + more * u.load, u, system.fixed, system.pins, system.pin_rows,
        system.relaxation_time, system.length, system.reach * factor,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def extrapolated(q, velocity, acceleration, auxiliary, h):
    """What Newmark's formulas take from the past: position, velocity and lag of acceleration.

    All arrays have one shape; the results have it, too.
    """
    q_star, v_star, lag = np.empty(q.shape), np.empty(q.shape), np.empty(q.shape)
    x, v, a, w = q.ravel(), velocity.ravel(), acceleration.ravel(), auxiliary.ravel()
    x_star, speed, behind = q_star.ravel(), v_star.ravel(), lag.ravel()
    for i in range(x.size):
        x_star[i] = x[i] + h * v[i] + h * h * (0.5 - BETA) * w[i]
        speed[i] = v[i] + h * (1.0 - GAMMA) * w[i]
        behind[i] = (ALPHA_F * a[i] - ALPHA_M * w[i]) / (1.0 - ALPHA_F)
    return q_star, v_star, lag


@njit(cache=True, nogil=True)
def weights(h):
    """Factors of q in the acceleration [1/s^2] and in the velocity [1/s] at the end of a step."""
    return (1.0 - ALPHA_M) / ((1.0 - ALPHA_F) * BETA * h * h), GAMMA / (BETA * h)


@njit(cache=True, nogil=True)
def targets(system, imposed, time, q, frames):
    """Imposed values at a time, for a rod that is at q now.

    Returns:
        Whether they are usable, the values (n, d), and what the pins must give (m,).
    """
    target, theta, dof = np.zeros(q.shape), np.zeros(2), q.shape[1]
    if dof == 4:
        theta[0], theta[1] = q[0, 3], q[-1, 3]
    pinned = np.empty((system.pins.shape[0] // (2 if dof == 2 else 3), 3))
    usable = impose(imposed, time, theta, system.reach, frames, target, pinned)
    return usable, target, pin_gap(system.fixed, system.pins, system.pin_rows, target, pinned)


@njit(cache=True, nogil=True)
def reached(q, q_star, v_star, lag, h):
    """Velocity, acceleration and auxiliary acceleration at the end of a step to q."""
    velocity, acceleration, auxiliary = np.empty(q.shape), np.empty(q.shape), np.empty(q.shape)
    c_mass, c_drag = weights(h)
    x, x_star, speed, behind = q.ravel(), q_star.ravel(), v_star.ravel(), lag.ravel()
    v, a, w = velocity.ravel(), acceleration.ravel(), auxiliary.ravel()
    for i in range(x.size):
        moved = x[i] - x_star[i]
        v[i] = speed[i] + c_drag * moved
        a[i] = c_mass * moved - behind[i]
        w[i] = moved / (BETA * h * h)
    return velocity, acceleration, auxiliary


@njit(cache=True, nogil=True)
def _equations(system, state, h, q_star, v_star, lag):
    """First guess, right-hand side and inertia (for positions and theta) of a step's equations."""
    c_mass, c_drag = weights(h)
    n, dof = q_star.shape
    q, rhs, viscous = np.empty(q_star.shape), np.empty(q_star.shape), np.empty(q_star.shape)
    past, passing = np.empty(q_star.shape), np.empty(q_star.shape)
    inertia, spin = np.empty((n, 4)), np.empty((n, 4))
    for i in range(n):
        for c in range(dof):
            q[i, c] = q_star[i, c] + h * h * BETA * state.auxiliary[i, c]
            past[i, c] = c_mass * q_star[i, c] + lag[i, c]
            passing[i, c] = c_drag * q_star[i, c] - v_star[i, c]
        for k in range(4):
            inertia[i, k] = c_mass * system.mass[i, k] + c_drag * system.drag[i, k]
            spin[i, k] = c_mass * system.spin[i, k]
    forces.multiply_scalar(system.mass, system.spin, past, rhs)
    forces.multiply_scalar(system.drag, system.still, passing, viscous)
    for i in range(n):
        for c in range(dof):
            rhs[i, c] += viscous[i, c] + system.load[i, c]
    return q, rhs, inertia, spin


@njit(cache=True, nogil=True)
def step(system, imposed, state, h, tolerance):
    """One step of length h.

    Returns:
        Status, the estimated error of the step [m], and the new state (the old one on failure).
    """
    time = state.time + h
    system = grown(system, growth(imposed, time))
    matter = damped(system, imposed, state, h)
    frames = state.frames.copy()
    q_star, v_star, lag = extrapolated(
        state.q, state.velocity, state.acceleration, state.auxiliary, h
    )
    usable, target, gap = targets(system, imposed, time, state.q, frames)
    if not usable:
        return NO_DIRECTION, np.inf, state
    q, rhs, inertia, spin = _equations(system, state, h, q_star, v_star, lag)
    iterations, negative = solver.implicit_step(
        q, target, system.fixed, system.pins, gap, system.rule, matter, state.reference,
        inertia, spin, rhs, system.length, tolerance, MAX_NEWTON,
    )  # fmt: skip
    # A negative eigenvalue: the step has left the branch that a smaller one would follow.
    left = negative > 0 and h > 10.0 * SMALLEST_STEP
    if iterations < 0 or left:
        return NO_CONVERGENCE, np.inf, state
    velocity, acceleration, auxiliary = reached(q, q_star, v_star, lag, h)
    error = abs(BETA - 1.0 / 6.0) * h * h * _mean_jump(system.fixed, auxiliary, state.auxiliary)
    stretch, other = forces.strains(q, system.rule, state.reference)
    new = Moving(
        time, h, h, q, velocity, acceleration, auxiliary,
        forces.transport(q, system.rule, state.reference), frames, stretch, state.stretch, other,
        state.other, remembered(q, other, system, state.history),
    )  # fmt: skip
    return DONE, error, new


@njit(cache=True, nogil=True)
def remembered(q, other, system, history):
    """The history after a motion to q with strains `other`."""
    return History(
        remember(other, system.stiffness, system.law, history.plastic),
        drag_along(q, system.rule, system.around, history.anchor),
    )


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
def starting_acceleration(system, imposed, state):
    """The acceleration that the forces of a state cause, imposed points not accelerated."""
    body = grown(system, growth(imposed, state.time))
    matter = Material(body.stiffness, body.stiffness, body.law, body.around, state.history)
    none = np.zeros(body.mass.shape)
    _, gradient, _, _, _ = solver.linearise(
        state.q, body.rule, matter, state.reference, none, none
    )
    viscous = np.empty(state.q.shape)
    forces.multiply_scalar(body.drag, body.still, state.velocity, viscous)
    right = np.empty((1, state.q.size))
    right[0] = body.load.ravel() - gradient - viscous.ravel()
    band, diagonal = solver.factorised_mass(body.mass, body.spin, body.fixed, right)
    back_substitute(band, diagonal, body.pins, np.zeros((1, body.pins.shape[0])), right)
    return right[0].reshape(state.q.shape)
