# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled search for static equilibrium under imposed motion, led along a path."""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.boundary.conditions import DIRECTOR, TANGENT
from dlo_ros.rod.elements import rod_forces
from dlo_ros.rod.elements.constitutive_law import room
from dlo_ros.rod.elements.contact_and_friction import rest_anchor
from dlo_ros.rod.elements.rod_tables import Material, Stiffness
from dlo_ros.rod.solve import newton_iteration
from dlo_ros.rod.solve.equation_system import (
    ITSELF,
    frictionless,
    growth,
    inertia_of,
    load_of,
    material_at_rest,
    targets,
)
from dlo_ros.rod.solve.generalised_alpha import (
    DONE,
    NO_CONVERGENCE,
    NO_DIRECTION,
    update_internal_variables,
)
from dlo_ros.rod.solve.integrator_state import TIME, assign

MOVE_LIMIT = 0.05  # imposed motion per increment, of L
LIGHTEST = 0.9  # share of the longest move that the lightest motion of an increment may take
TURN_LIMIT = 0.15  # imposed rotation per increment [rad]
ROUNDING = 1e-9  # share of the imposed motion that is none
CONTRAST = 10.0  # of bending stiffnesses within a DLO, to which its start is led at once
PUSH = 2e-3  # of L: how far an unstable equilibrium is left at once
ESCAPES = 4


@linked()
def _increments(system, mass, spin, q, target, gap, before, after):
    """Number of steps of the imposed motion with which the branch is not lost, and none of which
    is too long for one iteration; see `newton_iteration.longest_move`.
    """
    all_of_it = np.zeros(q.size)
    move, turn, dof = np.abs(gap).max() if gap.size else 0.0, 0.0, q.shape[1]
    for i in range(q.size):
        if system.fixed[i]:
            all_of_it[i] = target.ravel()[i] - q.ravel()[i]
            change = abs(all_of_it[i])
            if i % dof == 3:
                turn = max(turn, change)
            else:
                move = max(move, change)
    for end in range(2):
        cosine = np.dot(before[end, TANGENT:DIRECTOR], after[end, TANGENT:DIRECTOR])
        turn = max(turn, np.arccos(min(max(cosine, -1.0), 1.0)))
    lightest = newton_iteration.lightest_move(mass, spin, system.fixed, system.pins, all_of_it, gap)
    farthest = LIGHTEST * newton_iteration.FARTHEST
    steps = max(max(move / MOVE_LIMIT, lightest / farthest) / system.length, turn / TURN_LIMIT)
    return max(1, int(np.ceil(steps)))


@linked()
def _levelled(m, contrast):
    """The material without bending stiffness above `contrast` times the least.

    A shape from which a search begins may bend a rigid part, with a moment that throws the first
    steps far away, where such a part can fold between two knots.
    """
    s = m.stiffness
    bend, least = s.bend.copy(), np.inf
    for e in range(bend.shape[0]):
        least = min(least, max(bend[e, 0], bend[e, 1]))
    for e in range(bend.shape[0]):
        by = max(max(bend[e, 0], bend[e, 1]) / (contrast * least), 1.0)
        for c in range(3):  # 11, 22 and 12
            bend[e, c] /= by
    levelled = Stiffness(s.stretch, s.stretch_rest, bend, s.bend_rest, s.twist, s.twist_rest)
    return Material(
        levelled, m.damping, m.bend_rest, m.law, m.around, m.internal, m.keep, m.gain
    )  # fmt: skip


@linked()
def _raises(bend):
    """How many times `CONTRAST` is raised until the largest bending stiffness is reached."""
    least, most = np.inf, 0.0
    for e in range(bend.shape[0]):
        here = max(bend[e, 0], bend[e, 1])
        least, most = min(least, here), max(most, here)
    return max(int(np.ceil(np.log(most / least) / np.log(CONTRAST) - 1e-9)) - 1, 0)


@linked()
def settle(system, imposed, state, time, rate2, tolerance, fresh, rest):
    """Static equilibrium at a time, on the branch that leads there from a state.

    Args:
        system, imposed, state: the rod, its command, where it is.
        time: [s] from the command's start.
        rate2: see `newton_iteration.equilibrium`.
        tolerance: convergence, of L.
        fresh: whether the DLO starts there: it has come without friction, and bent but once.
        rest: output, a copy of the state that becomes the one at rest.

    Returns:
        Status, Newton iterations, the number of negative eigenvalues of the stiffness (0:
        stable), and whether an unstable equilibrium was left on the way.
    """
    factor = growth(imposed, ITSELF, time)
    usable, target, gap = targets(system, ITSELF, imposed, time, state.q, rest.frames)
    if not usable:
        return NO_DIRECTION, 0, 0, False
    q, ref, internal, rule = rest.q, state.reference, rest.internal, system.rule
    for a in range(gap.size):  # what the pins lack, each increment its share
        gap[a] -= np.dot(system.pins[a], q.ravel())
    mass, spin = inertia_of(system, ITSELF, factor, 1.0, 0.0)
    count = _increments(system, mass, spin, q, target, gap, state.frames, rest.frames)
    total, negative, buckled = 0, 0, False
    load = load_of(system, ITSELF, factor).ravel()
    matter = material_at_rest(system, ITSELF, factor, internal)
    if fresh:
        matter = frictionless(matter)
    flat, change = q.ravel(), np.zeros(q.size)
    raises = _raises(matter.stiffness.bend) if fresh else 0
    share, raised = 0.0, 0
    while share < 1.0 or raised < raises:
        part = 0.0
        if share < 1.0:
            longest = newton_iteration.longest_move(q, system.length, matter.around)
            part = longest / (newton_iteration.FARTHEST * system.length) / count
            part = part if share + part < 1.0 - ROUNDING else 1.0 - share
            share += part
        else:
            raised += 1
        for i in range(q.size):
            if system.fixed[i]:
                start = state.q.ravel()[i]
                change[i] = start + share * (target.ravel()[i] - start) - flat[i]
        now = _levelled(matter, CONTRAST ** (1 + raised)) if raised < raises else matter
        iterations, negative, ref = newton_iteration.equilibrium(
            q, change, system.fixed, system.pins, part * gap, rule, now, ref, load, mass, spin,
            rate2, system.length, tolerance,
        )  # fmt: skip
        total += abs(iterations)
        if iterations < 0 or not np.all(np.isfinite(q)):
            return NO_CONVERGENCE, total, negative, False
        for _ in range(ESCAPES):
            if negative <= 0:
                break
            buckled = True
            iterations, negative, ref = _escape(
                q, system, now, ref, load, mass, spin, rate2, tolerance
            )
            total += abs(iterations)
        if not fresh:
            _, other = rod_forces.strains(q, rule, ref)
            update_internal_variables(q, other, rule, matter, internal)
    stretch, other = rod_forces.strains(q, rule, ref)
    if fresh:
        update_internal_variables(q, other, rule, matter, internal)
        if internal.anchor.shape[0] > 0:
            assign(internal.anchor, rest_anchor(q, rule))
    rest.clock[:] = 0.0
    rest.clock[TIME] = time
    rest.velocity[:, :] = 0.0
    rest.acceleration[:, :] = 0.0
    rest.auxiliary[:, :] = 0.0
    assign(rest.stretch, stretch)
    assign(rest.stretch_before, stretch)
    assign(rest.other, other)
    assign(rest.other_before, other)
    assign(rest.reference.tangent, ref.tangent)
    assign(rest.reference.rate, ref.rate)
    assign(rest.reference.director, ref.director)
    assign(rest.reference.twist, ref.twist)
    return DONE, total, negative, buckled


@linked()
def _escape(q, system, matter, ref, load, mass, spin, rate2, tolerance):
    """Leave an unstable equilibrium, as a DLO that buckles does, and settle beside it.

    It goes along its softest motion, to the side where the energy is lower. Where nothing decides
    between the sides, it is the one to which the DLO's softest point moves along the axes.

    Returns:
        Iterations, negative eigenvalues and reference frame as `newton_iteration.equilibrium`; q is
        changed where an equilibrium was found.
    """
    mode = newton_iteration.softest(
        q, system.fixed, system.pins, system.rule, matter, ref, mass, spin, rate2
    )
    response = room(system.rule.weight.size)
    reach = PUSH * system.length
    energies = np.empty(2)
    for side in range(2):
        trial = q + (1.0 - 2.0 * side) * reach * mode
        energies[side] = rod_forces.energy_of(trial, system.rule, ref, matter, response)
        energies[side] -= np.dot(load, trial.ravel())
    sign = 1.0 if energies[0] <= energies[1] else -1.0
    if abs(energies[0] - energies[1]) < 1e-9 * max(abs(energies[0]), abs(energies[1])):
        sign = 1.0 if mode.sum() >= 0.0 else -1.0
    trial = q + sign * reach * mode
    iterations, negative, frame = newton_iteration.equilibrium(
        trial, np.zeros(q.size), system.fixed, system.pins, np.zeros(system.pins.shape[0]),
        system.rule, matter, ref, load, mass, spin, rate2, system.length, tolerance,
    )  # fmt: skip
    if iterations < 0 or not np.all(np.isfinite(trial)):
        return abs(iterations), 1, ref
    assign(q, trial)
    return iterations, negative, frame
