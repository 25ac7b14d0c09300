# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Newton's method on the potential of the discrete elastic rod in space."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, eig_banded, solveh_banded

from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.spatial_energy import Frames, SpatialPotential, evaluate, moved
from dlo_ros.synthesis.spatial_rod_kernels import DOF

MOST_ITERATIONS = 100  # of Newton's method in a step
TRIES = 12  # of a line search
STEP_LEFT = 1e-8  # [m], [rad] a Newton step after which the next would mean nothing
GYRATION = 0.1  # of the length: a spin counts as this displacement where one must be limited


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
    kinked = p.softening is not None or p.contact.active or p.drag is not None
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
        if kinked and largest > STEP_LEFT:
            # Where a law bends sharply the full step may go too far: the slope along the
            # direction must not come out of it steeper than half of what it was, upwards.
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
