# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One compiled step of the rod in time, after the generalised-alpha method.

See `dynamics` for the equations. Everything here serves the rod in space and in the plane.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements import rod_forces
from dlo_ros.rod.elements.constitutive_law import update_internal
from dlo_ros.rod.elements.contact_and_friction import drag_along
from dlo_ros.rod.elements.drag_springs import drag_springs
from dlo_ros.rod.elements.rod_tables import Material
from dlo_ros.rod.solve import newton_in_lanes, newton_iteration
from dlo_ros.rod.solve.constraints import back_substitute
from dlo_ros.rod.solve.equation_system import (
    ITSELF,
    growth,
    inertia_of,
    material_at_rest,
    relaxation,
    residual,
    targets,
    with_quadratic_drag,
)
from dlo_ros.rod.solve.integrator_state import LAST, NEXT, TIME, assign

RHO = 0.6  # spectral radius at infinity; above 0.8 the stiff stretch blows up (numerics.md)
ALPHA_M = (2.0 * RHO - 1.0) / (RHO + 1.0)
ALPHA_F = RHO / (RHO + 1.0)
GAMMA = 0.5 + ALPHA_F - ALPHA_M
BETA = 0.25 * (GAMMA + 0.5) ** 2
SMALLEST_STEP = 1e-6  # [s]

JUMP = 0.1  # of a knot span: a larger one folds the DLO before the first correction

DONE, NO_CONVERGENCE, NO_DIRECTION = 0, 1, 2


@njit(from_python=False)
def strain_rate_weights(h, last):
    """Weights of the strains now, one and two steps ago in the strain rate [1/s]."""
    if last <= 0.0:
        return 1.0 / h, -1.0 / h, 0.0
    r = h / last
    return (1.0 + 2.0 * r) / (h * (1.0 + r)), -(1.0 + r) / h, r * r / (h * (1.0 + r))


@linked()
def damped(system, k, imposed, state, h):
    """The material of the incremental potential of one step of length h, for variant k."""
    c0, c1, c2 = strain_rate_weights(h, state.clock[LAST])
    time, t_r = state.clock[TIME], system.relaxation_time[k]
    now = growth(imposed, k, time + h)
    # Material that slips in is no strain.
    slip = c0 * now + c1 * growth(imposed, k, time)
    slip += c2 * growth(imposed, k, time - state.clock[LAST])
    matter = material_at_rest(system, k, now, state.internal)
    keep, gain = relaxation(matter.law, h)
    s, damping, relaxed = matter.stiffness, 1.0 + t_r * c0, matter.damping
    inner, bending = state.internal.inner, relaxed + gain + t_r * c0
    for e in range(s.stretch.size):
        past = c1 * state.stretch[e] + c2 * state.stretch_before[e] - slip
        s.stretch[e] *= damping
        s.stretch_rest[e] = (s.stretch_rest[e] - t_r * past) / damping
        for c in range(2):
            past = t_r * (c1 * state.other[e, c] + c2 * state.other_before[e, c])
            if gain != 0.0:
                past += keep * inner[e, c] - gain * inner[e, 4 + c]
            s.bend[e, c] *= bending / relaxed
            s.bend_rest[e, c] = (relaxed * s.bend_rest[e, c] - past) / bending
        s.bend[e, 2] *= bending / relaxed
        past = c1 * state.other[e, 2] + c2 * state.other_before[e, 2]
        s.twist[e] *= damping
        s.twist_rest[e] = (s.twist_rest[e] - t_r * past) / damping
    m = Material(
        s, bending, matter.bend_rest, matter.law, matter.around, matter.internal, keep, gain
    )  # fmt: skip
    if m.around.brake == 0.0:
        return m
    return with_quadratic_drag(m, _quadratic_drag(system.rule, now * m.around.brake, state, h))


@linked()
def _quadratic_drag(rule, coefficient, state, h):
    """Quadratic drag of a step of length h; see `drag_springs.drag_springs`."""
    there, speed, still = drag_prediction(
        state.q, state.velocity, state.acceleration, state.auxiliary, h
    )
    return drag_springs(rule, coefficient, there, speed, still, weights(h)[1])


@linked()
def drag_prediction(q, velocity, acceleration, auxiliary, h):
    """Place and velocity by which quadratic drag is judged, and the place at which there is none.

    All arrays have one shape; the results have it, too.
    """
    still, v_star, _ = extrapolated(q, velocity, acceleration, auxiliary, h)
    there, speed, (_, rate) = np.empty(still.shape), np.empty(still.shape), weights(h)
    x, v, a = q.ravel(), velocity.ravel(), auxiliary.ravel()
    past, predicted, fast, passing = still.ravel(), there.ravel(), speed.ravel(), v_star.ravel()
    for i in range(x.size):
        predicted[i] = x[i] + h * v[i] + 0.5 * h * h * a[i]
        fast[i] = v[i] + h * a[i]
        past[i] -= passing[i] / rate
    return there, speed, still


@linked()
def extrapolated(q, velocity, acceleration, auxiliary, h):
    """Extrapolations of Newmark's formulas: position, velocity and lag of acceleration.

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


@njit(from_python=False)
def weights(h):
    """Factors of q in the acceleration [1/s^2] and in the velocity [1/s] at the end of a step."""
    return (1.0 - ALPHA_M) / ((1.0 - ALPHA_F) * BETA * h * h), GAMMA / (BETA * h)


@linked()
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


@linked()
def step(system, imposed, state, h, tolerance, new, lanes, pace):
    """One step of length h.

    Args:
        system, imposed, state: the rod, its command, where it is.
        tolerance: see `newton_iteration.implicit_step`.
        new: output, the state after the step; nothing where it fails.
        lanes, pace: see `newton_in_lanes.implicit_step`, which takes the step where it can.

    Returns:
        Status and the estimated error of the step [m].
    """
    matter = damped(system, ITSELF, imposed, state, h)
    return _step(system, imposed, state, h, matter, tolerance, new, lanes, pace)


@linked()
def _step(system, imposed, state, h, matter, tolerance, new, lanes, pace):
    """One step with the material of its incremental potential; see `step`."""
    time = state.clock[TIME] + h
    assign(new.frames, state.frames)
    usable, target, gap = targets(system, ITSELF, imposed, time, state.q, new.frames)
    if not usable:
        return NO_DIRECTION, np.inf
    q_star, v_star, lag = extrapolated(
        state.q, state.velocity, state.acceleration, state.auxiliary, h
    )
    # Inertia and drag that the past causes, and the loads: the right-hand side.
    c_mass, c_drag = weights(h)
    factor = growth(imposed, ITSELF, time)
    q, still, first = new.q, np.zeros(q_star.shape), np.empty(q_star.shape)
    velocity, acceleration, _ = reached(still, q_star, v_star, lag, h)
    rhs = residual(system, ITSELF, factor, velocity, acceleration)
    for i in range(q.shape[0]):
        for c in range(q.shape[1]):
            rhs[i, c] = -rhs[i, c]
            first[i, c] = q_star[i, c] + h * h * BETA * state.auxiliary[i, c]
    inertia, spin = inertia_of(system, ITSELF, factor, c_mass, c_drag)
    iterations, negative = -1, 0
    if lanes.usable and not _jumps(system, first, target):
        assign(q, first)
        longer = factor / growth(imposed, ITSELF, state.clock[TIME])
        iterations, negative = newton_in_lanes.implicit_step(
            lanes, q, target, system.fixed, system.rule, matter, state.stretch, longer, inertia,
            rhs, system.length, tolerance, pace,
        )  # fmt: skip
    if iterations < 0:
        assign(q, first)
        iterations, negative = newton_iteration.implicit_step(
            q, target, system.fixed, system.pins, gap, system.rule, matter, state.reference,
            inertia, spin, rhs, system.length, tolerance,
        )  # fmt: skip
    # A negative eigenvalue: the step has left the branch that a smaller one would follow.
    if iterations < 0 or (negative > 0 and h > 10.0 * SMALLEST_STEP):
        return NO_CONVERGENCE, np.inf
    velocity, acceleration, auxiliary = reached(q, q_star, v_star, lag, h)
    error = abs(BETA - 1.0 / 6.0) * h * h * _mean_jump(system.fixed, auxiliary, state.auxiliary)
    new.clock[TIME], new.clock[LAST], new.clock[NEXT] = time, h, h
    assign(new.velocity, velocity)
    assign(new.acceleration, acceleration)
    assign(new.auxiliary, auxiliary)
    stretch, other = rod_forces.strains(q, system.rule, state.reference)
    assign(new.stretch, stretch)
    assign(new.other, other)
    assign(new.stretch_before, state.stretch)
    assign(new.other_before, state.other)
    frame_at(q, system.rule, state.reference, new.reference)
    update_internal_variables(q, other, system.rule, matter, new.internal)
    return DONE, error


@njit(from_python=False)
def _jumps(system, first, target):
    """Whether what is imposed is far from where the DLO was expected: it must be led there."""
    width, dof = system.length / (system.rule.weight.size // 3), first.shape[1]
    jump = 0.0
    for i in range(first.shape[0]):
        for c in range(dof):
            if system.fixed[dof * i + c]:
                jump = max(jump, abs(target[i, c] - first[i, c]))
    return jump > JUMP * width


@linked()
def frame_at(q, rule, ref, out):
    """Write the reference frame carried to q to out; in the plane it plays no role."""
    if q.shape[1] == 4:
        there = rod_forces.transport(q, rule, ref)
        assign(out.tangent, there.tangent)
        assign(out.rate, there.rate)
        assign(out.director, there.director)
        assign(out.twist, there.twist)


@linked()
def update_internal_variables(q, other, rule, matter, out):
    """Write the internal variables after a motion to q with strains `other` to out."""
    update_internal(other, matter, out)
    drag_along(q, rule, matter.around, matter.internal.anchor, out.anchor)


@njit(from_python=False)
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


@linked(from_python=True)
def starting_acceleration(rod, k, state):
    """The acceleration that the forces of a state cause, imposed points not accelerated.

    Args:
        rod: `system` and `imposed`, as one object.
        k: number of the variant of the rod.
        state: an `IntegratorState`.
    """
    system, imposed = rod.system, rod.imposed
    factor = growth(imposed, k, state.clock[TIME])
    none = np.zeros((state.q.shape[0], 4))
    matter = material_at_rest(system, k, factor, state.internal)
    if matter.around.brake != 0.0:
        still = state.q - state.velocity
        matter = with_quadratic_drag(
            matter, drag_springs(system.rule, factor * matter.around.brake, state.q, state.velocity,
                          still, 1.0)
        )  # fmt: skip
    _, gradient, _, _, _ = newton_iteration.linearise(
        state.q, system.rule, matter, state.reference, none, none
    )
    pull = residual(system, k, factor, state.velocity, np.zeros(state.q.shape)).ravel()
    right = np.empty((1, state.q.size))
    for i in range(state.q.size):
        right[0, i] = -pull[i] - gradient[i]
    mass, spin = inertia_of(system, k, factor, 1.0, 0.0)
    band, diagonal = newton_iteration.factorised_mass(mass, spin, system.fixed, right)
    back_substitute(band, diagonal, system.pins, np.zeros((1, system.pins.shape[0])), right)
    return right[0].reshape(state.q.shape)
