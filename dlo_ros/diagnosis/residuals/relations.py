# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Relations of a residual: its patterns along u and in time, and the inputs that it depends on.

Residuals and inputs both vary slowly, and any two slow signals look alike. So drift is removed from
every recording first, and an input must then explain more of the residual than of surrogates, of
two kinds: Gaussian fields with the residual's spectrum, its patterns along the DLO and its size
over time (after Prichard and Theiler, Phys. Rev. Lett. 73, 1994, but the amplitudes drawn as well
as the phases); and the residual itself, shifted in time, which keeps its swings and impacts. The
best of all inputs is compared with the best of all in each surrogate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from dlo_ros.diagnosis.residuals.recorded_inputs import Input, inputs
from dlo_ros.diagnosis.residuals.surrogates import chances, without
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.smooth_modes import whitening
from dlo_ros.inference.thresholds import CHANCE, CLEARLY_LESS, FEWEST, SMALL_SHARE
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray, SplineBasis

SLOW = 2
"""Degree of the polynomial in time that is taken out of each recording."""
PATTERNS = 6
"""Shapes along the DLO that are looked at."""
MOST_INPUTS = 3
"""Inputs that are reported one after the other."""
SPANS = 4
"""Number of spans of a single recording, each of which is predicted from the others."""
CLEAR = 0.15
"""Size over the largest of a pattern, from which its sign counts."""


@dataclass(frozen=True)
class ResidualPattern:
    """The strongest shape along the DLO.

    Args:
        share: fraction of the repeating part of the residual that has this shape.
        place: material coordinate of its largest value [m].
        signs: number of its changes of sign along the DLO.
    """

    share: float
    place: float
    signs: int


@dataclass(frozen=True)
class Relation:
    """How much of a residual an input explains.

    Args:
        name: name of the input.
        share: fraction of the repeating part without drift, predicted from the other recordings or
            spans of time.
        chance: fraction of the surrogates that are explained as well.
        significant: whether the relation is more than chance, and not only by way of another input.
        alike: inputs that explain it about as well, so that the data cannot separate them.
    """

    name: str
    share: float
    chance: float
    significant: bool = False
    alike: tuple[str, ...] = ()


@dataclass(frozen=True)
class Relations:
    """Patterns of the residuals of some recordings, and the inputs that they depend on.

    Args:
        size: root autocovariance of the residuals from frame to frame [m], to which noise that is
            new in every frame does not contribute.
        constant, slow: shares of it that stay within each recording, and that drift there.
        pattern: strongest pattern along the DLO; None where nothing repeats.
        inputs: inputs by falling share, significant ones first.
        unjudged: inputs that vary too slowly to be separated from a drift.
    """

    size: float
    constant: float
    slow: float
    pattern: ResidualPattern | None
    inputs: tuple[Relation, ...]
    unjudged: tuple[str, ...]

    @property
    def significant(self) -> tuple[Relation, ...]:
        """The relations that are more than chance."""
        return tuple(r for r in self.inputs if r.significant)


def relations(
    recordings: Sequence[Recording], residuals: Sequence[FloatArray],
    predicted: Sequence[FloatArray], settings: Settings,
) -> Relations:  # fmt: skip
    """Test the residuals of a model.

    Args:
        residuals: residuals of each recording in units of the noise, shape (F, K), of its last F
            frames.
        predicted: control points per recording [m], shape (F, n, 3 or more).
        settings: settings of the model.
    """
    width = max(r.shape[1] for r in residuals)
    unit = float(np.mean([np.sqrt(np.mean(r.noise**2)) for r in recordings]))
    fields = [
        np.pad(r * (m.noise / unit), [(0, 0), (0, width - r.shape[1])])
        for r, m in zip(residuals, recordings, strict=True)
    ]
    total = sum(_lag_one_sum(f) for f in fields)
    frames = sum(len(f) for f in fields)
    silent = Relations(unit * float(np.sqrt(max(total, 0.0) / frames)), 0.0, 0.0, None, (), ())
    if not _repeats(fields):
        return silent
    times = [r.times[-len(f) :] for r, f in zip(recordings, fields, strict=True)]
    kept = [
        sum(_lag_one_sum(f - _steady(f, t, degree)) for t, f in zip(times, fields, strict=True))
        for degree in (0, SLOW)
    ]
    shares = [k / total for k in kept]
    constant = float(np.clip(shares[0], 0.0, 1.0))
    found = replace(
        silent, constant=constant, slow=float(np.clip(shares[1] - shares[0], 0.0, 1.0 - constant)),
        pattern=_pattern(fields, total, settings),
    )  # fmt: skip
    long = [k for k, f in enumerate(fields) if len(f) >= FEWEST]
    if not long:
        return found
    varied = inputs([recordings[k] for k in long], [predicted[k] for k in long], settings)
    related, unjudged = relate([fields[k] for k in long], [times[k] for k in long], varied)
    return replace(found, inputs=related, unjudged=unjudged)


def relate(
    fields: Sequence[FloatArray], times: Sequence[FloatArray], varied: Sequence[Input],
    seed: int = 0,
) -> tuple[tuple[Relation, ...], tuple[str, ...]]:  # fmt: skip
    """The inputs that residual fields depend on.

    Args:
        fields: residual field of each recording, shape (F, K), F at least `FEWEST`.
        times: times of each recording [s], shape (F,).

    Returns:
        Relations to all inputs, the significant ones first; inputs that cannot be judged.
    """
    total = sum(_lag_one_sum(f) for f in _moving(fields, times))
    judged = {i.name: b for i in varied if (b := _basis(i, times)) is not None}
    unjudged = tuple(i.name for i in varied if i.name not in judged)
    if total <= 0.0 or not judged:
        return (), unjudged
    amplitudes, slow = _amplitudes(fields, times), [_slow(t, SLOW) for t in times]
    rng = np.random.default_rng(seed)
    significant: list[Relation] = []
    first: dict[str, Relation] = {}
    left = dict(judged)
    while left and len(significant) < MOST_INPUTS:
        by_chance = chances(amplitudes, slow, left, rng)
        field = np.concatenate(_moving(amplitudes, times))
        gains = {n: _predicted_share(field, b, times) for n, b in left.items()}
        # What changes from frame to frame has more power than neighbouring frames have in common.
        total = max(total, *gains.values())
        shares = {n: max(gain, 0.0) / total for n, gain in gains.items()}
        here = {n: Relation(n, shares[n], max(by_chance[n])) for n in left}
        first = first or here
        sure = [
            r for n, r in here.items()
            # A single recording has no more shifts than frames.
            if by_chance[n][0] <= CHANCE and by_chance[n][1] <= 2.0 * CHANCE
            and r.share >= SMALL_SHARE
        ]  # fmt: skip
        if not sure:
            break
        best = max(sure, key=lambda r: r.share)
        alike = tuple(
            r.name for r in sorted(sure, key=lambda r: -r.share)
            if r is not best and r.share > CLEARLY_LESS * best.share
        )  # fmt: skip
        significant.append(replace(best, significant=True, alike=alike))
        taken = judged[best.name]
        explained = np.split(taken @ (taken.T @ field), _ends(times))
        amplitudes = [a - e for a, e in zip(amplitudes, explained, strict=True)]
        rest = {
            n: b - taken @ (taken.T @ b) for n, b in left.items() if n not in (best.name, *alike)
        }
        left = {n: o for n, b in rest.items() if (o := _orthonormal(b, SMALL_SHARE)) is not None}
    names = {r.name for r in significant}
    others = sorted((r for n, r in first.items() if n not in names), key=lambda r: -r.share)
    return (*significant, *others), unjudged


def sentences(found: Relations) -> tuple[str, ...]:
    """The significant relations in sentences for the report."""
    if found.pattern is None:
        return ()
    parts = [
        (found.constant, "stays the same in each recording"),
        (found.slow, "drifts slowly"),
        (max(0.0, 1.0 - found.constant - found.slow), "comes and goes faster"),
    ]
    shares = [f"{_percent(s)} of its variance {words}" for s, words in parts if s >= SMALL_SHARE]
    pattern = found.pattern
    turns = ("without a change", "with one change")[pattern.signs] if pattern.signs < 2 else (
        f"with {pattern.signs} changes"
    )  # fmt: skip
    lines = [
        f"From picture to picture {1e3 * found.size:.2g} mm of the residual repeat; "
        f"{', '.join(shares)}. "
        f"One shape along the DLO makes up {_percent(pattern.share)}: largest at "
        f"{1e3 * pattern.place:.0f} mm from the start, {turns} of sign."
    ]
    lines += [_sentence(r) for r in found.significant]
    if not found.significant:
        names = [r.name for r in found.inputs]
        lines.append(
            f"It depends on none of these beyond chance: {', '.join(names)}."
            if names
            else "The residual does not change, or no input varied on which it could depend."
        )
    return tuple(lines)


def _sentence(relation: Relation) -> str:
    often = f"by chance in {100.0 * relation.chance:.1g} % of cases"
    text = (
        f"The residual depends on {relation.name}, which predicts {_percent(relation.share)} of "
        f"the part that does not drift ({often})"
    )
    return f"{text}; so does {' and '.join(relation.alike)}." if relation.alike else f"{text}."


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def _lag_one_sum(field: FloatArray) -> float:
    """Sum of the products of neighbouring frames: the autocovariance times the frames."""
    if len(field) < 2:
        return float(np.sum(field**2)) - field.size
    return float(np.sum(field[1:] * field[:-1])) * len(field) / (len(field) - 1)


def _repeats(fields: Sequence[FloatArray]) -> bool:
    """Whether fields (F, K) in units of the noise repeat from frame to frame beyond chance.

    If they do not, each frame may as well have the other sign, and products of neighbours, too. Of
    a single frame that is noise the squares have the variance of a chi-squared variable.
    """
    total, variance = 0.0, 0.0
    for field in fields:
        if len(field) > 1:
            products = np.sum(field[1:] * field[:-1], axis=1)
            variance += float(products @ products)
        else:
            products = field[0] ** 2 - 1.0
            variance += 2.0 * field.size
        total += float(products.sum())
    return total > float(norm.isf(CHANCE)) * math.sqrt(variance)


def _slow(times: FloatArray, degree: int) -> FloatArray:
    """Orthonormal polynomials of the time, shape (F, degree + 1)."""
    span = max(float(times[-1] - times[0]), 1e-12)
    degree = min(degree, len(times) - 1)
    q, _ = np.linalg.qr(np.polynomial.legendre.legvander((times - times[0]) / span * 2 - 1, degree))
    return np.asarray(q)


def _steady(field: FloatArray, times: FloatArray, degree: int) -> FloatArray:
    """A field (F, K) without its drift."""
    return without(field, _slow(times, degree))


def _basis(varied: Input, times: Sequence[FloatArray]) -> FloatArray | None:
    """Orthonormal columns of an input without its drift in each recording; None: nothing left."""
    scale = np.std(np.concatenate([c - c.mean(axis=0) for c in varied.columns]), axis=0)
    parts = [
        _steady(c, t, SLOW)[:, scale > 0.0] / scale[scale > 0.0]
        for c, t in zip(varied.columns, times, strict=True)
    ]
    columns = np.concatenate(parts)
    return _orthonormal(columns, SMALL_SHARE * np.sqrt(len(columns))) if columns.size else None


def _orthonormal(columns: FloatArray, least: float) -> FloatArray | None:
    left, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    kept = left[:, sizes > least]
    return kept if kept.shape[1] else None


def _ends(times: Sequence[FloatArray]) -> np.ndarray:
    """Rows at which stacked recordings are separated."""
    return np.cumsum([len(t) for t in times])[:-1]


def _moving(fields: Sequence[FloatArray], times: Sequence[FloatArray]) -> list[FloatArray]:
    """Fields without the drift of each recording."""
    return [_steady(f, t, SLOW) for f, t in zip(fields, times, strict=True)]


def _amplitudes(fields: Sequence[FloatArray], times: Sequence[FloatArray]) -> list[FloatArray]:
    """Amplitudes over time of the patterns along u that repeat and move, shape (F, M)."""
    values, vectors = _patterns(_moving(fields, times))
    # Of noise the eigenvalues lie about zero alike, which tells how large its largest is.
    count = int(np.clip(np.sum(values > -values[0]), 1, PATTERNS))
    return [(f - f.mean(axis=0)) @ vectors[:, -count:] for f in fields]


def _patterns(fields: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and patterns along u of the products of neighbouring frames, the largest last."""
    common = np.sum([f[1:].T @ f[:-1] if len(f) > 1 else f.T @ f for f in fields], axis=0)
    values, vectors = np.linalg.eigh(0.5 * (common + common.T))
    return values, vectors


def _predicted_share(field: FloatArray, basis: FloatArray, times: Sequence[FloatArray]) -> float:
    """Share of the power of recordings (or spans) that the other ones predict.

    Noise, which is new in what is predicted, adds nothing on average.
    """
    numbers = np.arange(len(field))
    parts = np.split(numbers, _ends(times)) if len(times) > 1 else np.array_split(numbers, SPANS)
    gain = 0.0
    for part in parts:
        others = np.setdiff1d(numbers, part)
        slope, *_ = np.linalg.lstsq(basis[others], field[others], rcond=1e-6)
        guess = basis[part] @ slope
        gain += float(np.sum(guess * (2.0 * field[part] - guess)))
    return gain


def _pattern(fields: Sequence[FloatArray], total: float, settings: Settings) -> ResidualPattern:
    """The strongest pattern along the DLO of the part that repeats."""
    values, vectors = _patterns(fields)
    n, length = settings.rod.control_points, settings.rod.length
    u = np.linspace(0.0, length, 101)
    back = np.linalg.inv(whitening(n, length)) @ SplineBasis(n, length).matrix(u).T
    curves = vectors[:, -1].reshape(-1, n) @ back  # across, along, out of the plane
    size = np.linalg.norm(curves, axis=0)
    main = curves[int(np.argmax(np.sum(curves**2, axis=1)))]
    clear = main[np.abs(main) > CLEAR * np.abs(main).max()]
    signs = int(np.sum(np.diff(np.sign(clear)) != 0.0))
    frames = sum(len(f) for f in fields)
    common_frames = sum(max(len(f) - 1, 1) for f in fields)
    share = float(values[-1]) * frames / common_frames / total
    return ResidualPattern(float(np.clip(share, 0.0, 1.0)), float(u[int(np.argmax(size))]), signs)
