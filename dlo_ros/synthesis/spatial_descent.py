# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Newton's method on the potential of the discrete elastic rod in space, and ways to rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import LinAlgError, eig_banded, solveh_banded

from dlo_ros.errors import SimulationError
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.spatial_energy import Frames, SpatialPotential, evaluate, moved
from dlo_ros.synthesis.spatial_rod import SpatialRod
from dlo_ros.synthesis.spatial_rod_kernels import DOF

MOST_ITERATIONS = 100  # of Newton's method in a step
TRIES = 12  # of a line search
STEP_LEFT = 1e-8  # [m], [rad] a Newton step after which the next would mean nothing
GYRATION = 0.1  # of the length: a spin counts as this displacement where one must be limited
MOST_STEPS = 4000  # on the way to an equilibrium
SHORTEST = 1e-9  # [s] of pseudo time, below which nothing goes downhill any more
RESTING = 1e-9  # [m] of a step that means nothing any more
NEWTON = 1e3  # [s] of pseudo time, above which a step is one of Newton's method
PUSHES = 3  # off unstable equilibria
MOST_TURNS = 60  # of a rod or its end, until the first shape is free of twist
UNTWISTED = 1e-9  # [rad] of twist that may be left at the start


def largest_of(change: FloatArray, length: float) -> float:
    """The largest displacement of a change [m], spins by `GYRATION`."""
    by = np.abs(change.reshape(-1, DOF))
    return float(max(by[:, :3].max(), GYRATION * length * by[:, 3].max()))


def newton_direction(
    gradient: FloatArray, band: FloatArray, shift: FloatArray
) -> FloatArray | None:
    """Newton's direction with a shift of the Hessian's diagonal; None where it is not definite."""
    shifted = band.copy()
    shifted[0] += shift
    try:
        return np.asarray(solveh_banded(shifted, -gradient, lower=True, check_finite=False))
    except LinAlgError:
        return None


def way_out(band: FloatArray, length: float) -> FloatArray | None:
    """The way out of an unstable equilibrium, 1 m at most; None where the Hessian is definite."""
    lowest, mode = eig_banded(band, lower=True, select="i", select_range=(0, 0))
    if not lowest[0] < 0.0:
        return None
    way = mode[:, 0] * np.sign(mode[np.argmax(np.abs(mode[:, 0])), 0])  # the same in every run
    return np.asarray(way / largest_of(way, length))


def minimise(
    shape: Frames, spin: FloatArray, p: SpatialPotential
) -> tuple[Frames | None, FloatArray]:
    """Newton's method for one implicit step; no shape where it did not converge."""
    length = float(np.sum(p.lengths))
    limit = 0.5 * float(np.min(p.lengths))
    stiffest = np.repeat(p.spring[0][:, None], DOF, axis=1)
    stiffest[:, 3] *= (GYRATION * length) ** 2
    share = 0.0
    known = None
    for _ in range(MOST_ITERATIONS):
        _, gradient, band = evaluate(shape, spin, p) if known is None else known
        known = None
        change = newton_direction(gradient, band, share * stiffest.ravel())
        if change is None:
            share = max(4.0 * share, 1.0)
            continue
        largest = largest_of(change, length)
        scale = min(1.0, limit / max(largest, 1e-300))
        after, turned = moved(shape, scale * change), spin + scale * change[3:-1:DOF]
        if largest > STEP_LEFT:
            # Where a law bends sharply, or a rigid part turns, the full step may go too far: the
            # slope along the direction must not come out of it steeper than half of what it was,
            # upwards.
            slope = float(gradient @ change)
            for _ in range(TRIES):
                known = evaluate(after, turned, p)
                then = float(known[1] @ change)
                if then <= -0.5 * slope:
                    break
                scale *= min(max(slope / (slope - then), 0.1), 0.9)
                after, turned = moved(shape, scale * change), spin + scale * change[3:-1:DOF]
        shape, spin = after, turned
        if largest <= STEP_LEFT and share == 0.0:
            return shape, spin
        share = 0.0 if share < 1e-3 else 0.1 * share
    return None, spin


def fallen(shape: Frames, p: SpatialPotential, rod: SpatialRod) -> Frames:
    """The stable equilibrium downhill from a shape: steps of growing pseudo time, at last Newton's.

    Raises:
        SimulationError: none was reached.
    """
    none, mass = np.zeros(len(rod.lengths)), _inertia(rod)
    rounding = 1e-12 * float(np.sum(np.abs(rod.weight))) * rod.u[-1] + 1e-16
    limit, h = 0.2 * float(np.min(rod.lengths)), 1e-3
    value, gradient, band = evaluate(shape, none, p)
    pushes, largest = 0, np.inf
    for _ in range(MOST_STEPS):
        change = newton_direction(gradient, band, mass / h**2)
        if change is None and largest < RESTING and pushes < PUSHES:
            # It rests where it is unstable: no way leads downhill without a push.
            push = way_out(band, rod.u[-1])
            if push is not None:
                shape, h, pushes = moved(shape, limit * push), 1e-3, pushes + 1
                value, gradient, band = evaluate(shape, none, p)
                continue
        if change is not None:
            largest = largest_of(change, rod.u[-1])
            trial = moved(shape, change * (limit / max(largest, limit)))
            after, slope, stiff = evaluate(trial, none, p)
            if after <= value + rounding + 1e-12 * abs(value):
                shape, value, gradient, band = trial, after, slope, stiff
                if h > NEWTON and largest < RESTING:
                    return shape
                h = min(1.6 * h, 10.0 * NEWTON)
                continue
        h *= 0.3
        if h < SHORTEST:
            break
    raise SimulationError(
        "the rope found no stable equilibrium from its initial shape; give a shape that sags"
    )


def turn_until_none_is_left(left: Callable[[], float], turn: Callable[[float], None]) -> None:
    """Turn something by what is left of an angle until nothing is.

    What is turned swings where it rests then, perhaps as far to the other side: it is turned by
    half as much then.

    Args:
        left: function that returns what is left [rad].
        turn: function that turns it by an angle [rad].

    Raises:
        SimulationError: something is left in the end.
    """
    share, before = 1.0, 0.0
    for _ in range(MOST_TURNS):
        angle = left()
        if abs(angle) < UNTWISTED:
            return
        if angle * before < 0.0 and abs(angle) > 0.5 * abs(before):
            share *= 0.5
        before = angle
        turn(share * angle)
    raise SimulationError("the rope finds no shape at rest that is free of twist; move its ends")


def _inertia(rod: SpatialRod) -> FloatArray:
    """Pseudo inertia of each degree of freedom on the way to an equilibrium, shape (4 (N + 1),)."""
    result = np.repeat(rod.mass[:, None], DOF, axis=1)
    result[:, 3] *= (GYRATION * rod.u[-1]) ** 2
    return result.ravel()
