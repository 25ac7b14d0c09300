# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The plain model's fit, the noise of the recordings, and a resolution finer than that noise."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.fitting.levenberg_marquardt import CLEARLY_WRONG, attempt, fit
from dlo_ros.diagnosis.fitting.plain_evaluation import PlainEvaluation, evaluate
from dlo_ros.diagnosis.fitting.plain_model import PlainModel, baseline
from dlo_ros.diagnosis.fitting.recording_noise import with_bias, with_noise
from dlo_ros.errors import SimulationError
from dlo_ros.identification.estimate import FINEST
from dlo_ros.inference.forecast import Manipulation, as_started, forecast
from dlo_ros.inference.measured import Recording, measured, without_gross
from dlo_ros.inference.time_steps import longest_time_steps
from dlo_ros.parameters import Settings
from dlo_ros.spline import DEGREE, FloatArray

LOG = logging.getLogger(__name__)

FACTORS = (1.0, 0.3, 3.0, 0.1, 10.0, 0.03, 30.0)
"""Multiples of E from which the fit may start: far away a shape may lie on another branch."""
VALLEYS = 3
VALLEY_ITERATIONS = 6
"""Largest number of these starts that are fitted, until a residual is small; their iterations."""
POLISH, UNDAMPED = 3, 1e-9
"""Iterations at the end, and their damping: what the data leave open keeps its prior."""
FINENESS = 0.1
"""Largest error of the simulation itself, over the noise of one frame."""
OWN_SHARE = 0.0015
"""Largest error of the simulation itself, over the model's residual, where that is more than the
noise allows: nothing finer is judged."""
OWN_MATTERS = 0.3
"""Error of the simulation itself over the model's residual, from which it matters."""
IN_TIME = 0.3
"""Share of that error that time steps may have: they damp, in all pictures alike."""
ROUNDS = 2
SPACE_ROUNDS = 5
WORTH = 0.7
"""Error over that with fewer knot spans, below which more of them are worth their time."""
DRAFT_SPANS = 2
"""Knot spans of a draft's simulation over those of the observed spline."""
DRAFT_TOLERANCE = 1e-3
DRAFT_ERROR = 0.3
"""Largest error of a draft against the fine simulation, in units of the noise."""
DRAFT_FRAMES = 800
LEAST_FRAMES = 100
"""Frames that a draft goes through: most of all recordings together, least of one."""
SHOWN = 0.25
"""Share of the squared residuals that a draft must go through."""
DRAFT_SHARE = 0.01
"""Error of a draft over the plain model's residual, up to which it does not matter: good models
leave a tenth of that residual and less."""


@dataclass(frozen=True)
class Beginning:
    """The fitted plain model with its recordings.

    Args:
        recordings: recordings with their noise and a resolution that is fine enough.
        at: the fit to all recordings.
        error: the simulation's own error, mean distance [m]; NaN where it was not judged.
        left_out: number of pictures of each recording that are grossly wrong and left out.
        near: a model that comes nearer, found before, against the same recordings; None: none is.
    """

    recordings: tuple[Recording, ...]
    at: PlainEvaluation
    error: float
    left_out: tuple[int, ...] = ()
    near: PlainEvaluation | None = None


def begin(
    manipulations: Sequence[Manipulation], settings: Settings, near: PlainModel | None = None
) -> Beginning:
    """Fit the plain model (E, mu, damping) and estimate the noise of the measurements.

    Args:
        near: model from which the fit may begin; default: the best of several values of E.

    Raises:
        InputError: a recording holds nothing that can be compared.
        SimulationError: no starting value can be simulated.
    """
    recordings = tuple(measured(m, settings) for m in manipulations)
    at = _first(recordings, settings, near)
    usable = tuple(
        without_gross(r, r.observed[-len(p) :] - p[..., :3])
        for r, p in zip(recordings, at.predicted, strict=True)
    )
    left_out = tuple(len(r.times) - len(u.times) for r, u in zip(recordings, usable, strict=True))
    if any(left_out):
        recordings = usable
        at = _near(at.model, recordings)
    error = np.nan
    for _ in range(ROUNDS):
        recordings = with_bias(recordings, at.predicted, settings)
        recordings = tuple(
            with_noise(r, p, settings) for r, p in zip(recordings, at.predicted, strict=True)
        )
        recordings, error = _finer(recordings, at)
        at = fit(evaluate(at.model, recordings, settings), recordings, settings, 6)
    at = fit(at, recordings, settings, POLISH, damping=UNDAMPED)
    return Beginning(recordings, at, error, left_out)


def _first(
    recordings: tuple[Recording, ...], settings: Settings, near: PlainModel | None
) -> PlainEvaluation:
    """Evaluation of the model with which a fit begins."""
    if near is None:
        return _best_start(recordings, baseline(settings))
    return evaluate(near, recordings, settings, derivatives=False)


def finer(
    beginning: Beginning, near: PlainModel, rough: Mapping[int, Recording], settings: Settings
) -> Beginning | None:
    """The initial fit with a simulation that is fine enough for a model that comes near the data.

    Args:
        rough: drafts with which that model was found, by the number of their recording.

    Returns:
        None where the simulation's own error, and that of the drafts, is small beside what that
        model leaves over.
    """
    here = evaluate(near, beginning.recordings, settings, derivatives=False)
    try:
        recordings, error = _finer(beginning.recordings, here)
        fine = evaluate(near, recordings, settings, derivatives=False)
    except SimulationError as err:  # drafts may be too coarse all the same
        LOG.info("no finer simulation: %s", err)
        recordings, error, fine = beginning.recordings, beginning.error, here
    most = OWN_MATTERS * _rms(fine.residuals)
    own = [a - b for a, b in zip(here.residuals, fine.residuals, strict=True)]
    if _rms(own) >= most:
        at = fit(evaluate(beginning.at.model, recordings, settings), recordings, settings, 6)
        at = fit(at, recordings, settings, POLISH, damping=UNDAMPED)
        return Beginning(recordings, at, error, beginning.left_out, fine)
    drafted = evaluate(near, list(rough.values()), settings, derivatives=False).residuals
    own = [a - here.residuals[k][: len(a)] for k, a in zip(rough, drafted, strict=True)]
    return None if _rms(own) < most else replace(beginning, near=here)


def _rms(residuals: Sequence[FloatArray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate([r.ravel() for r in residuals]) ** 2)))


def _best_start(recordings: tuple[Recording, ...], model: PlainModel) -> PlainEvaluation:
    """The best of some fits of the plain model: a motion may have several local minima of E."""
    coarse = _coarse(recordings)
    begun: list[PlainEvaluation] = []
    failure: SimulationError | None = None
    theta = model.theta()
    for factor in FACTORS:
        shifted = theta.copy()
        shifted[0] += np.log(factor)
        try:
            begun.append(evaluate(model.at(shifted), coarse, model.settings, derivatives=False))
        except SimulationError as err:
            failure = err
    if not begun:
        raise failure or SimulationError("no starting value can be simulated")
    begun.sort(key=lambda at: at.mean_err)
    best = begun[0]
    for at in begun[:VALLEYS]:
        found = _fitted_to_most(at, coarse)
        if found is not None and found.mean_err < best.mean_err:
            best = found
        if found is not None and found.excess < CLEARLY_WRONG:
            break
    return best


def _coarse(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """The recordings with simulations of few knot spans."""
    return tuple(replace(r, spans=2 * (r.observed.shape[1] - DEGREE)) for r in recordings)


def _fitted_to_most(at: PlainEvaluation, recordings: Sequence[Recording]) -> PlainEvaluation | None:
    """A model fitted to the recordings with most of its error, evaluated on all; or None."""
    settings = at.model.settings
    # Without its noise the prior would count for more than the data.
    known = [with_noise(r, p, settings) for r, p in zip(recordings, at.predicted, strict=True)]
    shorter = [
        r.until(_long_enough(left, len(known)) + len(r.times) - len(left))
        for r, left in zip(known, at.residuals, strict=True)
    ]
    found = attempt(at.model, shorter, settings, VALLEY_ITERATIONS)
    if found is None or all(s is r for s, r in zip(shorter, known, strict=True)):
        return found
    try:
        return evaluate(found.model, known, settings, derivatives=False)
    except SimulationError:
        return None


def _near(model: PlainModel, recordings: Sequence[Recording]) -> PlainEvaluation:
    """A fit that begins with a model which was fitted to a little more data."""
    coarse = _coarse(recordings)
    here = evaluate(model, coarse, model.settings, derivatives=False)
    found = _fitted_to_most(here, coarse)
    return here if found is None or found.mean_err > here.mean_err else found


def _finer(
    recordings: tuple[Recording, ...], at: PlainEvaluation
) -> tuple[tuple[Recording, ...], float]:
    """The recordings with knot spans and time steps that keep the simulation's error small."""
    result, errors = [], []
    settings = at.model.settings
    left = [r.residual(p) for r, p in zip(recordings, at.predicted, strict=True)]
    fineness = max(FINENESS, OWN_SHARE * _rms(left))
    for recording in recordings:
        n = recording.observed.shape[1]
        noise = float(np.sqrt(np.sum(recording.noise[:n] ** 2)))
        wanted = max(fineness * noise / settings.rod.length, FINEST)
        tolerance = min(settings.simulation.tolerance, wanted)
        own = np.inf
        started = as_started(settings, recording.manipulation)
        if started.simulation.start != "moving":  # there are equilibria near its way
            fine = replace(settings, simulation=replace(settings.simulation, tolerance=tolerance))
            found = forecast(recording.manipulation, fine)
            recording, own = replace(recording, spans=found.spans), found.resolution_error
        if own > tolerance:
            recording, own = _in_space(recording, at.model, tolerance)
        recording, error = _in_time(recording, at.model, IN_TIME * fineness)
        result.append(recording)
        errors.append(np.hypot(own * settings.rod.length, error))
    return tuple(result), float(np.nanmax(errors)) if np.isfinite(errors).any() else np.nan


def _in_space(recording: Recording, model: PlainModel, tolerance: float) -> tuple[Recording, float]:
    """The recording with knot spans that are fine enough, and the error that is left, over L.

    The error is that of the motion itself where no equilibrium on its way tells: equilibria of two
    resolutions may lie on different branches, which a motion passes by.
    """
    unit = replace(recording, noise=np.ones(len(recording.noise)))
    first = recording.observed.shape[1] - DEGREE
    coarse: tuple[Recording, FloatArray] | None = None
    best, least = recording, np.inf
    for spans in (first * 2**k for k in range(SPACE_ROUNDS)):
        finer = replace(recording, spans=spans)
        try:
            shapes = evaluate(model, [finer], model.settings, derivatives=False).predicted[0]
        except SimulationError:
            coarse = None
            continue
        if coarse is not None:
            apart = unit.white(shapes[..., :3] - coarse[1][..., :3])
            error = float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) / model.settings.rod.length
            if error < WORTH * least:
                best, least = coarse[0], error
            if least < tolerance:
                break
        coarse = finer, shapes
    return best, least


def _in_time(recording: Recording, model: PlainModel, fineness: float) -> tuple[Recording, float]:
    """The recording with time steps that are fine enough, and the error that is left [m]."""
    n = recording.observed.shape[1]
    noise = float(np.sqrt(np.sum(recording.noise[:n] ** 2)))

    def predicted(tolerance: float) -> FloatArray:
        here = replace(recording, tolerance=tolerance)
        return evaluate(model, [here], model.settings, derivatives=False).predicted[0][..., :3]

    def apart(a: FloatArray, b: FloatArray) -> float:
        return float(np.sqrt(np.mean(recording.white(a - b) ** 2)))

    tolerance, error = longest_time_steps(predicted, apart, fineness)
    return replace(recording, tolerance=tolerance), error * noise


def drafts(recordings: Sequence[Recording], at: PlainEvaluation) -> tuple[Recording, ...]:
    """The recordings with a coarser simulation that is still reliable, long ones shortened.

    Args:
        at: evaluation of a model with the fine simulation: of the plain one, or of one that comes
            nearer, for which the drafts are reliable then.
    """
    result = []
    for recording, r, fine in zip(recordings, at.residuals, at.predicted, strict=True):
        coarse = DRAFT_SPANS * (recording.observed.shape[1] - DEGREE)
        most = max(DRAFT_ERROR, DRAFT_SHARE * float(np.sqrt(np.mean(r**2))))
        tolerance = max(DRAFT_TOLERANCE, recording.tolerance or 0.0)
        finest = recording.spans or coarse * 2**SPACE_ROUNDS
        coarser = [coarse * 2**k for k in range(SPACE_ROUNDS) if coarse * 2**k < finest]
        for spans in (*coarser, recording.spans):
            draft = replace(recording, spans=spans, tolerance=tolerance)
            try:
                draft_at = evaluate(at.model, [draft], at.model.settings, derivatives=False)
            except SimulationError:
                continue
            apart = draft_at.predicted[0][..., :3] - fine[..., :3]
            if np.sqrt(np.mean(recording.white(apart) ** 2)) < most:
                # What it does wrong with this model, it does with others, nearly.
                draft = draft.moved(apart)
                break
        else:
            draft = recording
        result.append(draft.until(_long_enough(r, len(recordings)) + len(recording.times) - len(r)))
    return tuple(result)


def _long_enough(residual: FloatArray, recordings: int) -> int:
    """Number of frames from the first in which most of the model's error has shown itself."""
    shown = np.cumsum(np.sum(residual**2, axis=1))
    most = max(LEAST_FRAMES, DRAFT_FRAMES // recordings)
    return max(most, int(np.searchsorted(shown, SHOWN * shown[-1])) + 1)
