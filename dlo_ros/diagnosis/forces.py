# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The missing force: the load along the DLO that would bring the model onto the measurement.

About a predicted shape the rod is a linear beam under tension, in the published basis: bending
stiffness across (in space both ways, without what twist adds), tension, and hardly any stretch.
What was observed beyond the prediction then needs the load K d + c d' + m d'' (d: displacement). It
is looked for among smooth loads, by least squares with the noise of the measurement, so that it
comes with its uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from dlo_ros.command import END, START
from dlo_ros.diagnosis.measured import Recording
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

MODES = 6
"""Smooth loads along u, for each direction."""
SIZES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Standard deviations of the evenest load, of the weight per length; the likeliest is taken."""
STRETCH = 1e4
"""Of the stretching stiffness over B / L^2: stiff, but no cause of rounding."""
WINDOW = 7
"""Frames over which displacements are smoothed to have their acceleration."""
FEWEST = 9
"""Frames with which that is tried."""


@dataclass(frozen=True)
class MissingForce:
    """Load per length.

    Args:
        force: x, y, z [N/m], shape (F, U, 3); y is 0 where a recording keeps to the plane.
        std: its standard deviation [N/m], shape (F, U, 3).
    """

    force: FloatArray
    std: FloatArray


def missing_force(
    recording: Recording, predicted: FloatArray, settings: Settings, u: FloatArray
) -> MissingForce | None:
    """The load that the model lacks; None for too few frames.

    Args:
        predicted: control points [m], shape (F, n, 3 or more).
        settings: of the model that predicts.
        u: where the load is wanted [m], shape (U,).
    """
    frames, n = len(predicted), predicted.shape[1]
    if frames < FEWEST:
        return None
    rod = settings.rod
    basis = SplineBasis(n, rod.length)
    axes = [0, 2] if recording.across.shape[1] == 2 * n else [0, 1, 2]
    ways = len(axes)
    shapes = predicted[:, :, axes]
    apart = recording.observed[-frames:][:, :, axes] - shapes
    step = float(np.median(np.diff(recording.times[-frames:])))
    smooth, speed, pull = (
        np.asarray(savgol_filter(apart, WINDOW, 3, deriv=k, delta=step, axis=0)) for k in range(3)
    )
    own = np.asarray(savgol_filter(shapes, WINDOW, 3, deriv=2, delta=step, axis=0))
    free = np.repeat(_free(recording, n), ways)
    gravity = np.array(settings.gravity)[axes]
    points, weight = basis.quadrature()
    modes = np.polynomial.legendre.legvander(2.0 * points / rod.length - 1.0, MODES - 1)
    shown = np.polynomial.legendre.legvander(2.0 * u / rod.length - 1.0, MODES - 1)
    load = np.kron(basis.matrix(points).T @ (weight[:, None] * modes), np.eye(ways))
    inertia = rod.linear_density * basis.gram
    drag = settings.damping.air_drag * basis.gram
    # Savitzky and Golay's smoothing leaves this share of the noise's variance.
    share = 9.0 / (4.0 * WINDOW)
    size = rod.linear_density * 9.81
    # A load that varies much along the DLO is less likely than an even one.
    decay = np.repeat(1.0 / (1.0 + np.arange(MODES)) ** 2, ways)
    systems = []
    for f in range(frames):
        stiff = _stiffness(basis, settings, shapes[f], own[f], gravity)
        dynamic = (inertia @ pull[f] + drag @ speed[f]).ravel()
        inside = stiff[np.ix_(free, free)]
        rest = stiff[np.ix_(free, ~free)] @ smooth[f].ravel()[~free]
        target = smooth[f].ravel()[free] + np.linalg.solve(inside, dynamic[free] + rest)
        across = recording.across[len(recording.times) - frames + f][:, :, axes]
        white = across.reshape(len(across), -1) / (np.sqrt(share) * recording.noise[:, None])
        response = size * np.linalg.solve(inside, load[free])
        systems.append((white[:, free] @ response, white[:, free] @ target))
    prior = max((decay * scale**2 for scale in SIZES), key=lambda v: _evidence(systems, v))
    force, std = np.zeros((2, frames, len(u), 3))
    for f, (j, target) in enumerate(systems):
        posterior = np.linalg.inv(j.T @ j + np.diag(1.0 / prior))
        amplitude = posterior @ (j.T @ target)
        force[f][:, axes] = size * (shown @ amplitude.reshape(MODES, ways))
        spread = posterior.reshape(MODES, ways, MODES, ways)
        std[f][:, axes] = size * np.sqrt(np.einsum("ui,icjc,uj->uc", shown, spread, shown))
    return MissingForce(force, std)


def _evidence(systems: Sequence[tuple[FloatArray, FloatArray]], prior: FloatArray) -> float:
    """Logarithm of the likelihood of all frames, loads of this variance drawn anew in each."""
    total = 0.0
    for j, target in systems:
        spread = np.eye(len(target)) + (j * prior) @ j.T
        total -= 0.5 * float(target @ np.linalg.solve(spread, target))
        total -= 0.5 * float(np.linalg.slogdet(spread)[1])
    return total


def _free(recording: Recording, n: int) -> np.ndarray:
    """Which control points nothing imposes, shape (n,)."""
    held = np.zeros(n, dtype=np.bool_)
    for command in recording.manipulation.commands:
        for name in command.names:
            if name == START:
                held[:2] = True
            elif name == END:
                held[-2:] = True
            else:
                held[int(name.rpartition("_")[2]) - 1] = True
    return ~held


def _stiffness(
    basis: SplineBasis, settings: Settings, shape: FloatArray, acceleration: FloatArray,
    gravity: FloatArray,
) -> FloatArray:  # fmt: skip
    """Stiffness of a rod about a shape, shape (d n, d n) [N/m], coordinates interleaved.

    Args:
        shape, acceleration: control points [m], [m/s^2], shape (n, d), d 2 in the plane.
        gravity: [m/s^2], shape (d,).
    """
    rod = settings.rod
    u, weight = basis.quadrature()
    slopes, bends = basis.matrix(u, 1), basis.matrix(u, 2)
    tangent = slopes @ shape
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    b = rod.bending_stiffness
    tension = _tension(basis, settings, shape, acceleration, gravity, tangent)
    n, ways = shape.shape

    def along(rows: FloatArray, direction: FloatArray, scale: FloatArray | float) -> FloatArray:
        j = (rows[:, :, None] * direction[:, None, :]).reshape(len(u), ways * n)
        result: FloatArray = j.T @ ((weight * scale)[:, None] * j)
        return result

    stretch = STRETCH * b / rod.length**2
    # A little more than the tension that buckles would make the linear beam meaningless.
    held = np.maximum(tension, -8.0 * b / rod.length**2)
    stiff = along(slopes, tangent, stretch) + 1e-9 * stretch * np.kron(basis.gram, np.eye(ways))
    for across in _normals(tangent):
        stiff += along(bends, across, b) + along(slopes, across, held)
    return stiff


def _normals(tangent: FloatArray) -> list[FloatArray]:
    """Unit vectors across the DLO, one in the plane, two in space, each of shape (Q, d)."""
    if tangent.shape[1] == 2:
        return [np.column_stack([-tangent[:, 1], tangent[:, 0]])]
    # Away from the axis that the tangent follows least; stiffness is alike in all directions.
    axis = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
    first = np.cross(tangent, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return [first, np.cross(tangent, first)]


def _tension(
    basis: SplineBasis, settings: Settings, shape: FloatArray, acceleration: FloatArray,
    gravity: FloatArray, tangent: FloatArray,
) -> FloatArray:  # fmt: skip
    """Tension at the quadrature points [N], from weight, inertia and the slope of the moment.

    The force at u = 0 is unknown; it is that with which the shear forces fit the moments best.
    """
    rod = settings.rod
    u, weight = basis.quadrature()
    per_length = rod.linear_density * (basis.matrix(u) @ acceleration - gravity)
    inner = np.cumsum(weight[:, None] * per_length, axis=0) - 0.5 * weight[:, None] * per_length
    bend = basis.matrix(u, 2) @ shape
    bend -= np.sum(bend * tangent, axis=1, keepdims=True) * tangent
    slope = np.gradient(bend, u, axis=0)
    normals = _normals(tangent)
    rows = np.concatenate(normals)
    shear = [np.sum((-rod.bending_stiffness * slope - inner) * a, axis=1) for a in normals]
    origin, *_ = np.linalg.lstsq(rows, np.concatenate(shear), rcond=None)
    return np.asarray(np.sum((inner + origin) * tangent, axis=1))
