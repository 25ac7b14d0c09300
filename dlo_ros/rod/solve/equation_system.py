# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The rod's numbers in compiled code, and their use in its equations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_arguments import whole
from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.boundary.conditions import Imposed, impose
from dlo_ros.rod.elements.drag_springs import no_springs
from dlo_ros.rod.elements.planar_assembly import PLANAR
from dlo_ros.rod.elements.rod_tables import (
    ConstitutiveLaw,
    Material,
    Quadrature,
    Stiffness,
    Surroundings,
)
from dlo_ros.rod.solve.constraints import pin_gap
from dlo_ros.spline import FloatArray

ITSELF = np.int64(0)  # number of the variant that is the rod itself
# (a plain 0 would have everything compiled once more, for that constant)


class Uniform(NamedTuple):
    """Terms that change with the free length where the DLO slips through a grip; d is 4 or 2.

    The first four grow with it. The angle by which a grip gives or a kink is bent stays, so that
    its curvature shrinks.
    """

    mass: FloatArray  # (V, n, 4) band
    spin: FloatArray  # (V, n, 4) band
    drag: FloatArray  # (V, n, 4) band
    load: FloatArray  # (V, n, d) [N]
    hinge: FloatArray  # (V, nb) compliance of the grips, in that of `Stiffness.bend` [1/(N m^2)]
    kink: FloatArray  # (V, nb) rest curvature of kinks, in `Stiffness.bend_rest` [1/m]


class System(NamedTuple):
    """The rod's numbers for compiled code, in V variants; the first is the rod itself.

    Two more for each parameter by which sensitivities are wanted have it a little above and a
    little below its value.
    """

    rule: Quadrature
    stiffness: Stiffness  # arrays with a leading axis of V
    law: ConstitutiveLaw  # arrays of shape (V,) or (V, nb)
    around: Surroundings  # numbers as arrays of shape (V,), pegs (V, k, 3)
    mass: FloatArray  # (V, n, 4) band
    spin: FloatArray  # (V, n, 4) band
    drag: FloatArray  # (V, n, 4) band
    load: FloatArray  # (V, n, d) all dead loads [N]
    uniform: Uniform
    relaxation_time: FloatArray  # (V,) [s]
    reach: FloatArray  # (V,) [m]
    fixed: FloatArray  # (n d,) which degrees of freedom are held
    pins: FloatArray  # (m, n d) rows of pinned coordinates in the free ones
    pin_rows: FloatArray  # (m, n d) the same in all of them
    length: float  # [m]


@njit(from_python=False)
def variant(imposed, k):
    """Variant k of an imposed motion."""
    return Imposed(
        imposed.times[k], imposed.positions[k], imposed.rotations[k], imposed.velocities[k],
        imposed.kinds, imposed.gain[k], imposed.slip_step[k],
    )  # fmt: skip


@linked()
def growth(imposed, k, time):
    """Free length at a time over that of the system.

    Material slips in along with the motion, and by a smooth step.
    """
    gain, times, step = imposed.gain[k], imposed.times[k], imposed.slip_step[k]
    s = min(max((time - step[1]) / step[2], 0.0), 1.0)
    now = 1.0 + step[0] * s * s * (3.0 - 2.0 * s)
    after = np.searchsorted(times, time, side="right")
    if after == 0 or after == times.size:
        return now + gain[max(after - 1, 0)]
    s = (time - times[after - 1]) / (times[after] - times[after - 1])
    return now + gain[after - 1] + s * (gain[after] - gain[after - 1])


@njit(from_python=False)
def write_grown_bending(system, k, factor, bend, bend_rest):
    """Write the bending of variant k with its free length multiplied by a factor.

    With w the grips' part of the compliance 1 / K it is 1 / K' = (1 / K - w) / factor
    + w / factor^2; both directions of bending may be coupled.

    Args:
        bend: bending stiffness, output, shape (nb, 3).
        bend_rest: rest curvature, output, shape (nb, 2).
    """
    s, u, less = system.stiffness, system.uniform, 1.0 / factor - 1.0
    for e in range(bend.shape[0]):
        one, two, both = s.bend[k, e, 0], s.bend[k, e, 1], s.bend[k, e, 2]
        softer = less * u.hinge[k, e]
        product = one * two - both * both
        share = factor / (1.0 + softer * (one + two + softer * product))
        bend[e, 0], bend[e, 1] = share * (one + softer * product), share * (two + softer * product)
        bend[e, 2] = share * both
        bend_rest[e, 0] = s.bend_rest[k, e, 0] + less * u.kink[k, e]
        bend_rest[e, 1] = s.bend_rest[k, e, 1]


@linked()
def grown(system, factor):
    """The rod itself, without its variants, with its free length multiplied by a factor.

    Laws and surroundings stay as they are; see `material_at_rest`.
    """
    s, u, more = system.stiffness, system.uniform, factor - 1.0
    bend, bend_rest = 1.0 * s.bend[:1], 1.0 * s.bend_rest[:1]
    write_grown_bending(system, ITSELF, factor, bend[0], bend_rest[0])
    stiffness = Stiffness(
        s.stretch[:1] / factor, factor * (1.0 + s.stretch_rest[:1]) - 1.0, bend, bend_rest,
        s.twist[:1] / factor, factor * s.twist_rest[:1],
    )  # fmt: skip
    return System(
        system.rule, stiffness, system.law, system.around, system.mass[:1] + more * u.mass[:1],
        system.spin[:1] + more * u.spin[:1], system.drag[:1] + more * u.drag[:1],
        system.load[:1] + more * u.load[:1], u, system.relaxation_time, system.reach, system.fixed,
        system.pins, system.pin_rows, system.length,
    )  # fmt: skip


@linked()
def material_at_rest(system, k, factor, internal):
    """The material of variant k at rest, its free length multiplied by a factor.

    There is no damping, and what may relax has done so.
    Over the same material coordinate curvature is a property of the shape; stretch and twist count
    per unit of the new length, see `write_grown_bending` for grips that give and kinks.
    """
    s, nb = system.stiffness, system.rule.weight.size
    stiffness = Stiffness(
        np.empty(nb), np.empty(nb), np.empty((nb, 3)), np.empty((nb, 2)), np.empty(nb),
        np.empty(nb),
    )  # fmt: skip
    law, a = system.law, system.around
    left = 1.0 - law.relaxing[k]
    write_grown_bending(system, k, factor, stiffness.bend, stiffness.bend_rest)
    rest = stiffness.bend_rest.copy()
    for e in range(nb):
        stiffness.stretch[e] = s.stretch[k, e] / factor
        stiffness.stretch_rest[e] = factor * (1.0 + s.stretch_rest[k, e]) - 1.0
        for c in range(3):
            stiffness.bend[e, c] *= left
        stiffness.twist[e] = s.twist[k, e] / factor
        stiffness.twist_rest[e] = factor * s.twist_rest[k, e]
    return Material(
        stiffness, left, rest,
        ConstitutiveLaw(
            law.active[k], law.half_curvature[k], law.yield_curvature[k], law.hardening[k],
            law.relaxing[k], law.lasting[k], law.slide[k], law.turn[k],
        ),
        Surroundings(
            a.friction[k], a.creep[k], a.pegs[k], a.contact[k], a.span, a.b, a.weight, a.walls[k],
            a.brake[k], no_springs(),
        ),
        whole(internal), 0.0, 0.0,
    )  # fmt: skip


@linked()
def frictionless(m):
    """The material without friction, inner or outer, which a DLO at its start has not felt yet."""
    a, w = m.around, m.law
    law = ConstitutiveLaw(
        w.active, w.half_curvature, w.yield_curvature, w.hardening, w.relaxing, w.lasting, 0.0,
        np.full(w.turn.size, np.inf),
    )  # fmt: skip
    around = Surroundings(
        0.0, a.creep, a.pegs, a.contact, a.span, a.b, a.weight, a.walls, a.brake, a.tow
    )
    return Material(m.stiffness, m.damping, m.bend_rest, law, around, m.internal, 0.0, 0.0)


@linked()
def unhindered(m):
    """The material as a linear elastic one that touches nothing."""
    a, none = m.around, np.zeros((0, 3))
    around = Surroundings(0.0, a.creep, none, 0.0, a.span, a.b, a.weight, none, 0.0, no_springs())
    w = m.law
    law = ConstitutiveLaw(0.0, w.half_curvature, w.yield_curvature, 0.0, 0.0, 1.0, 0.0, w.turn)
    return Material(m.stiffness, m.damping, m.bend_rest, law, around, m.internal, 0.0, 0.0)


@njit(from_python=False)
def relaxation(law, h):
    """Relaxation in a step of length h, `Material.keep` and `gain`; 0 where there is none.

    The moment of the part that relaxes is exact for a curvature that changes steadily over the
    step.
    """
    if law.relaxing == 0.0 or h == 0.0:
        return 0.0, 0.0
    keep = np.exp(-h / law.lasting)
    return keep, law.relaxing * (1.0 - keep) * law.lasting / h


@linked()
def with_quadratic_drag(m, tow):
    """The material with the quadratic drag of one step, see `drag_springs.drag_springs`."""
    a = m.around
    around = Surroundings(
        a.friction, a.creep, a.pegs, a.contact, a.span, a.b, a.weight, a.walls, a.brake,
        whole(tow),
    )  # fmt: skip
    return Material(
        m.stiffness, m.damping, m.bend_rest, m.law, around, m.internal, m.keep, m.gain
    )  # fmt: skip


@linked()
def inertia_of(system, k, factor, c_mass, c_drag):
    """c_mass times mass plus c_drag times drag, for positions and theta: lower bands (n, 4)."""
    more, u = factor - 1.0, system.uniform
    n = system.mass.shape[1]
    positions, theta = np.empty((n, 4)), np.empty((n, 4))
    for i in range(n):
        for j in range(4):
            mass = system.mass[k, i, j] + more * u.mass[k, i, j]
            drag = system.drag[k, i, j] + more * u.drag[k, i, j]
            positions[i, j] = c_mass * mass + c_drag * drag
            theta[i, j] = c_mass * (system.spin[k, i, j] + more * u.spin[k, i, j])
    return positions, theta


@linked()
def load_of(system, k, factor):
    """All dead loads of variant k [N], shape (n, d)."""
    result = system.load[k].copy()
    if factor != 1.0:
        for i in range(result.shape[0]):
            for c in range(result.shape[1]):
                result[i, c] += (factor - 1.0) * system.uniform.load[k, i, c]
    return result


@njit(from_python=False)
def _add_in_plane(mass, drag, acceleration, velocity, factor, out):
    """`add_inertia_and_drag` with x and z only."""
    for i in range(out.shape[0]):
        x, z = 0.0, 0.0
        for j in range(max(0, i - 3), i + 1):
            m, viscous = factor * mass[i, 3 - i + j], factor * drag[i, 3 - i + j]
            x += m * acceleration[j, 0] + viscous * velocity[j, 0]
            z += m * acceleration[j, 1] + viscous * velocity[j, 1]
            if j < i:
                out[j, 0] += m * acceleration[i, 0] + viscous * velocity[i, 0]
                out[j, 1] += m * acceleration[i, 1] + viscous * velocity[i, 1]
        out[i, 0] += x
        out[i, 1] += z


@linked()
def add_inertia_and_drag(mass, spin, drag, acceleration, velocity, factor, out):
    """Add factor times (mass times acceleration plus drag times velocity) to out (n, d).

    Args:
        mass, spin, drag: basis matrices, lower bands (n, 4); spin is that of theta, which has no
            drag.
    """
    dof = out.shape[1]
    if dof == PLANAR:
        _add_in_plane(mass, drag, acceleration, velocity, factor, out)
        return
    for i in range(out.shape[0]):
        for j in range(max(0, i - 3), i + 1):
            m, viscous = factor * mass[i, 3 - i + j], factor * drag[i, 3 - i + j]
            for c in range(min(dof, 3)):
                out[i, c] += m * acceleration[j, c] + viscous * velocity[j, c]
                if j < i:
                    out[j, c] += m * acceleration[i, c] + viscous * velocity[i, c]
            if dof == 4:
                m = factor * spin[i, 3 - i + j]
                out[i, 3] += m * acceleration[j, 3]
                if j < i:
                    out[j, 3] += m * acceleration[i, 3]


@linked()
def residual(system, k, factor, velocity, acceleration):
    """Inertia and drag less the dead loads of variant k [N], shape (n, d)."""
    result, more, u = load_of(system, k, factor), factor - 1.0, system.uniform
    for i in range(result.shape[0]):
        for c in range(result.shape[1]):
            result[i, c] = -result[i, c]
    add_inertia_and_drag(
        system.mass[k], system.spin[k], system.drag[k], acceleration, velocity, 1.0, result
    )
    if more != 0.0:
        add_inertia_and_drag(u.mass[k], u.spin[k], u.drag[k], acceleration, velocity, more, result)
    return result


@linked()
def targets(system, k, imposed, time, q, frames):
    """Imposed values of variant k at a time, for a rod that is at q now.

    Returns:
        Whether they are usable, the values (n, d), and what the pins must give (m,).
    """
    target, theta, dof = np.zeros(q.shape), np.zeros(2), q.shape[1]
    if dof == 4:
        theta[0], theta[1] = q[0, 3], q[-1, 3]
    pinned = np.empty((system.pins.shape[0] // (2 if dof == 2 else 3), 3))
    reach = system.reach[k] * growth(imposed, k, time)
    usable = impose(variant(imposed, k), time, theta, reach, frames, target, pinned)
    return usable, target, pin_gap(system.fixed, system.pins, system.pin_rows, target, pinned)
