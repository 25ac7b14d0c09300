# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled interpolation of an imposed trajectory: linear or cubic Hermite, rotations by slerp."""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked


@linked(from_python=True)
def sample(times, positions, rotations, velocities, time, position, rotation):
    """Values of a trajectory at a time; before the first point and after the last they hold.

    Args:
        times: [s], growing, shape (T,).
        positions: [m], shape (T, K, 3).
        rotations: quaternions x y z w, shape (T, K, 4).
        velocities: [m/s], shape (T, K, 3), NaN where a point carries none.
        time: [s].
        position, rotation: outputs, shape (K, 3) and (K, 4); rotations of unit norm, identity
            where they have none.
    """
    after = np.searchsorted(times, time, side="right")
    if after == 0 or after == times.size:
        at = max(after - 1, 0)
        for k in range(position.shape[0]):
            for c in range(3):
                position[k, c] = positions[at, k, c]
            for c in range(4):
                rotation[k, c] = rotations[at, k, c]
    else:
        a, b = after - 1, after
        h = times[b] - times[a]
        s = (time - times[a]) / h
        for k in range(position.shape[0]):
            smooth = True
            for c in range(3):
                smooth = smooth and np.isfinite(velocities[a, k, c] + velocities[b, k, c])
            for c in range(3):
                p0, p1 = positions[a, k, c], positions[b, k, c]
                if smooth:
                    position[k, c] = (
                        (1 + 2 * s) * (1 - s) ** 2 * p0
                        + s * (1 - s) ** 2 * h * velocities[a, k, c]
                        + s * s * (3 - 2 * s) * p1
                        + s * s * (s - 1) * h * velocities[b, k, c]
                    )
                else:
                    position[k, c] = p0 + s * (p1 - p0)
            _slerp(rotations[a, k], rotations[b, k], s, rotation[k])
    for k in range(position.shape[0]):
        _normalise(rotation[k])


@linked(from_python=True)
def sample_positions(times, positions, rotations, velocities, instants, result):
    """Positions of a trajectory at several times; see `sample`.

    Args:
        instants: [s], shape (S,).
        result: output, shape (S, K, 3).
    """
    rotation = np.empty((result.shape[1], 4))
    for k in range(instants.size):
        sample(times, positions, rotations, velocities, instants[k], result[k], rotation)


@linked()
def _slerp(a, b, s, out):
    """Spherical interpolation the short way round."""
    dot, size_a, size_b = 0.0, 0.0, 0.0
    for i in range(4):
        dot += a[i] * b[i]
        size_a += a[i] * a[i]
        size_b += b[i] * b[i]
    size_a, size_b = np.sqrt(size_a), np.sqrt(size_b)
    if size_a * size_b < 1e-18:  # no rotation at all
        out[0], out[1], out[2], out[3] = 0.0, 0.0, 0.0, 1.0
        return
    dot /= size_a * size_b
    sign = -1.0 if dot < 0.0 else 1.0
    angle = np.arccos(min(abs(dot), 1.0))
    if angle < 1e-6:
        wa, wb = 1.0 - s, s
    else:
        wa, wb = np.sin((1.0 - s) * angle) / np.sin(angle), np.sin(s * angle) / np.sin(angle)
    for i in range(4):
        out[i] = wa * a[i] / size_a + sign * wb * b[i] / size_b


@linked()
def _normalise(q):
    norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if norm > 1e-9 and np.isfinite(norm):
        for i in range(4):
            q[i] /= norm
    else:
        q[0], q[1], q[2], q[3] = 0.0, 0.0, 0.0, 1.0
