# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Where a peg may stand: beside what was seen, and in the way of what was predicted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.effects import Peg
from dlo_ros.parameters import RodParameters
from dlo_ros.spline import FloatArray, SplineBasis

RADII = (0.006, 0.012, 0.024)
"""Of pegs that are tried, from a nail to a pipe [m]; the fit finds the true one."""
TRIED = 500
"""Places in a recording."""
STATIONS = 40
MOST = 2
RESIZED = (0.7, 1.4)
"""Of its radius, that a fitted peg is tried with anew."""
TOUCHING = 20
"""Points that were seen nearest to a peg, which tell on which side of it the DLO lies."""
SLACK = 1.5e-3
"""How far an observed shape may seem to reach into a peg [m]: noise, and the spline's own error."""


def pegs(
    rod: RodParameters,
    observed: Sequence[FloatArray],
    predicted: Sequence[FloatArray],
    radius: float,
) -> list[Peg]:
    """The most likely pegs, best first.

    A peg that touches an observed shape on the side where the prediction lies, and that no observed
    shape enters, gains what the predicted shapes enter it.

    Args:
        observed, predicted: control points of each recording [m], shape (F, n, 3).
        radius: of the pegs [m].
    """
    basis = SplineBasis(rod.control_points, rod.length)
    u = np.linspace(0.08, 1.0, STATIONS) * rod.length
    values = basis.matrix(u)
    seen = [np.einsum("qn,fnc->fqc", values, o)[..., [0, 2]] for o in observed]
    expected = [np.einsum("qn,fnc->fqc", values, p)[..., [0, 2]] for p in predicted]
    seen = [s[-len(e) :] for s, e in zip(seen, expected, strict=True)]
    everywhere = np.concatenate([s.reshape(-1, 2) for s in seen])
    entering = np.concatenate([e.reshape(-1, 2) for e in expected])
    centres, gains = [], []
    away = radius + 0.5 * rod.diameter
    for s, e in zip(seen, expected, strict=True):
        along = np.gradient(s, axis=1)
        along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-12)
        across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        miss = np.sum((e - s) * across, axis=2)
        frames, places = np.nonzero(np.abs(miss) > 0.7 * np.sqrt(np.mean(miss**2)))
        every = max(1, len(frames) // TRIED)
        frames, places = frames[::every], places[::every]
        side = np.sign(miss[frames, places])[:, None]
        for centre in s[frames, places] + side * away * across[frames, places]:
            depth = away - np.sqrt(np.min(np.sum((everywhere - centre) ** 2, axis=1)))
            if depth > SLACK:
                continue
            reach = away - np.sqrt(np.sum((entering - centre) ** 2, axis=1))
            centres.append(centre)
            gains.append(float(np.sum(np.maximum(reach, 0.0))))
    found: list[Peg] = []
    for k in np.argsort(gains)[::-1]:
        apart = [np.hypot(p.x - centres[k][0], p.z - centres[k][1]) for p in found]
        if gains[k] > 0.0 and (not apart or min(apart) > 0.04 * rod.length):
            found.append(Peg(float(centres[k][0]), float(centres[k][1]), radius))
        if len(found) == MOST:
            break
    return found


def resized(peg: Peg, rod: RodParameters, observed: Sequence[FloatArray]) -> list[Peg]:
    """The same peg smaller and larger, the DLO touching it where it did.

    A fit seldom finds its way between them: only radius and place together change little.

    Args:
        observed: control points of each recording [m], shape (F, n, 3).
    """
    basis = SplineBasis(rod.control_points, rod.length)
    values = basis.matrix(np.linspace(0.0, rod.length, STATIONS))
    seen = [np.einsum("qn,fnc->fqc", values, o)[..., [0, 2]].reshape(-1, 2) for o in observed]
    apart = np.concatenate(seen) - np.array([peg.x, peg.z])
    distance = np.linalg.norm(apart, axis=1)
    nearest = np.argsort(distance)[:TOUCHING]
    side = np.mean(apart[nearest] / np.maximum(distance[nearest, None], 1e-12), axis=0)
    side /= max(float(np.linalg.norm(side)), 1e-12)
    result = []
    for factor in RESIZED:
        x, z = np.array([peg.x, peg.z]) + (1.0 - factor) * peg.radius * side
        result.append(Peg(float(x), float(z), factor * peg.radius))
    return result
