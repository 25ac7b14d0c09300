# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled sensitivities of steps and of equilibria, by the factorisation of the tangent matrix.

Every parameter is given by two variants of the rod and of its command, a little above and a little
below its value. What follows from their numbers, linearly or by the laws of bending and friction,
is differentiated as it stands. Where the rod slips, and at rest, the residual of the equations is
evaluated with both variants, with the shape of the solution held; because the shape is the same,
nothing large cancels. Either way one back-substitution gives the derivative of the shape. Strains,
internal variables and the transported frame vary along, and whatever an effect does to the rod is
covered.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.boundary.conditions import align
from dlo_ros.rod.elements import constitutive_law, contact_and_friction, rod_forces
from dlo_ros.rod.elements.contact_and_friction import rest_anchor
from dlo_ros.rod.elements.frame_derivatives import vary_frame
from dlo_ros.rod.elements.moment_derivatives import moment_derivatives
from dlo_ros.rod.elements.planar_assembly import PLANAR
from dlo_ros.rod.sensitivity.law_sensitivity import add_law_stresses
from dlo_ros.rod.sensitivity.sensitivity_state import (
    LINEAR,
    SLIPPING,
    add,
    central_difference,
    shift,
    shift_state,
)
from dlo_ros.rod.sensitivity.strain_sensitivity import follow
from dlo_ros.rod.sensitivity.surroundings_sensitivity import add_surroundings_forces
from dlo_ros.rod.solve import banded_factorisation, newton_iteration
from dlo_ros.rod.solve.constraints import back_substitute, eliminate
from dlo_ros.rod.solve.equation_system import (
    ITSELF,
    add_inertia_and_drag,
    frictionless,
    growth,
    inertia_of,
    material_at_rest,
    residual,
    targets,
)
from dlo_ros.rod.solve.generalised_alpha import (
    damped,
    extrapolated,
    reached,
    strain_rate_weights,
    weights,
)
from dlo_ros.rod.solve.integrator_state import LAST, TIME, IntegratorState, another, assign


@linked()
def _held_forces(q, stretch, other, rule, matter, grad_s, grad_o, response, spare):
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
def _solve(system, band, rhs, increments, gaps):
    """Solve the tangent system for the derivatives of the shape, in place of rhs (P, n d)."""
    eliminate(band, system.fixed, rhs, increments)
    diagonal = np.empty(system.fixed.size)
    banded_factorisation.factorise(band, diagonal)
    back_substitute(band, diagonal, system.pins, gaps, rhs)


@linked()
def _stresses(system, old, new, varying, h, a, stress_s, stress_o):
    """Derivatives of the stresses by parameter a, strains held: shape (nb,) and (nb, 3)."""
    c0, c1, c2 = strain_rate_weights(h, old.clock[LAST])
    base, more, t_r = system.stiffness, varying.rates.stiffness, system.relaxation_time[0]
    d_t = varying.rates.relaxation_time[a]
    for e in range(stress_s.size):
        rate = c0 * new.stretch[e] + c1 * old.stretch[e] + c2 * old.stretch_before[e]
        past = c1 * varying.stretch[a, e] + c2 * varying.stretch_before[a, e]
        stress_s[e] = more.stretch[a, e] * (
            new.stretch[e] - base.stretch_rest[0, e] + t_r * rate
        ) + base.stretch[0, e] * (d_t * rate + t_r * past - more.stretch_rest[a, e])
        for c in range(3):
            rate = c0 * new.other[e, c] + c1 * old.other[e, c] + c2 * old.other_before[e, c]
            past = c1 * varying.other[a, e, c] + c2 * varying.other_before[a, e, c]
            if c < 2:
                modulus, d_modulus = base.bend[0, e, c], more.bend[a, e, c]
                rest, d_rest = base.bend_rest[0, e, c], more.bend_rest[a, e, c]
            else:
                modulus, d_modulus = base.twist[0, e], more.twist[a, e]
                rest, d_rest = base.twist_rest[0, e], more.twist_rest[a, e]
            stress_o[e, c] = d_modulus * (new.other[e, c] - rest + t_r * rate) + modulus * (
                d_t * rate + t_r * past - d_rest
            )
        modulus, d_modulus = base.bend[0, e, 2], more.bend[a, e, 2]
        if modulus == 0.0 and d_modulus == 0.0:
            continue
        for c in range(2):  # each curvature by the moment about the other director
            rate = c0 * new.other[e, c] + c1 * old.other[e, c] + c2 * old.other_before[e, c]
            past = c1 * varying.other[a, e, c] + c2 * varying.other_before[a, e, c]
            strain = new.other[e, c] - base.bend_rest[0, e, c] + t_r * rate
            d_strain = d_t * rate + t_r * past - more.bend_rest[a, e, c]
            stress_o[e, 1 - c] += d_modulus * strain + modulus * d_strain


@linked()
def _written_out(
    system, imposed, old, new, law, derivatives, varying, grad_s, grad_o, rhs, increments, gaps
):
    """Right-hand sides of the derivatives of a step, from those of the rod's numbers."""
    h, time, rule = new.clock[LAST], new.clock[TIME], system.rule
    c_mass, c_drag = weights(h)
    count, nb, n = varying.step.size, rule.weight.size, new.q.shape[0]
    stress_s, stress_o = np.empty((count, nb)), np.empty((count, nb, 3))
    for a in range(count):
        _stresses(system, old, new, varying, h, a, stress_s[a], stress_o[a])
    if varying.kind != LINEAR:
        add_law_stresses(
            system.stiffness, varying.rates.stiffness, law, varying.rates.law, old.internal.inner,
            varying.internal, new.other, derivatives, h, stress_o,
        )  # fmt: skip
        add_surroundings_forces(system, old, new, h, varying, rhs)
    pull = rod_forces.stress_forces(rule, grad_s, grad_o, stress_s, stress_o)
    q_star, v_star, lag = extrapolated(
        varying.q, varying.velocity, varying.acceleration, varying.auxiliary, h
    )
    past, passing = np.empty(new.q.shape), np.empty(new.q.shape)
    rates = varying.rates
    for a in range(count):
        for i in range(n):
            for c in range(new.q.shape[1]):
                past[i, c] = c_mass * q_star[a, i, c] + lag[a, i, c]
                passing[i, c] = c_drag * q_star[a, i, c] - v_star[a, i, c]
                k = new.q.shape[1] * i + c
                rhs[a, k] += rates.load[a, i, c] - pull[a, k]
        right = rhs[a].reshape(new.q.shape)
        add_inertia_and_drag(
            system.mass[0], system.spin[0], system.drag[0], past, passing, 1.0, right
        )
        add_inertia_and_drag(
            rates.mass[a], rates.spin[a], rates.drag[a], new.acceleration, new.velocity, -1.0,
            right,
        )  # fmt: skip
        if varying.moves[a] != 0.0:
            for side in range(2):
                d = varying.step[a] if side == 0 else -varying.step[a]
                before = old.q.copy()
                shift(before, old.q, d, varying.q[a])
                _, target, gap = targets(
                    system, 1 + 2 * a + side, imposed, time, before, varying.frames[a, side]
                )
                add(increments[a], 0.5 / d, target.ravel())
                add(gaps[a], 0.5 / d, gap)


@linked()
def _of_both_variants(system, imposed, old, new, varying, grad_s, grad_o, rhs, increments, gaps):
    """The same for any rod, from the residual of both variants of each parameter."""
    h, time, q, rule = new.clock[LAST], new.clock[TIME], new.q, system.rule
    before, response = another(old), constitutive_law.room(rule.weight.size)
    spare = np.empty((q.size, 4 * q.shape[1]))
    for a in range(varying.step.size):
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
            elastic = _held_forces(
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
def propagate_step(system, imposed, old, new, varying):
    """Propagate the derivatives through a converged step.

    Args:
        system, imposed: the rod and its command, with two variants for each parameter.
        old, new: sensitivity states before and after the step.
        varying: the derivatives before; become those after.
    """
    h, time, q, rule = new.clock[LAST], new.clock[TIME], new.q, system.rule
    c_mass, c_drag = weights(h)
    inertia, spin = inertia_of(system, ITSELF, growth(imposed, ITSELF, time), c_mass, c_drag)
    matter = damped(system, ITSELF, imposed, old, h)
    band, _, response, grad_s, grad_o = newton_iteration.linearise(
        q, rule, matter, old.reference, inertia, spin
    )
    count, m = varying.step.size, system.pins.shape[0]
    rhs, increments = np.zeros((count, q.size)), np.zeros((count, q.size))
    gaps = np.zeros((count, m))
    turn, twist = np.zeros((count, rule.weight.size)), np.zeros((count, rule.weight.size))
    derivatives = moment_derivatives(
        new.other, system.stiffness.bend[0], matter.bend_rest, old.internal, matter.law
    )
    if varying.kind == SLIPPING:
        _of_both_variants(system, imposed, old, new, varying, grad_s, grad_o, rhs, increments, gaps)
    else:
        _written_out(
            system, imposed, old, new, matter.law, derivatives, varying, grad_s, grad_o, rhs,
            increments, gaps,
        )  # fmt: skip
    if q.shape[1] != PLANAR:
        forces = np.zeros((count, q.size))
        vary_frame(
            q, rule, old.reference, varying.reference, new.other, response, turn, twist, forces
        )
        rhs -= forces
    _solve(system, band, rhs, increments, gaps)
    d_q = rhs.reshape((count, q.shape[0], q.shape[1]))
    follow(system, new, old, h, matter, derivatives, varying, d_q, grad_s, grad_o, turn, twist)
    q_star, v_star, lag = extrapolated(
        varying.q, varying.velocity, varying.acceleration, varying.auxiliary, h
    )
    velocity, acceleration, auxiliary = reached(d_q, q_star, v_star, lag, h)
    assign(varying.q, d_q)
    assign(varying.velocity, velocity)
    assign(varying.acceleration, acceleration)
    assign(varying.auxiliary, auxiliary)


@linked(from_python=True)
def propagate_equilibrium(system, imposed, before, rest, internal, fresh, varying):
    """Compute the derivatives of an equilibrium.

    Args:
        system, imposed: the rod and its command, with two variants for each parameter.
        before: configuration from which it was led there; its twist angles at the ends count.
        rest: the state there.
        internal: internal variables with which the equilibrium was found.
        fresh: see `equilibrium_continuation.settle`.
        varying: derivatives before, of which the frames count; become those at rest.
    """
    q, rule, time = rest.q, system.rule, rest.clock[TIME]
    none = np.zeros((q.shape[0], 4))
    matter = material_at_rest(system, ITSELF, growth(imposed, ITSELF, time), internal)
    if fresh:
        matter = frictionless(matter)
    band, _, response, grad_s, grad_o = newton_iteration.linearise(
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
            other = material_at_rest(system, k, factor, internal)
            if fresh:
                other = frictionless(other)
            elastic = _held_forces(
                q, rest.stretch, rest.other, rule, other, grad_s, grad_o, response, spare
            )
            pull = residual(system, k, factor, still, still).ravel()
            for i in range(q.size):
                rhs[a, i] -= share * (pull[i] + elastic[i])
            if varying.moves[a] != 0.0:
                _, target, gap = targets(system, k, imposed, time, before, varying.frames[a, side])
                if q.shape[1] != PLANAR:
                    for end in range(2):
                        target[-end, 3] += align(varying.frames[a, side, end], rest.frames[end])
                add(increments[a], share, target.ravel())
                add(gaps[a], share, gap)
    _solve(system, band, rhs, increments, gaps)
    d_q = rhs.reshape((count, q.shape[0], q.shape[1]))
    start = IntegratorState(
        rest.clock, rest.q, rest.velocity, rest.acceleration, rest.auxiliary, rest.reference,
        rest.frames, rest.stretch, rest.stretch_before, rest.other, rest.other_before, internal,
    )  # fmt: skip
    unturned = np.zeros((count, rule.weight.size))
    derivatives = moment_derivatives(
        rest.other, system.stiffness.bend[0], matter.bend_rest, internal, matter.law
    )
    follow(
        system, rest, start, 0.0, matter, derivatives, varying, d_q, grad_s, grad_o, unturned,
        unturned,
    )  # fmt: skip
    if fresh and internal.anchor.shape[0] > 0:
        shifted = np.empty(q.shape)
        for a in range(count):
            d = varying.step[a]
            shift(shifted, q, d, d_q[a])
            above = rest_anchor(shifted, rule)
            shift(shifted, q, -d, d_q[a])
            central_difference(above, rest_anchor(shifted, rule), d, varying.internal.anchor[a])
    assign(varying.q, d_q)
    assign(varying.stretch_before, varying.stretch)
    assign(varying.other_before, varying.other)
