# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The missing force: the load along the DLO that would bring the model onto the measurement.

About a predicted shape the rod is a linear beam. The displacement d from prediction to observation
needs the load K d + C d' + M d''. It is sought among smooth loads, by least squares with the noise
of the measurement, so that it has an uncertainty.

A rod that is a little longer than stated, or that a camera shows a little larger, is no load: where
both ends are held only a huge pressure could stretch it to that. So there it may be longer, as far
as a set-up is off. One that hangs free shows that along itself, which is not counted.

No clamp is exactly where and as the command says, either. Only a large load beside it could bend
the rod as a clamp does that is turned by a degree. So held ends may be displaced and turned, as far
as a set-up is off, and next to them the load is as uncertain as that makes it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from dlo_ros.diagnosis.residuals.linear_beam import Beam
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import FEWEST
from dlo_ros.parameters import STANDARD_GRAVITY, Settings
from dlo_ros.spline import FloatArray

MODES = 6
"""Smooth loads along u, for each direction."""
SIZES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Standard deviations of the evenest load, of the weight per length; the likeliest is taken."""
STRAIN = 0.007
"""Standard deviation of the strain by which a DLO seems longer: half a per cent each of its length
and of the camera's scale, the tolerances of both."""
CLAMP_OFFSET, CLAMP_ANGLE = 0.005, math.radians(3.0)
"""Standard deviations of the place, of the length, and of the direction [rad] in which an end is
held: the tolerances of a clamp."""
TYPICAL = 200
"""Frames by which that is judged."""
WINDOW = 7
"""Frames over which displacements are smoothed to have their acceleration."""
ROUNDING = 1e-9


@dataclass(frozen=True)
class MissingForce:
    """Load per length.

    Args:
        force: x, y, z [N/m], shape (F, U, 3); y is 0 where a recording keeps to the plane.
        std: standard deviation of the load [N/m], shape (F, U, 3).
    """

    force: FloatArray
    std: FloatArray


def missing_force(
    recording: Recording, predicted: FloatArray, settings: Settings, u: FloatArray
) -> MissingForce | None:
    """The load that the model lacks; None for too few frames.

    Args:
        predicted: control points [m], shape (F, n, 3 or more).
        settings: parameters of the model that predicts.
        u: material coordinates of the load [m], shape (U,).
    """
    if len(predicted) < FEWEST:
        return None
    rod = settings.rod
    beam = Beam(
        settings, recording.manipulation.commands, (0, 2) if recording.planar else (0, 1, 2)
    )
    size, axes, ways = rod.linear_density * STANDARD_GRAVITY, beam.axes, len(beam.axes)
    systems = _systems(recording, predicted, beam, size)
    # A load that varies much along the DLO is less likely than an even one.
    decay = np.repeat(1.0 / (1.0 + np.arange(MODES)) ** 2, ways)
    some = systems[:: -(-len(systems) // TYPICAL)]
    loads = len(decay)
    # Strain and displaced ends are in units of their own.
    others = np.ones(systems[0][0].shape[1] - loads)
    priors = (np.concatenate([decay * scale**2, others]) for scale in SIZES)
    prior = max(priors, key=lambda v: _evidence(some, v))
    shown = _loads(u, rod.length)
    force, std = np.zeros((2, len(systems), len(u), 3))
    for f, (j, target) in enumerate(systems):
        posterior = np.linalg.inv(j.T @ j + np.diag(1.0 / prior))
        amplitude = (posterior @ (j.T @ target))[:loads]
        force[f][:, axes] = size * (shown @ amplitude.reshape(MODES, ways))
        spread = posterior[:loads, :loads].reshape(MODES, ways, MODES, ways)
        std[f][:, axes] = size * np.sqrt(np.einsum("ui,icjc,uj->uc", shown, spread, shown))
    return MissingForce(force, std)


def _systems(
    recording: Recording, predicted: FloatArray, beam: Beam, size: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Whitened linear systems: response to loads of a size [N/m], to an even strain and to ends
    that are held elsewhere, in units of their standard deviations, and the measured displacement.

    Returns:
        For each frame shapes (K, M + 1 + H) and (K,).
    """
    frames, n = predicted.shape[:2]
    axes, count = beam.axes, n * len(beam.axes)
    shapes = predicted[:, :, axes]
    step = float(np.median(np.diff(recording.times[-frames:])))
    apart = recording.observed[-frames:][:, :, axes] - shapes
    orders = [_smoothed(apart, step, order).reshape(frames, count) for order in range(3)]
    own, fine = beam.lift @ _smoothed(shapes, step, 2), beam.lift @ shapes
    points, _ = beam.basis.quadrature()
    load = size * beam.load(_loads(points, beam.seen.length))
    lift, free = np.kron(beam.lift, np.eye(len(axes))), beam.free
    strain = STRAIN if len(beam.places) > 1 else 0.0
    result = []
    for f in range(frames):
        stiff, lost = beam.stiffness(fine[f], own[f])
        ends = beam.displaced_ends(fine[f], CLAMP_OFFSET * beam.seen.length, CLAMP_ANGLE)
        causes = np.column_stack([load, strain * beam.lengthening(fine[f]), -stiff @ ends])
        forces = np.column_stack([causes, lost @ lift, beam.inertia @ lift])
        moved = np.linalg.solve(stiff[np.ix_(free, free)], forces[free])
        measured = recording.across[len(recording.times) - frames + f][:, :, axes]
        measured = measured.reshape(-1, count) / recording.noise[:, None]
        # What moves along the DLO follows from what moves across, but not linearly.
        across = np.delete(measured, np.s_[n : 2 * n], axis=0)
        seen = across @ beam.projection
        responses = seen[:, free] @ moved
        acting = causes.shape[1]
        responses[:, acting - ends.shape[1] : acting] += seen @ ends
        response, *later = np.split(responses, [acting, acting + count], axis=1)
        parts = [across, *later]
        place = f if f < WINDOW // 2 else max(WINDOW // 2, WINDOW - frames + f)
        back = np.linalg.pinv(measured)
        root = _noise([part @ back for part in parts], place, step)
        target = sum(part @ order[f] for part, order in zip(parts, orders, strict=True))
        result.append((np.linalg.solve(root, response), np.linalg.solve(root, target)))
    return result


def _loads(u: FloatArray, length: float) -> FloatArray:
    """Smooth loads along the DLO, shape (U, MODES)."""
    return np.asarray(np.polynomial.legendre.legvander(2.0 * u / length - 1.0, MODES - 1))


def _smoothed(values: FloatArray, step: float, order: int) -> FloatArray:
    """Derivative over time of smoothed values."""
    return np.asarray(savgol_filter(values, WINDOW, 3, deriv=order, delta=step, axis=0))


def _noise(parts: Sequence[FloatArray], place: int, step: float) -> FloatArray:
    """Root of the covariance of what comes of smoothed measurements, shape (K, K).

    Args:
        parts: linear maps of the measurement, its speed and its acceleration, in units of the
            measurement's noise, each of shape (K, J).
        place: index of the frame in the window over which it is smoothed.
        step: time between two frames [s].
    """
    weights = [
        savgol_coeffs(WINDOW, 3, deriv=order, delta=step, pos=place, use="dot")
        for order in range(len(parts))
    ]
    each = np.einsum("ow,okj->wkj", weights, parts)
    covariance = np.einsum("wkj,wlj->kl", each, each)
    # What clamps hold has none.
    covariance += ROUNDING * float(np.trace(covariance)) * np.eye(len(covariance))
    return np.asarray(np.linalg.cholesky(covariance))


def _evidence(systems: Sequence[tuple[FloatArray, FloatArray]], prior: FloatArray) -> float:
    """Log likelihood of all frames, with loads of this variance drawn independently in each."""
    total = 0.0
    for j, target in systems:
        spread = np.eye(len(target)) + (j * prior) @ j.T
        total -= 0.5 * float(target @ np.linalg.solve(spread, target))
        total -= 0.5 * float(np.linalg.slogdet(spread)[1])
    return total
