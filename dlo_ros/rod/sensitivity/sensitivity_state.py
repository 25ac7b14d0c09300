# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The derivatives of a moving rod in compiled code, changed in place from step to step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_arguments import whole
from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements.rod_tables import (
    ConstitutiveLaw,
    InternalVariables,
    Reference,
    Stiffness,
)
from dlo_ros.rod.solve.equation_system import growth, write_grown_bending
from dlo_ros.spline import FloatArray

LINEAR, INELASTIC, SLIPPING = 0.0, 1.0, 2.0
"""Rods that their linear numbers describe; of an inelastic material, or among other bodies, or with
a drag that grows with the square of speed; whose free length changes."""


class Rates(NamedTuple):
    """Derivatives of a rod's numbers by P parameters, named as in `System`."""

    stiffness: Stiffness
    mass: FloatArray  # (P, n, 4)
    spin: FloatArray
    drag: FloatArray
    load: FloatArray  # (P, n, d)
    relaxation_time: FloatArray  # (P,)
    law: ConstitutiveLaw  # (P,) or (P, nb)
    friction: FloatArray  # (P,)
    brake: FloatArray  # (P,)
    bodies: FloatArray  # (P,) not 0 where the parameter changes what pegs or walls do
    heavier: FloatArray  # (P,) not 0 where it changes mass or drag


class SensitivityState(NamedTuple):
    """Derivatives of the `IntegratorState` by P parameters, changed in place."""

    step: FloatArray  # (P,) half the distance of a parameter's two variants
    moves: FloatArray  # (P,) not 0 where the parameter changes what is imposed
    rates: Rates
    kind: float  # see `LINEAR`
    q: FloatArray  # (P, n, d)
    velocity: FloatArray
    acceleration: FloatArray
    auxiliary: FloatArray
    reference: Reference  # likewise with a leading axis of P
    frames: FloatArray  # (P, 2, 2, FRAME): the frames themselves, above and below
    stretch: FloatArray
    stretch_before: FloatArray
    other: FloatArray
    other_before: FloatArray
    internal: InternalVariables


@linked()
def central_difference(above, below, d, out):
    """Write (above - below) / (2 d) to out."""
    a, b, c = out.ravel(), above.ravel(), below.ravel()
    for i in range(a.size):
        a[i] = (b[i] - c[i]) / (2.0 * d)


@linked()
def shift(target, source, d, change):
    """Write source + d * change to target, arrays of one shape."""
    a, b, c = target.ravel(), source.ravel(), change.ravel()
    for i in range(a.size):
        a[i] = b[i] + d * c[i]


@linked()
def shift_state(target, state, v, a, d):
    """Write the state with d times the derivatives by parameter a added to target.

    The reference frame is left alone: see `frame_derivatives`.
    """
    shift(target.q, state.q, d, v.q[a])
    shift(target.velocity, state.velocity, d, v.velocity[a])
    shift(target.acceleration, state.acceleration, d, v.acceleration[a])
    shift(target.auxiliary, state.auxiliary, d, v.auxiliary[a])
    shift(target.stretch, state.stretch, d, v.stretch[a])
    shift(target.stretch_before, state.stretch_before, d, v.stretch_before[a])
    shift(target.other, state.other, d, v.other[a])
    shift(target.other_before, state.other_before, d, v.other_before[a])
    shift(target.internal.yield_centre, state.internal.yield_centre, d, v.internal.yield_centre[a])
    shift(target.internal.anchor, state.internal.anchor, d, v.internal.anchor[a])
    shift(target.internal.inner, state.internal.inner, d, v.internal.inner[a])


@njit(from_python=False)
def add(target, factor, source):
    """Add factor * source to target, both of shape (m,)."""
    for i in range(target.size):
        target[i] += factor * source[i]


@linked()
def grown_rates(system, varying, factor):
    """Derivatives of a rod's numbers where its free length is multiplied by a factor.

    Args:
        system: the rod, with two variants for each parameter; see `equation_system.grown`.
        varying: its derivatives.
    """
    r, u, more = varying.rates, system.uniform, factor - 1.0
    s, mass, spin = r.stiffness, r.mass.copy(), r.spin.copy()
    drag, load = r.drag.copy(), r.load.copy()
    bend, bend_rest = np.empty(s.bend.shape), np.empty(s.bend_rest.shape)
    high, low = np.empty(s.bend.shape[1:]), np.empty(s.bend.shape[1:])
    straighter, bent = np.empty(s.bend_rest.shape[1:]), np.empty(s.bend_rest.shape[1:])
    for a in range(varying.step.size):
        k, share = 1 + 2 * a, 0.5 * more / varying.step[a]
        for side, times in ((k, share), (k + 1, -share)):
            add(mass[a].ravel(), times, u.mass[side].ravel())
            add(spin[a].ravel(), times, u.spin[side].ravel())
            add(drag[a].ravel(), times, u.drag[side].ravel())
            add(load[a].ravel(), times, u.load[side].ravel())
        write_grown_bending(system, k, factor, high, bent)
        write_grown_bending(system, k + 1, factor, low, straighter)
        central_difference(high, low, varying.step[a], bend[a])
        central_difference(bent, straighter, varying.step[a], bend_rest[a])
    stiffness = Stiffness(
        s.stretch / factor, factor * s.stretch_rest, bend, bend_rest, s.twist / factor,
        factor * s.twist_rest,
    )  # fmt: skip
    return Rates(
        stiffness,
        mass,
        spin,
        drag,
        load,
        r.relaxation_time,
        r.law,
        r.friction,
        r.brake,
        r.bodies,
        r.heavier,
    )


@linked()
def rest_rates(system, imposed, time, varying):
    """Derivatives of the rest curvature at a time, of a DLO that may slip, shape (P, nb, 2)."""
    result = varying.rates.stiffness.bend_rest.copy()
    if varying.kind == SLIPPING:
        for a in range(varying.step.size):
            for side in range(2):
                k = 1 + 2 * a + side
                share = (0.5 - side) / varying.step[a] * (1.0 / growth(imposed, k, time) - 1.0)
                for e in range(result.shape[1]):
                    result[a, e, 0] += share * system.uniform.kink[k, e]
    return result


@linked()
def with_rates(v, rates):
    """The derivatives of the same state, with others of the rod's numbers."""
    return SensitivityState(
        v.step, v.moves, whole(rates), v.kind, v.q, v.velocity, v.acceleration, v.auxiliary,
        v.reference, v.frames, v.stretch, v.stretch_before, v.other, v.other_before, v.internal,
    )  # fmt: skip
