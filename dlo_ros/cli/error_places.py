# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sentences on how large a simulation's error is, and where and when it is largest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.cli.effect_words import mm
from dlo_ros.diagnosis import Diagnosis, RecordingView
from dlo_ros.inference.thresholds import SMALL_SHARE
from dlo_ros.inference.weighted_quantiles import weighted_quantiles
from dlo_ros.report.elements import number
from dlo_ros.report.worst_frame import is_lasting, worst_err, worst_frame
from dlo_ros.spline import FloatArray, SplineBasis

UNEVEN_ERROR = 1.3
"""Error at the worst over its mean, from which the place and the time are stated."""
LEAST_PICTURES = 20
"""Pictures of which nine of ten are a statement: fewer have no 5 % that lie outside."""
STATIONS = 41
"""Places along the DLO at which the error is looked at."""
AT_END, NEAR_END, NEAR_MIDDLE = 0.01, 0.15, 0.1
"""Shares of the length within which a place is at an end, near an end, or near the middle."""


def _spread(views: Sequence[RecordingView]) -> list[str]:
    """Sentence on the error in most pictures, all recordings counting the same, as in the mean."""
    errors = [v.err_before[is_lasting(v.err_before)] for v in views]
    if sum(map(len, errors)) < LEAST_PICTURES:
        return []
    weights = np.concatenate([np.full(len(e), 1.0 / (len(e) * len(errors))) for e in errors])
    low, high = weighted_quantiles(np.concatenate(errors), weights, (0.05, 0.95))
    if high < UNEVEN_ERROR * low:
        return []
    where = "all recordings" if len(errors) > 1 else "the whole recording"
    return [
        f"Fitted to all that may be learned from, it is between {mm(float(low))} and "
        f"{mm(float(high))} off in nine of ten pictures of {where}."
    ]


def _places(views: Sequence[RecordingView], length: float) -> list[str]:
    """Sentence on the places and times of the plain model's error."""
    if not views:
        return []
    squares = [_distances(v, length)[is_lasting(v.err_before)] ** 2 for v in views]
    along = np.sqrt(np.mean([np.mean(s, axis=0) for s in squares], axis=0))
    u = np.linspace(0.0, length, STATIONS)
    k = int(np.argmax(along))
    sentences = []
    if along[k] > UNEVEN_ERROR * along.mean():
        place = f"{1e3 * u[k]:.0f} of {1e3 * length:.0f} mm from the start"
        sentences.append(
            f"Along the DLO (the cable, rope or hose) it is most wrong {_place(u[k] / length)} "
            f"(at {place}), by {mm(float(along[k]))} (root mean square)."
        )
    else:
        sentences.append("It is about as wrong all along the DLO (the cable, rope or hose).")
    worst = max(views, key=lambda v: worst_err(v.err_before))
    frame = worst_frame(worst.err_before)
    error = float(worst.err_before[frame])
    means = [float(v.err_before.mean()) for v in views]
    if error > UNEVEN_ERROR * np.mean(means):
        at = [f"in {worst.name}"] if len(views) > 1 else []
        if error > UNEVEN_ERROR * worst.err_before.mean():
            at.append(f"{worst.times[frame]:.1f} s after the beginning")
        sentences.append(f"It is worst {', '.join(at)}: by {mm(error)} on average along the DLO.")
    return sentences


def _distances(view: RecordingView, length: float) -> FloatArray:
    """Distance between the observed and the plain model's DLO [m], shape (F, STATIONS)."""
    basis = SplineBasis(view.observed.shape[1], length)
    values = basis.matrix(np.linspace(0.0, length, STATIONS))
    apart = values @ (view.observed[:, :, :3] - view.before[:, :, :3])
    return np.asarray(np.linalg.norm(apart, axis=2))


def _place(share: float) -> str:
    """A place along the DLO, in words."""
    for end, away in (("start", share), ("end", 1.0 - share)):
        if away < NEAR_END:
            return f"{'at' if away < AT_END else 'near'} the {end}"
    if abs(share - 0.5) < NEAR_MIDDLE:
        return "near the middle"
    return "in the first half" if share < 0.5 else "in the second half"


def plain_error(found: Diagnosis) -> float | None:
    """Mean distance that the plain model leaves [m], on data not used where there are some."""
    base = found.baseline
    return base.err_train if base.err_holdout is None else base.err_holdout


def immaterial(found: Diagnosis) -> bool:
    """Whether the plain model's error is too small to matter."""
    err = plain_error(found)
    return err is not None and found.material_err is not None and err <= found.material_err


def how_wrong(found: Diagnosis, length: float) -> tuple[str, ...]:
    """Sentences on how wrong the plain simulation is.

    Args:
        length: length of the DLO [m].
    """
    err = plain_error(found)
    if err is None:
        return ("It cannot be simulated beyond what it was fitted to.",)
    where = "data that were not used"
    if found.baseline.err_holdout is None:
        where = "the data that it was fitted to"
    sentences = _as_given(found, err)
    sentences += [
        f"With the best Young's modulus and density it is {mm(err)} off on average "
        f"({number(100.0 * err / length, digits=2)} % of the length), on {where}."
    ]
    if not immaterial(found):  # where an error is that does not matter does not matter either
        sentences += [*_spread(found.views), *_places(found.views, length)]
    if found.noise_floor is not None:
        words = f"The measurement itself is about {mm(found.noise_floor)} off"
        if found.material_err is not None:
            words += f"; less than {mm(found.material_err)} does not matter here"
        sentences.append(f"{words}.")
    return (*sentences, *([found.left_out] if found.left_out else []))


def _as_given(found: Diagnosis, err: float) -> list[str]:
    """How wrong the parameter file is as it stands, where its E and mu are not the best ones.

    Args:
        err: mean distance that the plain model leaves with these [m].
    """
    given = found.given_err
    if given is None or abs(given - err) < SMALL_SHARE * err:
        return []
    return [f"As the parameter file stands, it is {mm(given)} off on average."]
