# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The plain model's fit, the noise of the recordings, and a resolution finer than that noise."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.errors import SimulationError
from dlo_ros.identification.estimate import FINEST, NOISE_SHARE
from dlo_ros.identification.material_model import material_model
from dlo_ros.identification.offline.drafts import (
    DRAFT_SPANS,
    DRAFT_TOLERANCE,
    LONGEST,
    SPACE_FACTOR,
    SPACE_ROUNDS,
    TIME_FACTOR,
    TIME_ROUNDS,
    drafts_error,
    shortened,
)
from dlo_ros.identification.offline.without_own_error import STEP_SHORTER, refined
from dlo_ros.identification.residual_noise import apart, rms, whitened, with_noise
from dlo_ros.inference.forecast import Manipulation, as_started, forecast
from dlo_ros.inference.joint import Evaluation, Simulated, evaluate, simulate
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.losses import WhiteLoss
from dlo_ros.inference.measured import Recording, leaves_plane, measured
from dlo_ros.inference.outlier_pictures import without_gross
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.thresholds import IMMATERIAL, MUCH_LARGER
from dlo_ros.parameters import Settings
from dlo_ros.spline import DEGREE, FloatArray

LOG = logging.getLogger(__name__)

FACTORS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Multiples of E from which the fit may start: far away a shape may lie on another branch."""
VALLEYS = 3
VALLEY_ITERATIONS = 6
"""Largest number of these starts that are fitted, until a residual is not much larger than the
noise; their iterations."""
ITERATIONS, TO_THE_END = 10, 1e-3
"""Iterations at the end, and the gain over the misfit at which they end: what the plain model
misses is told to three digits."""
OWN_SHARE = 0.005
"""Largest error of the simulation itself, over the model's residual, where that is more than the
noise allows: ERR is told to two digits, and at the end of a fit that error is extrapolated."""
IN_TIME = 0.3
"""Share of that error that time steps may have: they damp, in all pictures alike."""
FALLS = 0.7
"""Error over that of a coarser simulation, below which the finer one is worth its time."""


@dataclass(frozen=True)
class Beginning:
    """The fitted plain model with its recordings.

    Args:
        recordings: recordings with their noise and a resolution that is fine enough.
        at: the plain model fitted to all recordings.
        error: the simulation's own error, root mean square distance [m]; NaN where it was not
            judged.
        left_out: number of pictures of each recording that are grossly wrong and left out.
        near: a model that comes nearer, found before, against the same recordings; None: none is.
    """

    recordings: tuple[Recording, ...]
    at: Evaluation
    error: float
    left_out: tuple[int, ...] = ()
    near: Simulated | None = None


def begin(
    manipulations: Sequence[Manipulation], settings: Settings, near: ParametricModel | None = None
) -> Beginning:
    """Fit the plain model (E, mu, damping) and estimate the noise of the measurements.

    Args:
        near: model from which the fit may begin; default: the best of several values of E.

    Raises:
        InputError: a recording holds nothing that can be compared.
        SimulationError: no starting value can be simulated.
    """
    spatial = any(leaves_plane(m, settings) for m in manipulations)
    recordings = tuple(measured(m, settings, spatial=spatial) for m in manipulations)
    coarse = _coarse(recordings, settings)
    if near is None:
        at = _best_start(coarse, material_model(settings, settings))
    else:
        at = simulate(near, coarse, ())
    usable = tuple(
        without_gross(r, r.observed[-len(p) :] - p[..., :3])
        for r, p in zip(recordings, at.predicted, strict=True)
    )
    left_out = tuple(len(r.times) - len(u.times) for r, u in zip(recordings, usable, strict=True))
    # A better fit tells the noise better.
    at = _near(at.model, _coarse(usable, settings))
    fine, error = _finer(_with_noise(usable, at), at)
    return Beginning(fine, fitted(at.model, fine), error, left_out)


def fitted(model: ParametricModel, recordings: Sequence[Recording]) -> Evaluation:
    """The plain model fitted to recordings by least squares, as far as it goes.

    Raises:
        SimulationError: the model with which it begins cannot be simulated.
    """
    loss = WhiteLoss([r.noise for r in recordings], TO_THE_END)
    return fit(evaluate(model, recordings), recordings, ITERATIONS, loss=loss)


def finer(
    beginning: Beginning, near: ParametricModel, rough: Mapping[int, Recording]
) -> Beginning | None:
    """The initial fit with a simulation that is fine enough for a model that comes near the data.

    Args:
        rough: drafts with which that model was found, by the number of their recording; none where
            it was found without.

    Returns:
        None where the simulation's own error, and that of the drafts, is small beside what that
        model leaves over.

    Raises:
        SimulationError: that model cannot be simulated, with finer steps either.
    """
    settings, recordings = near.settings, beginning.recordings
    try:
        here = simulate(near, recordings, ())
    except SimulationError:  # where drafts go on, finer ones may
        recordings = tuple(refined(r, settings) for r in recordings)
        recordings, error = _finer(recordings, simulate(near, recordings, ()))
        return _begun_anew(beginning, recordings, error, simulate(near, recordings, ()))
    most = IMMATERIAL * rms(whitened(here, recordings))
    try:
        next_ = [refined(r, settings) for r in recordings]
        change = apart(here, simulate(near, next_, ()), recordings)
        missed = change / (1.0 - STEP_SHORTER**-2)  # it falls with the square of the step
        if missed >= most:
            recordings, error = _finer(recordings, here)
            fine = simulate(near, recordings, ())
            most = IMMATERIAL * rms(whitened(fine, recordings))
            if apart(here, fine, recordings) >= most:
                return _begun_anew(beginning, recordings, error, fine)
    except SimulationError as err:  # drafts may be too coarse all the same
        LOG.info("no finer simulation: %s", err)
    if not rough:
        return None
    drafted, fine_ones = list(rough.values()), [beginning.recordings[k] for k in rough]
    own = drafts_error(simulate(near, drafted, ()), drafted, here.of(list(rough)), fine_ones)
    return None if own < most else replace(beginning, near=here)


def _begun_anew(
    beginning: Beginning, recordings: tuple[Recording, ...], error: float, near: Simulated
) -> Beginning:
    """The initial fit with another simulation; the other arguments: see `Beginning`."""
    at = fitted(beginning.at.model, recordings)
    return Beginning(recordings, at, error, beginning.left_out, near)


def _best_start(coarse: tuple[Recording, ...], model: ParametricModel) -> Simulated:
    """The best of some fits of the plain model: a motion may have several local minima of E.

    A fit begins from each factor of E whose neighbours are farther from the shapes: from those it
    would lead into the same minimum. None begins where far more is left than from the best.
    """
    begun: dict[int, Simulated] = {}
    failure: SimulationError | None = None
    for k, factor in enumerate(FACTORS):
        try:
            begun[k] = simulate(model.stiffened(factor), coarse, ())
        except SimulationError as err:
            failure = err
    if not begun:
        raise failure or SimulationError("no starting value can be simulated")
    errs = {k: at.mean_err for k, at in begun.items()}
    least = [k for k in begun if errs[k] <= min(errs.get(n, np.inf) for n in (k - 1, k + 1))]
    valleys = [begun[k] for k in sorted(least, key=errs.__getitem__)]
    best = valleys[0]
    for at in valleys[:VALLEYS]:
        if at.mean_err > MUCH_LARGER * valleys[0].mean_err:
            break
        known = _with_noise(coarse, at)
        found = _fitted_to_most(at, known)
        if found is None:
            continue
        if found.mean_err < best.mean_err:
            best = found
        if rms(whitened(found, known)) < MUCH_LARGER:
            break
    return best


def _with_noise(recordings: Sequence[Recording], at: Simulated) -> tuple[Recording, ...]:
    """The recordings with the noise of what a model leaves."""
    settings = at.model.settings
    return tuple(with_noise(r, p, settings) for r, p in zip(recordings, at.predicted, strict=True))


def _coarse(recordings: Sequence[Recording], settings: Settings) -> tuple[Recording, ...]:
    """The recordings with simulations of few knot spans and long time steps."""
    tolerance = max(DRAFT_TOLERANCE, settings.simulation.tolerance)
    return tuple(
        replace(r, spans=DRAFT_SPANS * (r.observed.shape[1] - DEGREE), tolerance=tolerance)
        for r in recordings
    )


def _fitted_to_most(at: Simulated, recordings: Sequence[Recording]) -> Simulated | None:
    """A model fitted to the recordings with most of its error, simulated in all; or None."""
    shorter = [
        shortened(r, left, len(recordings))
        for r, left in zip(recordings, whitened(at, recordings), strict=True)
    ]
    loss = WhiteLoss([r.noise for r in shorter])
    try:
        begun = evaluate(at.model, shorter)
        found = fit(begun, shorter, VALLEY_ITERATIONS, loss=loss, draft=True)
        return simulate(found.model, recordings, ())
    except SimulationError:
        return None


def _near(model: ParametricModel, coarse: Sequence[Recording]) -> Simulated:
    """A fit that begins with a model which comes near, by its noise."""
    here = simulate(model, coarse, ())
    found = _fitted_to_most(here, _with_noise(coarse, here))
    return here if found is None or found.mean_err > here.mean_err else found


def _finer(recordings: Sequence[Recording], at: Simulated) -> tuple[tuple[Recording, ...], float]:
    """The recordings with knot spans and time steps that keep the simulation's error small."""
    result, errors = [], []
    settings, length = at.model.settings, at.model.settings.rod.length
    fineness = max(NOISE_SHARE, OWN_SHARE * rms(whitened(at, recordings)))
    for recording in recordings:
        n = recording.observed.shape[1]
        noise = float(np.sqrt(np.sum(recording.noise[:n] ** 2)))
        wanted = max(fineness * noise / length, FINEST)
        tolerance = min(settings.simulation.tolerance, wanted)
        own = np.inf
        started = as_started(settings, recording.manipulation)
        if started.simulation.start != "moving":  # there are equilibria near its way
            fine = replace(settings, simulation=replace(settings.simulation, tolerance=tolerance))
            found = forecast(recording.manipulation, fine)
            recording, own = replace(recording, spans=found.spans), found.resolution_error
        if own > tolerance:
            # Equilibria of two resolutions may lie on branches which the motion itself passes by.
            first = n - DEGREE
            spans = [replace(recording, spans=first * 2**k) for k in range(SPACE_ROUNDS)]
            recording, error = _coarsest(spans, at.model, tolerance * length, SPACE_FACTOR)
            own = error / length
        steps = [
            replace(recording, tolerance=LONGEST / TIME_FACTOR**k, rapid={})
            for k in range(TIME_ROUNDS)
        ]
        allowed = IN_TIME * fineness * float(np.linalg.norm(recording.noise))
        recording, error = _coarsest(steps, at.model, allowed, TIME_FACTOR)
        result.append(recording)
        whole = np.hypot(own * length, error)
        errors.append(whole if np.isfinite(whole) else np.nan)
    return tuple(result), float(np.nanmax(errors)) if np.isfinite(errors).any() else np.nan


def _coarsest(
    finer: Sequence[Recording], model: ParametricModel, allowed: float, factor: float
) -> tuple[Recording, float]:
    """The coarsest of ever finer simulations whose error is allowed, or the best of all; its error.

    The error is the difference from the next finer one, root mean square distance [m].

    Args:
        finer: the recording with ever finer simulations.
        allowed: error that is allowed [m].
        factor: factor by which the error falls from one to the next at least, where it falls.

    Raises:
        SimulationError: none of them can be simulated.
    """
    before: tuple[Recording, FloatArray] | None = None
    best, least = None, np.inf
    failure: SimulationError | None = None
    for recording in finer:
        try:
            shapes = simulate(model, [recording], ()).predicted[0][..., :3]
        except SimulationError as err:
            before, failure = None, err
            continue
        best = best or recording
        if before is not None:
            off = recording.coefficients(shapes - before[1])
            error = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
            if error < FALLS * least:
                best, least = before[0], error
            if error >= allowed > error / (factor - 1.0):
                best, least = recording, error / (factor - 1.0)
            if least < allowed:
                break
        before = recording, shapes
    if best is None:
        raise failure or SimulationError("nothing can be simulated")
    return best, least
