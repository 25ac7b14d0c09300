# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The held-out recordings: errors of models on frames that did not take part in their fit.

Single effects are judged by these recordings; of the joint model, which learns from several, one of
them is held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dlo_ros.diagnosis.findings.diagnosis_outcome import Gain
from dlo_ros.diagnosis.fitting.candidate_model import Model
from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation, evaluate
from dlo_ros.diagnosis.fitting.levenberg_marquardt import fit, solve, total
from dlo_ros.diagnosis.selection.effect_search import Candidate
from dlo_ros.errors import SimulationError
from dlo_ros.inference.measured import Recording
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

TRAINED = 0.6
"""Share of a recording before the span that is held out; a tenth between them is neither."""
FORESEEN = 0.3
"""Largest prediction error, in units of the noise, of a recording that is held out whole."""
BLOCK = 10
DRAWS = 500
STEPS = 3
ASTRAY = 1.5
"""ERR on held-out data over that of the fit to all data, from which a linearised step is not
believed."""
SPARE = 3
"""Recordings, from which the joint model holds one of them out whole."""
FASTER = 3.0
"""Speed of that recording over that of the fastest other at most."""


@dataclass(frozen=True)
class Split:
    """The frames for training and the held-out frames.

    Args:
        train, holdout: masks of the frames, shape (F,) for each recording.
    """

    train: tuple[np.ndarray, ...]
    holdout: tuple[np.ndarray, ...]


def split(
    recordings: Sequence[Recording], holdout: int, plain: CandidateEvaluation,
    best: CandidateEvaluation, given: Settings,
) -> Split:  # fmt: skip
    """Hold out the given recordings, or one that the others predict, or the end of each.

    Of those that the others predict it is the one with the largest residual of the plain model.

    Args:
        recordings: recordings to train on, then recordings to hold out.
        holdout: number of recordings to hold out.
        plain, best: fits to the former without and with what was found.
    """
    count = len(recordings)
    frames = [len(r.times) for r in recordings]
    held: set[int] = set()
    if holdout:
        held = set(range(count - holdout, count))
    elif count > 1:
        shown = [float(np.mean(r**2)) for r in plain.residuals]
        foreseen = [k for k in range(count) if _open(best, k, given) < FORESEEN]
        if foreseen:
            held = {max(foreseen, key=lambda k: shown[k])}
    if not held:
        shares = [np.arange(f) / max(f - 1, 1) for f in frames]
        return Split(tuple(s <= TRAINED for s in shares), tuple(s >= TRAINED + 0.1 for s in shares))
    whole = [np.ones(f, dtype=np.bool_) for f in frames]
    none = [np.zeros(f, dtype=np.bool_) for f in frames]
    return Split(
        tuple(none[k] if k in held else whole[k] for k in range(count)),
        tuple(whole[k] if k in held else none[k] for k in range(count)),
    )


def _open(at: CandidateEvaluation, k: int, given: Settings) -> float:
    """Standard deviation of a recording's prediction from the others, in units of the noise."""
    assert at.jacobians is not None
    others = [np.full(len(r), j != k) for j, r in enumerate(at.residuals)]
    equations = total(at, given, others)
    spread = solve(equations.hessian, np.eye(len(equations.gradient)))
    jacobian = at.jacobians[k]
    variance = np.einsum("fpk,pq,fqk->fk", jacobian, spread, jacobian)
    return float(np.sqrt(np.mean(np.maximum(variance, 0.0))))


def trained(at: CandidateEvaluation, masks: Sequence[np.ndarray], given: Settings) -> Model:
    """The model with parameters from the masked frames alone, by one linearised step."""
    equations = total(at, given, masks)
    step, _ = equations.minimum()
    step = np.clip(step, -at.model.natural(), at.model.natural())
    return at.model.at(at.model.theta() + step)


def refitted(
    at: CandidateEvaluation,
    recordings: Sequence[Recording],
    masks: Sequence[np.ndarray],
    given: Settings,
) -> Model:
    """The model fitted to the masked frames alone."""
    used = [k for k, mask in enumerate(masks) if mask.any()]
    chosen = [recordings[k].until(int(np.flatnonzero(masks[k])[-1]) + 1) for k in used]
    try:
        here = evaluate(trained(at, masks, given), chosen, given)
    except SimulationError:
        here = evaluate(at.model, chosen, given)
    return fit(here, chosen, given, STEPS).model


def errors(
    model: Model, recordings: Sequence[Recording], masks: Sequence[np.ndarray], given: Settings
) -> list[FloatArray] | None:
    """ERR [m] of the masked frames, per recording that has any; None where it cannot be had."""
    used = [k for k, mask in enumerate(masks) if mask.any()]
    try:
        at = evaluate(model, [recordings[k] for k in used], given, derivatives=False)
    except SimulationError:
        return None
    return [
        err[masks[k][-len(err) :]] for k, err in zip(used, at.err, strict=True)
    ]  # fmt: skip


def mean(err: Sequence[FloatArray] | None) -> float | None:
    """Mean over recordings of the time mean [m]."""
    if not err:
        return None
    return float(np.mean([e.mean() for e in err]))


def gain(
    before: Sequence[FloatArray] | None, after: Sequence[FloatArray] | None, seed: int = 0
) -> Gain | None:
    """Relative fall of ERR, with an interval from blocks of neighbouring frames."""
    if not before or not after:
        return None
    rng = np.random.default_rng(seed)

    def ratio(pick: Sequence[np.ndarray]) -> float:
        a = np.mean([e[p].mean() for e, p in zip(after, pick, strict=True)])
        b = np.mean([e[p].mean() for e, p in zip(before, pick, strict=True)])
        return float(1.0 - a / max(b, 1e-300))

    everything = [np.arange(len(e)) for e in before]
    drawn = [ratio([_blocks(len(e), rng) for e in before]) for _ in range(DRAWS)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Gain(ratio(everything), float(low), float(high))


def _blocks(frames: int, rng: np.random.Generator) -> np.ndarray:
    size = min(BLOCK, frames)
    first = rng.integers(0, frames - size + 1, -(-frames // size))
    return np.concatenate([np.arange(f, f + size) for f in first])[:frames]


@dataclass(frozen=True)
class HoldoutErrors:
    """ERR of candidates on the held-out data [m], with parameters learned from the other data.

    Args:
        recordings: all; the first `learned` are those that candidates were fitted to.
        parted: frames that are held out.
        known: results of earlier calls, by the candidate's identity.
    """

    recordings: Sequence[Recording]
    learned: int
    parted: Split
    given: Settings
    known: dict[int, tuple[Candidate, float | None]] = field(default_factory=dict)

    def __call__(self, c: Candidate) -> float | None:
        """ERR of a candidate [m]; None where it cannot be simulated."""
        if id(c) not in self.known:
            self.known[id(c)] = c, self._careful(c)
        return self.known[id(c)][1]

    def linearised_err(self, c: Candidate) -> float | None:
        """ERR after one linearised step from the fit to all data, unless a fit is known."""
        if id(c) in self.known:
            return self.known[id(c)][1]
        return self._err(trained(c.at, self.parted.train[: self.learned], self.given))

    def _careful(self, c: Candidate) -> float | None:
        """ERR [m]; the model is fitted anew where the linearised step is too long to be trusted."""
        err = self.linearised_err(c)
        masks = self.parted.holdout[: self.learned]
        seen = [e[m[-len(e) :]] for e, m in zip(c.at.err, masks, strict=True) if m.any()]
        together = mean(seen)
        if together is None or (err is not None and err < ASTRAY * together):
            return err
        train = self.parted.train[: self.learned]
        again = self._err(refitted(c.at, self.recordings[: self.learned], train, self.given))
        return min((e for e in (err, again) if e is not None), default=None)

    def _err(self, model: Model) -> float | None:
        return mean(errors(model, self.recordings, self.parted.holdout, self.given))


def held_out_recording(recordings: Sequence[Recording]) -> int | None:
    """The recording to be held out: the last that is gripped as another is and moves no faster.

    An error that shows only where the DLO is gripped otherwise, or moves, could not be predicted.
    """
    if len(recordings) < SPARE:
        return None
    grips = [{n for c in r.manipulation.commands for n in c.names} for r in recordings]
    speeds = [_speed(r) for r in recordings]
    for k in reversed(range(len(recordings))):
        others = [speeds[i] for i, g in enumerate(grips) if i != k and g == grips[k]]
        if others and speeds[k] <= FASTER * max(others):
            return k
    return None


def _speed(recording: Recording) -> float:
    """Root mean square speed of the DLO between frames [m/s]."""
    if len(recording.times) < 2:
        return 0.0
    moved = np.linalg.norm(np.diff(recording.observed, axis=0), axis=2)
    return float(np.sqrt(np.mean((moved / np.diff(recording.times)[:, None]) ** 2)))
