# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The recording that is held out, or the end of each, and the gain that is measured there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.diagnosis.findings.diagnosis_outcome import Gain
from dlo_ros.effects import damping_effect
from dlo_ros.errors import SimulationError
from dlo_ros.identification.offline.initial_fit import fitted
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.thresholds import APART, LOWERS
from dlo_ros.spline import FloatArray

TRAINED = 0.6
"""Share of a recording before the span that is held out; a tenth between them is neither."""
BLOCK = 10
DRAWS = 500
SPARE = 3
"""Recordings, from which one of them is held out whole."""


def fitted_to_seen(
    model: ParametricModel, recordings: Sequence[Recording], masks: Sequence[np.ndarray],
    material_err: float,
) -> ParametricModel:  # fmt: skip
    """The plain model fitted to the masked frames alone.

    Where it leaves something that matters, a damping that the parameter file only guesses may do
    the work of laws that the model lacks: of poses at rest, one of seconds that of a creep. As in
    the full model, it keeps its guess unless it brings the model as much nearer as a cause must.

    Args:
        masks: frames of each recording that are seen, shape (F,).
        material_err: ERR [m] from which it matters.
    """
    used = [k for k, mask in enumerate(masks) if mask.any()]
    chosen = [recordings[k].until(int(np.flatnonzero(masks[k])[-1]) + 1) for k in used]
    found = fitted(model, chosen)
    dampings = [p for p in model.parameters if p.guessed and damping_effect(p.name)]
    if found.mean_err < material_err or not dampings:
        return found.model
    held = found.model.with_prior([p.held() for p in dampings])
    try:
        guessed = fitted(held.centred([p.name for p in dampings]), chosen)
    except SimulationError:
        return found.model
    needed = found.mean_err <= (1.0 - LOWERS) * guessed.mean_err
    return found.model if needed else guessed.model


def mean(err: Sequence[FloatArray] | None) -> float | None:
    """Mean over recordings of the time mean [m]."""
    if not err:
        return None
    return float(np.mean([e.mean() for e in err]))


def gain(before: Sequence[FloatArray] | None, after: Sequence[FloatArray] | None) -> Gain | None:
    """Relative fall of ERR, with an interval from blocks of neighbouring frames."""
    if not before or not after:
        return None
    rng = np.random.default_rng(0)

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


def held_out_recording(recordings: Sequence[Recording]) -> int | None:
    """The recording to be held out: the last gripped as another is that moves not much faster.

    An error that shows only where the DLO is gripped otherwise, or moves, could not be predicted.
    """
    if len(recordings) < SPARE:
        return None
    grips = [{n for c in r.manipulation.commands for n in c.names} for r in recordings]
    speeds = [_speed(r) for r in recordings]
    for k in reversed(range(len(recordings))):
        others = [speeds[i] for i, g in enumerate(grips) if i != k and g == grips[k]]
        if others and speeds[k] <= APART * max(others):
            return k
    return None


def _speed(recording: Recording) -> float:
    """Root mean square speed of the DLO between frames [m/s]."""
    if len(recording.times) < 2:
        return 0.0
    moved = np.linalg.norm(np.diff(recording.observed, axis=0), axis=2)
    return float(np.sqrt(np.mean((moved / np.diff(recording.times)[:, None]) ** 2)))
