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

from dlo_ros.kernel_cache import njit
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
def _stresses(system, old, new, varying):
    """Derivatives of the stresses by P parameters, strains held: shapes (P, nb) and (P, nb, 3)."""
    h, base, more = new.clock[LAST], system.stiffness, varying.rates.stiffness
    t_r, d_t = system.relaxation_time[0], varying.rates.relaxation_time
    c0, c1, c2 = strain_rate_weights(h, old.clock[LAST])
    stretch, bend, twist = base.stretch[0], base.bend[0], base.twist[0]
    d_stretch, d_bend, d_twist = more.stretch, more.bend, more.twist
    d_stretch_rest, d_bend_rest, d_twist_rest = more.stretch_rest, more.bend_rest, more.twist_rest
    ago_s, earlier_s = varying.stretch, varying.stretch_before
    ago_o, earlier_o = varying.other, varying.other_before
    count, nb = ago_s.shape
    rate_s, strain_s, rate_o, strain_o = (
        np.empty(nb), np.empty(nb), np.empty((nb, 3)), np.empty((nb, 3)),
    )  # fmt: skip
    for e in range(nb):
        rate_s[e] = c0 * new.stretch[e] + c1 * old.stretch[e] + c2 * old.stretch_before[e]
        strain_s[e] = new.stretch[e] - base.stretch_rest[0, e] + t_r * rate_s[e]
        for c in range(3):
            rest = base.bend_rest[0, e, c] if c < 2 else base.twist_rest[0, e]
            rate_o[e, c] = c0 * new.other[e, c] + c1 * old.other[e, c] + c2 * old.other_before[e, c]
            strain_o[e, c] = new.other[e, c] - rest + t_r * rate_o[e, c]
    coupled = _any(bend[:, 2]) or _any(d_bend[:, :, 2])
    stress_s, stress_o = np.empty((count, nb)), np.empty((count, nb, 3))
    past, faster = t_r * c1, t_r * c2
    for a in range(count):
        slower = d_t[a]
        for e in range(nb):
            stress_s[a, e] = d_stretch[a, e] * strain_s[e] + stretch[e] * (
                slower * rate_s[e] + past * ago_s[a, e] + faster * earlier_s[a, e]
                - d_stretch_rest[a, e]
            )  # fmt: skip
            x1, x2, x3 = (
                slower * rate_o[e, 0] + past * ago_o[a, e, 0] + faster * earlier_o[a, e, 0]
                - d_bend_rest[a, e, 0],
                slower * rate_o[e, 1] + past * ago_o[a, e, 1] + faster * earlier_o[a, e, 1]
                - d_bend_rest[a, e, 1],
                slower * rate_o[e, 2] + past * ago_o[a, e, 2] + faster * earlier_o[a, e, 2]
                - d_twist_rest[a, e],
            )  # fmt: skip
            stress_o[a, e, 0] = d_bend[a, e, 0] * strain_o[e, 0] + bend[e, 0] * x1
            stress_o[a, e, 1] = d_bend[a, e, 1] * strain_o[e, 1] + bend[e, 1] * x2
            stress_o[a, e, 2] = d_twist[a, e] * strain_o[e, 2] + twist[e] * x3
            if coupled:  # each curvature by the moment about the other director
                stress_o[a, e, 1] += d_bend[a, e, 2] * strain_o[e, 0] + bend[e, 2] * x1
                stress_o[a, e, 0] += d_bend[a, e, 2] * strain_o[e, 1] + bend[e, 2] * x2
    return stress_s, stress_o


@linked()
def _stresses_at_rest(system, rest, more):
    """Derivatives of the stresses of a linear rod at rest, strains held; see `_stresses`.

    Args:
        rest: its state.
        more: derivatives of its stiffness and rest strains by P parameters.
    """
    base = system.stiffness
    count, nb = more.stretch.shape
    stress_s, stress_o = np.empty((count, nb)), np.empty((count, nb, 3))
    for a in range(count):
        for e in range(nb):
            x = rest.stretch[e] - base.stretch_rest[0, e]
            stress_s[a, e] = more.stretch[a, e] * x
            stress_s[a, e] -= base.stretch[0, e] * more.stretch_rest[a, e]
            x = rest.other[e, 2] - base.twist_rest[0, e]
            stress_o[a, e, 2] = more.twist[a, e] * x - base.twist[0, e] * more.twist_rest[a, e]
            for c in range(2):
                total = 0.0
                for d in range(2):  # each curvature by the moment about the other director, too
                    at = c if c == d else 2
                    x = rest.other[e, d] - base.bend_rest[0, e, d]
                    total += more.bend[a, e, at] * x
                    total -= base.bend[0, e, at] * more.bend_rest[a, e, d]
                stress_o[a, e, c] = total
    return stress_s, stress_o


@njit(from_python=False)
def _any(x):
    """Whether a number is not 0."""
    found = False
    for value in x.flat:
        found = found or value != 0.0
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
        if _any(mass[a]) or _any(spin[a]) or _any(drag[a]):
            add_inertia_and_drag(mass[a], spin[a], drag[a], acceleration, velocity, -1.0, out)


@linked()
def _add_imposed(system, imposed, old, time, varying, increments, gaps):
    """Add the derivatives of what is imposed to increments (P, n d) and to gaps (P, m)."""
    q, moves, lengths, changes, frames = (
        old.q, varying.moves, varying.step, varying.q, varying.frames,
    )  # fmt: skip
    before = q.copy()
    for a in range(moves.size):
        if moves[a] == 0.0:
            continue
        for side in range(2):
            d = lengths[a] if side == 0 else -lengths[a]
            shift(before, q, d, changes[a])
            _, target, gap = targets(
                system, 1 + 2 * a + side, imposed, time, before, frames[a, side]
            )
            add(increments[a], 0.5 / d, target.ravel())
            add(gaps[a], 0.5 / d, gap)


@linked()
def _written_out(
    system, imposed, old, new, law, derivatives, varying, grad_s, grad_o, rhs, increments, gaps
):
    """Right-hand sides of the derivatives of a step, from those of the rod's numbers.

    Each part is computed for all parameters in one call: to hand the rod's tables over takes longer
    than the work on one parameter.
    """
    h, rates = new.clock[LAST], varying.rates
    stress_s, stress_o = _stresses(system, old, new, varying)
    if varying.kind != LINEAR:
        add_law_stresses(
            system.stiffness, rates.stiffness, law, rates.law, old.internal.inner,
            varying.internal, new.other, derivatives, h, stress_o,
        )  # fmt: skip
        add_surroundings_forces(system, old, new, h, varying, rhs)
    rhs -= rod_forces.stress_forces(system.rule, grad_s, grad_o, stress_s, stress_o)
    _add_inertia(system, new, varying, rhs)
    _add_imposed(system, imposed, old, new.clock[TIME], varying, increments, gaps)


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


@linked()
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
    written_out = varying.kind == LINEAR
    if written_out:
        stress_s, stress_o = _stresses_at_rest(system, rest, varying.rates.stiffness)
        rhs -= rod_forces.stress_forces(rule, grad_s, grad_o, stress_s, stress_o)
        for a in range(count):
            add(rhs[a], 1.0, varying.rates.load[a].ravel())
    for a in range(count):
        for side in range(2):
            k = 1 + 2 * a + side
            share = 0.5 / (varying.step[a] if side == 0 else -varying.step[a])
            if not written_out:
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
