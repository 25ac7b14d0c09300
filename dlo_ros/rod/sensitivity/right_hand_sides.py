# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled right-hand sides of the derivatives of a step by parameters, the shape held.

What follows from a rod's numbers, linearly or by the laws of bending and friction, is
differentiated as it stands. Of a parameter that changes how much slips through a grip, and of an
inelastic rod that slips, the residual of the equations is evaluated with both variants; because the
shape is the same, nothing large cancels.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.boundary.conditions import impose
from dlo_ros.rod.elements import constitutive_law, contact_and_friction, rod_forces
from dlo_ros.rod.elements.planar_assembly import PLANAR
from dlo_ros.rod.sensitivity.law_sensitivity import add_law_stresses
from dlo_ros.rod.sensitivity.sensitivity_state import (
    LINEAR,
    add,
    grown_rates,
    shift_state,
    with_rates,
)
from dlo_ros.rod.sensitivity.surroundings_sensitivity import add_surroundings_forces
from dlo_ros.rod.solve.constraints import pin_gap
from dlo_ros.rod.solve.equation_system import (
    ITSELF,
    add_inertia_and_drag,
    grown,
    growth,
    residual,
    targets,
    variant,
)
from dlo_ros.rod.solve.generalised_alpha import (
    damped,
    extrapolated,
    reached,
    strain_rate_weights,
    weights,
)
from dlo_ros.rod.solve.integrator_state import LAST, TIME, another


@linked()
def held_forces(q, stretch, other, rule, matter, grad_s, grad_o, response, spare):
    """Elastic force at q with another material, (n d,); strains and their derivatives are known."""
    weight = rule.weight
    constitutive_law.respond(stretch, other, weight, matter, response)
    stress = np.empty((1, weight.size, 3))
    for e in range(weight.size):
        stress[0, e, 0], stress[0, e, 1] = response.bend[e, 0], response.bend[e, 1]
        stress[0, e, 2] = response.torque[e]
    result = rod_forces.stress_forces(
        rule, grad_s, grad_o, response.tension.reshape(1, weight.size), stress
    )[0]
    if contact_and_friction.any_surroundings(matter.around):
        contact_and_friction.add_contact_and_friction(
            q, rule, matter.around, matter.internal.anchor, result, spare
        )
    return result


@linked()
def _stresses(system, old, new, slip, varying):
    """Derivatives of the stresses by P parameters, strains held: shapes (P, nb) and (P, nb, 3).

    Args:
        slip: rate at which material slips in, which is no strain [1/s].
    """
    h, base, more = new.clock[LAST], system.stiffness, varying.rates.stiffness
    t_r, d_t = system.relaxation_time[0], varying.rates.relaxation_time
    c0, c1, c2 = strain_rate_weights(h, old.clock[LAST])
    stretch, bend, twist = base.stretch[0], base.bend[0], base.twist[0]
    d_stretch, d_bend, d_twist = more.stretch, more.bend, more.twist
    d_stretch_rest, d_bend_rest, d_twist_rest = more.stretch_rest, more.bend_rest, more.twist_rest
    ago_s, earlier_s = varying.stretch, varying.stretch_before
    ago_o, earlier_o = varying.other, varying.other_before
    count, nb = ago_s.shape
    flat = new.q.shape[1] == PLANAR  # then there is one curvature only, and no twist
    rate_s, strain_s, rate_o, strain_o = (
        np.empty(nb), np.empty(nb), np.empty((nb, 3)), np.empty((nb, 3)),
    )  # fmt: skip
    for e in range(nb):
        rate_s[e] = c0 * new.stretch[e] + c1 * old.stretch[e] + c2 * old.stretch_before[e] - slip
        strain_s[e] = new.stretch[e] - base.stretch_rest[0, e] + t_r * rate_s[e]
        for c in range(1 if flat else 3):
            rest = base.bend_rest[0, e, c] if c < 2 else base.twist_rest[0, e]
            rate_o[e, c] = c0 * new.other[e, c] + c1 * old.other[e, c] + c2 * old.other_before[e, c]
            strain_o[e, c] = new.other[e, c] - rest + t_r * rate_o[e, c]
    coupled = not flat and (_any(bend[:, 2]) or _any(d_bend[:, :, 2]))
    stress_s, stress_o = np.empty((count, nb)), np.zeros((count, nb, 3))
    past, faster = t_r * c1, t_r * c2
    for a in range(count):
        slower = d_t[a]
        for e in range(nb):
            stress_s[a, e] = d_stretch[a, e] * strain_s[e] + stretch[e] * (
                slower * rate_s[e] + past * ago_s[a, e] + faster * earlier_s[a, e]
                - d_stretch_rest[a, e]
            )  # fmt: skip
            x1 = slower * rate_o[e, 0] + past * ago_o[a, e, 0] + faster * earlier_o[a, e, 0]
            x1 -= d_bend_rest[a, e, 0]
            stress_o[a, e, 0] = d_bend[a, e, 0] * strain_o[e, 0] + bend[e, 0] * x1
            if flat:
                continue
            x2, x3 = (
                slower * rate_o[e, 1] + past * ago_o[a, e, 1] + faster * earlier_o[a, e, 1]
                - d_bend_rest[a, e, 1],
                slower * rate_o[e, 2] + past * ago_o[a, e, 2] + faster * earlier_o[a, e, 2]
                - d_twist_rest[a, e],
            )  # fmt: skip
            stress_o[a, e, 1] = d_bend[a, e, 1] * strain_o[e, 1] + bend[e, 1] * x2
            stress_o[a, e, 2] = d_twist[a, e] * strain_o[e, 2] + twist[e] * x3
            if coupled:  # each curvature by the moment about the other director
                stress_o[a, e, 1] += d_bend[a, e, 2] * strain_o[e, 0] + bend[e, 2] * x1
                stress_o[a, e, 0] += d_bend[a, e, 2] * strain_o[e, 1] + bend[e, 2] * x2
    return stress_s, stress_o


@njit(from_python=False)
def _any(x):
    """Whether a number is not 0."""
    found = False
    for value in x.flat:
        found = found or value != 0.0
    return found


@njit(from_python=False)
def _differ(x, y):
    """Whether two rows of numbers (m,) differ."""
    found = False
    for i in range(x.size):
        found = found or x[i] != y[i]
    return found


@linked()
def _add_inertia(system, new, varying, rhs):
    """Add the derivatives of inertia, drag and loads, less those by the shape, to rhs (P, n d)."""
    h, rates = new.clock[LAST], varying.rates
    c_mass, c_drag = weights(h)
    q_star, v_star, lag = extrapolated(
        varying.q, varying.velocity, varying.acceleration, varying.auxiliary, h
    )
    mass, spin, drag, load = rates.mass, rates.spin, rates.drag, rates.load
    own_mass, own_spin, own_drag = system.mass[0], system.spin[0], system.drag[0]
    acceleration, velocity = new.acceleration, new.velocity
    count, n, dof = q_star.shape
    past, passing = np.empty((n, dof)), np.empty((n, dof))
    for a in range(count):
        out = rhs[a].reshape((n, dof))
        for i in range(n):
            for c in range(dof):
                past[i, c] = c_mass * q_star[a, i, c] + lag[a, i, c]
                passing[i, c] = c_drag * q_star[a, i, c] - v_star[a, i, c]
                out[i, c] += load[a, i, c]
        add_inertia_and_drag(own_mass, own_spin, own_drag, past, passing, 1.0, out)
        if rates.heavier[a] != 0.0:
            add_inertia_and_drag(mass[a], spin[a], drag[a], acceleration, velocity, -1.0, out)


@linked()
def _add_imposed(system, imposed, old, time, varying, increments, gaps):
    """Add the derivatives of what is imposed to increments (P, n d) and to gaps (P, m)."""
    q, moves, lengths, changes, frames, reach = (
        old.q, varying.moves, varying.step, varying.q, varying.frames, system.reach,
    )  # fmt: skip
    count, dof = gaps.shape[1], q.shape[1]
    target, theta = np.zeros(q.shape), np.zeros(2)
    pinned = np.empty((count // (2 if dof == PLANAR else 3), 3))
    for a in range(moves.size):
        if moves[a] == 0.0:
            continue
        for side in range(2):
            k, d = 1 + 2 * a + side, lengths[a] if side == 0 else -lengths[a]
            if dof != PLANAR:
                theta[0] = q[0, 3] + d * changes[a, 0, 3]
                theta[1] = q[-1, 3] + d * changes[a, -1, 3]
            far = reach[k] * growth(imposed, k, time)
            impose(variant(imposed, k), time, theta, far, frames[a, side], target, pinned)
            add(increments[a], 0.5 / d, target.ravel())
            if count > 0:
                gap = pin_gap(system.fixed, system.pins, system.pin_rows, target, pinned)
                add(gaps[a], 0.5 / d, gap)


@linked()
def written_out(
    system, imposed, old, new, slip, law, derivatives, varying, grad_s, grad_o, rhs, increments,
    gaps,
):  # fmt: skip
    """Right-hand sides of the derivatives of a step, from those of the rod's numbers.

    Each part is computed for all parameters in one call: to hand the rod's tables over takes longer
    than the work on one parameter.

    Args:
        slip: see `_stresses`.
    """
    h, rates = new.clock[LAST], varying.rates
    stress_s, stress_o = _stresses(system, old, new, slip, varying)
    if varying.kind != LINEAR:
        add_law_stresses(
            system.stiffness, rates.stiffness, law, rates.law, old.internal.inner,
            varying.internal, new.other, derivatives, h, new.q.shape[1] == PLANAR, stress_o,
        )  # fmt: skip
        add_surroundings_forces(system, old, new, h, varying, rhs)
    rhs -= rod_forces.stress_forces(system.rule, grad_s, grad_o, stress_s, stress_o)
    _add_inertia(system, new, varying, rhs)
    _add_imposed(system, imposed, old, new.clock[TIME], varying, increments, gaps)


@linked()
def _of_both_variants(
    system, imposed, old, new, varying, chosen, grad_s, grad_o, rhs, increments, gaps
):
    """Right-hand sides of any rod, from the residual of both variants of the chosen parameters.

    Args:
        chosen: whether each parameter is one of them, (P,).
    """
    h, time, q, rule = new.clock[LAST], new.clock[TIME], new.q, system.rule
    before, response = another(old), constitutive_law.room(rule.weight.size)
    spare = np.empty((q.size, 4 * q.shape[1]))
    for a in range(varying.step.size):
        if not chosen[a]:
            continue
        for out in (rhs[a], increments[a], gaps[a]):
            for i in range(out.size):
                out[i] = 0.0
        for side in range(2):
            k, d = 1 + 2 * a + side, varying.step[a] if side == 0 else -varying.step[a]
            share = 0.5 / d
            shift_state(before, old, varying, a, d)
            matter = damped(system, k, imposed, before, h)
            q_star, v_star, lag = extrapolated(
                before.q, before.velocity, before.acceleration, before.auxiliary, h
            )
            velocity, acceleration, _ = reached(q, q_star, v_star, lag, h)
            pull = residual(system, k, growth(imposed, k, time), velocity, acceleration).ravel()
            elastic = held_forces(
                q, new.stretch, new.other, rule, matter, grad_s, grad_o, response, spare
            )
            for i in range(q.size):
                rhs[a, i] -= share * (pull[i] + elastic[i])
            if varying.moves[a] != 0.0:
                _, target, gap = targets(
                    system, k, imposed, time, before.q, varying.frames[a, side]
                )
                add(increments[a], share, target.ravel())
                add(gaps[a], share, gap)


@linked()
def slipping(
    system, imposed, old, new, law, derivatives, varying, grad_s, grad_o, rhs, increments, gaps
):
    """Right-hand sides of a rod that slips through a grip: its numbers grow with its length."""
    time, last, h = new.clock[TIME], old.clock[LAST], new.clock[LAST]
    inner, count = old.internal, varying.step.size
    elastic = inner.yield_centre.shape[0] + inner.inner.shape[0] + inner.anchor.shape[0] == 0
    around, rates = system.around, varying.rates
    touching = around.pegs.shape[1] + around.walls.shape[1] > 0
    chosen = np.ones(count, dtype=np.bool_)
    if elastic and not touching and around.brake[0] == 0.0 and not _any(rates.brake):
        for a in range(count):
            chosen[a] = False
            for k in (1 + 2 * a, 2 + 2 * a):
                chosen[a] |= _differ(imposed.gain[k], imposed.gain[0])
                chosen[a] |= _differ(imposed.slip_step[k], imposed.slip_step[0])
        factor = growth(imposed, ITSELF, time)
        c0, c1, c2 = strain_rate_weights(h, last)
        slip = c0 * factor + c1 * growth(imposed, ITSELF, time - h)
        slip += c2 * growth(imposed, ITSELF, time - h - last)
        changes = with_rates(varying, grown_rates(system, varying, factor))
        written_out(
            grown(system, factor), imposed, old, new, slip, law, derivatives, changes, grad_s,
            grad_o, rhs, increments, gaps,
        )  # fmt: skip
    _of_both_variants(
        system, imposed, old, new, varying, chosen, grad_s, grad_o, rhs, increments, gaps
    )
