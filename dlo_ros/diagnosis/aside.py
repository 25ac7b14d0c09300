"""What is kept aside: errors of models on frames that did not take part in their fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.fitting import Evaluation, evaluate, fit, known, normal
from dlo_ros.diagnosis.measured import Recording
from dlo_ros.diagnosis.model import Model
from dlo_ros.diagnosis.outcome import Gain
from dlo_ros.errors import SimulationError
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

TRAINED = 0.6
"""Of a single recording, that comes before the span kept aside; a tenth between them is neither."""
BLOCK = 10
DRAWS = 500
STEPS = 3


@dataclass(frozen=True)
class Split:
    """Which frames a model may see.

    Args:
        train, holdout: for each recording the frames, as a mask of shape (F,).
    """

    train: tuple[np.ndarray, ...]
    holdout: tuple[np.ndarray, ...]


def split(recordings: Sequence[Recording], given: int, information: Sequence[float]) -> Split:
    """Set aside the given recordings, or one of several, or the end of the only one.

    Args:
        recordings: those to train on, then the given ones.
        given: how many were given to be kept aside.
        information: of each recording on the stiffness; with few recordings the one that
            tells least of it is kept aside, so that the others determine the model.
    """
    count = len(recordings)
    frames = [len(r.times) for r in recordings]
    whole = [np.ones(f, dtype=np.bool_) for f in frames]
    none = [np.zeros(f, dtype=np.bool_) for f in frames]
    if given:
        aside = set(range(count - given, count))
    elif count > 1:
        aside = {int(np.argmin(information))}
    else:
        share = np.arange(frames[0]) / max(frames[0] - 1, 1)
        return Split((share <= TRAINED,), (share >= TRAINED + 0.1,))
    train = tuple(none[k] if k in aside else whole[k] for k in range(count))
    holdout = tuple(whole[k] if k in aside else none[k] for k in range(count))
    return Split(train, holdout)


def trained(at: Evaluation, masks: Sequence[np.ndarray], given: Settings) -> Model:
    """The model with parameters from the masked frames alone, by one linearised step."""
    assert at.jacobians is not None
    equations = known(at.model, given)
    for residual, jacobian, mask in zip(at.residuals, at.jacobians, masks, strict=True):
        keep = mask[-len(residual) :]
        if keep.any():
            equations = equations + normal(residual[keep], jacobian[keep]).scaled(1.0 / at.excess)
    step, _ = equations.minimum()
    step = np.clip(step, -at.model.natural(), at.model.natural())
    return at.model.at(at.model.theta() + step)


def refitted(
    at: Evaluation, recordings: Sequence[Recording], masks: Sequence[np.ndarray], given: Settings
) -> Model:
    """The model fitted to the masked frames alone."""
    used = [k for k, mask in enumerate(masks) if mask.any()]
    chosen = [_shortened(recordings[k], masks[k]) for k in used]
    try:
        here = evaluate(trained(at, masks, given), chosen, given)
    except SimulationError:
        here = evaluate(at.model, chosen, given)
    return fit(here, chosen, given, STEPS).model


def _shortened(recording: Recording, mask: np.ndarray) -> Recording:
    """The recording up to its last wanted frame."""
    stop = int(np.flatnonzero(mask)[-1]) + 1
    if stop == len(mask):
        return recording
    manipulation = recording.manipulation
    shorter = replace(manipulation, observations=manipulation.observations[:stop])
    return replace(
        recording,
        manipulation=shorter,
        observed=recording.observed[:stop],
        times=recording.times[:stop],
        across=recording.across[:stop],
    )


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
    """How much smaller ERR has become, with an interval from blocks of neighbouring frames."""
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
