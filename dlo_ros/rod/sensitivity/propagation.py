# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled sensitivities of steps and of equilibria, by the factorisation of the tangent matrix.

Every parameter is given by two variants of the rod and of its command, a little above and a little
below its value. The derivatives of the equations with the shape held (`right_hand_sides`; at rest,
of an inelastic rod, differences of both variants) give that of the shape by one back-substitution,
or a few where the tangent is not symmetric (`unsymmetric_tangent`).
Strains, internal variables and the transported frame vary along, and whatever an effect does to the
rod is covered.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.boundary.conditions import align
from dlo_ros.rod.elements import rod_forces
from dlo_ros.rod.elements.contact_and_friction import rest_anchor
from dlo_ros.rod.elements.frame_derivatives import vary_frame
from dlo_ros.rod.elements.moment_derivatives import moment_derivatives
from dlo_ros.rod.elements.planar_assembly import PLANAR
from dlo_ros.rod.sensitivity.right_hand_sides import held_forces, slipping, written_out
from dlo_ros.rod.sensitivity.sensitivity_state import (
    LINEAR,
    SLIPPING,
    add,
    central_difference,
    rest_rates,
    shift,
)
from dlo_ros.rod.sensitivity.strain_sensitivity import follow
from dlo_ros.rod.sensitivity.unsymmetric_tangent import add_skew_part
from dlo_ros.rod.solve import banded_factorisation, newton_iteration
from dlo_ros.rod.solve.constraints import back_substitute, eliminate, stiffen
from dlo_ros.rod.solve.equation_system import (
    ITSELF,
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
    weights,
)
from dlo_ros.rod.solve.integrator_state import LAST, TIME, IntegratorState, assign


@linked()
def _solve(system, band, rhs, increments, gaps):
    """Solve the tangent system for the derivatives of the shape, in place of rhs (P, n d).

    Returns:
        The diagonal of its factors, which are in place of the band.
    """
    eliminate(band, system.fixed, rhs, increments)
    stiffen(band, rhs, system.pins, gaps)
    diagonal = np.empty(system.fixed.size)
    banded_factorisation.factorise(band, diagonal)
    back_substitute(band, diagonal, system.pins, gaps, rhs)
    return diagonal


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
        slipping(
            system, imposed, old, new, matter.law, derivatives, varying, grad_s, grad_o, rhs,
            increments, gaps,
        )  # fmt: skip
    else:
        written_out(
            system, imposed, old, new, 0.0, matter.law, derivatives, varying, grad_s, grad_o, rhs,
            increments, gaps,
        )  # fmt: skip
    if q.shape[1] != PLANAR:
        forces = np.zeros((count, q.size))
        vary_frame(
            q, rule, old.reference, varying.reference, new.other, response, turn, twist, forces
        )
        rhs -= forces
    diagonal = _solve(system, band, rhs, increments, gaps)
    if q.shape[1] != PLANAR:
        add_skew_part(
            system, band, diagonal, derivatives, matter.law, grad_s, grad_o, new.other, turn, twist,
            rhs,
        )  # fmt: skip
    d_q = rhs.reshape((count, q.shape[0], q.shape[1]))
    d_rest = rest_rates(system, imposed, time, varying)
    follow(
        system, new, old, h, matter, d_rest, derivatives, varying, d_q, grad_s, grad_o, turn, twist
    )
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
                elastic = held_forces(
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
    diagonal = _solve(system, band, rhs, increments, gaps)
    unturned = np.zeros((count, rule.weight.size))
    derivatives = moment_derivatives(
        rest.other, system.stiffness.bend[0], matter.bend_rest, internal, matter.law
    )
    if q.shape[1] != PLANAR:
        add_skew_part(
            system, band, diagonal, derivatives, matter.law, grad_s, grad_o, rest.other, unturned,
            unturned, rhs,
        )  # fmt: skip
    d_q = rhs.reshape((count, q.shape[0], q.shape[1]))
    start = IntegratorState(
        rest.clock, rest.q, rest.velocity, rest.acceleration, rest.auxiliary, rest.reference,
        rest.frames, rest.stretch, rest.stretch_before, rest.other, rest.other_before, internal,
    )  # fmt: skip
    follow(
        system, rest, start, 0.0, matter, rest_rates(system, imposed, time, varying), derivatives,
        varying, d_q, grad_s, grad_o, unturned, unturned,
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
