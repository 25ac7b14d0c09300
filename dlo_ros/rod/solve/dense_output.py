# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The motion within a step: the cubic through places and velocities at both of its ends.

Its error is of fourth order in the length of the step, that of the step of third.
"""

from __future__ import annotations

from dlo_ros.kernel_cache import njit
from dlo_ros.kernel_linking import linked


@njit(from_python=False)
def place_weights(h, share):
    """Weights of place and velocity before, and after a step of length h, at a share of it."""
    s, rest = share, 1.0 - share
    return (
        (1.0 + 2.0 * s) * rest * rest,
        h * s * rest * rest,
        s * s * (3.0 - 2.0 * s),
        -h * s * s * rest,
    )


@njit(from_python=False)
def speed_weights(h, share):
    """Weights of the same four in the velocity."""
    s, rest = share, 1.0 - share
    turn = 6.0 * s * rest / h
    return -turn, rest * (1.0 - 3.0 * s), turn, s * (3.0 * s - 2.0)


@linked()
def interpolate(q, velocity, q_new, velocity_new, h, share, out):
    """Write places when a share of a step is over; all arrays have one shape."""
    weighted(place_weights(h, share), q, velocity, q_new, velocity_new, out)


@linked()
def interpolate_speed(q, velocity, q_new, velocity_new, h, share, out):
    """Write velocities when a share of a step is over; all arrays have one shape."""
    weighted(speed_weights(h, share), q, velocity, q_new, velocity_new, out)


@linked()
def weighted(weights, q, velocity, q_new, velocity_new, out):
    """Write a weighted sum of four arrays of one shape."""
    a, b, c, d = weights
    x, v, y, w, z = q.ravel(), velocity.ravel(), q_new.ravel(), velocity_new.ravel(), out.ravel()
    for i in range(z.size):
        z[i] = a * x[i] + b * v[i] + c * y[i] + d * w[i]
