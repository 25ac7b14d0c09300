# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The output of `identify`: estimate.json, the terminal's lines, the report."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from dlo_ros.cli.effect_words import bare, clause, label, off_by, spread
from dlo_ros.cli.loads import borne
from dlo_ros.cli.results import QUANTITIES
from dlo_ros.effects import quantities
from dlo_ros.identification.estimate import COMBINATIONS, correlations
from dlo_ros.identification.force_scale import words as force_words
from dlo_ros.identification.identifiability import (
    enumerated,
    knowledge,
    rounded,
    sentences,
)
from dlo_ros.identification.offline.posterior_sampling import Sample
from dlo_ros.identification.offline.recording_identification import Identification
from dlo_ros.inference.forecast import Forecast, Manipulation
from dlo_ros.inference.parameter import split_name
from dlo_ros.inference.thresholds import CERTAIN, SMALL_SHARE
from dlo_ros.parameters import EFFECTS_PREFIX, Settings
from dlo_ros.report import (
    EstimateRow as ReportedEstimate,
)
from dlo_ros.report import (
    IdentificationReport,
    RecordingRow,
    ShapeFrame,
)
from dlo_ros.report.elements import measured, millimetres, number
from dlo_ros.report.shape_player import MOST_FRAMES
from dlo_ros.report.uncertainty import Ellipse, ResidualMap
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray, SplineBasis

ROLES = {"train": "used for the fit", "validate": "not used"}
PLACES = 24  # along the DLO, in the map of residuals
MODEL_ERROR_RATIO = 2.0  # ERR over the noise floor beyond which the model misses something
PAIRS = (
    ("young_modulus", "density"),
    ("specific_modulus", "specific_drag"),
    ("specific_modulus", "relaxation_time"),
)
"""Quantities whose common uncertainty is drawn."""
LEAST_VARIANCE = 1e-14  # of a logarithm: what is stated to be exact has no ellipse


def tree(
    found: Identification, sampled: Sample | None = None, redrawn: FloatArray | None = None
) -> dict[str, Any]:
    """The contents of estimate.json (interface.md).

    Args:
        found: the result.
        sampled: samples of the posterior, where they were asked for.
        redrawn: logarithms of a bootstrap over recordings, shape (B, 4), where asked for.
    """
    estimate = found.estimate
    result: dict[str, Any] = {
        name: {"value": getattr(estimate, name), "std": getattr(estimate, f"{name}_std")}
        for name, _, _ in QUANTITIES
    }
    result["identifiable"] = dict(estimate.identifiable)
    result["noise_floor"] = found.noise_floor
    result["recordings"] = [
        {"bag": r.name, "role": r.role, "err": r.err, "err_initial": r.err_initial}
        for r in found.recordings
    ]
    matrix = found.fitted.information
    result["statement"] = sentences(estimate, matrix)
    result["knowledge"] = {
        k.name: {"source": k.source, "data_std": k.data_std, "std": k.std}
        for k in knowledge(estimate, matrix)
    }
    result["traded"] = [list(pair) for pair in estimate.traded]
    pairs = correlations(estimate.covariance).items()
    result["correlation"] = {f"{a},{b}": v for (a, b), v in pairs}
    # Of the logarithms: `design --estimate` takes it as known.
    result["information"] = {"parameters": list(MATERIAL), "matrix": matrix.tolist()}
    result["damping"] = {
        "air_drag": estimate.settings.damping.air_drag,
        "relaxation_time": estimate.settings.damping.relaxation_time,
    }
    result["setup"] = {
        name.removeprefix(EFFECTS_PREFIX): {"value": v, "std": std, "unit": _unit(name)}
        for name, (v, std) in found.fitted.set_up.items()
    }
    result["alternatives"] = [
        {
            "effect": a.effect, "parameters": dict(a.values),
            "specific_modulus": a.specific_modulus,
        }
        for a in found.fitted.alternatives
    ]  # fmt: skip
    forces = found.forces
    if forces is not None:
        result["wrench"] = {
            "messages": forces.messages,
            "density_std": dict(
                zip(("all", "from_change", "from_mean"), forces.scale.relative, strict=True)
            ),
            "left": {
                name: {"force": force, "torque": torque}
                for name, (force, torque) in forces.scale.left.items()
            },
        }
    if sampled is not None:
        result["posterior"] = {
            "effective_samples": sampled.effective,
            **{
                name: dict(zip(("low", "median", "high"), sampled.quantiles(name), strict=True))
                for name, _, _ in QUANTITIES
                # Where nothing is known the spread would be that of the guess.
                if getattr(estimate, f"{name}_std") is not None
            },
        }
    if redrawn is not None:
        spread = _spread(redrawn[:, 0] - redrawn[:, 1], estimate.specific_modulus)
        result["bootstrap"] = {"draws": len(redrawn), "specific_modulus": spread}
    return result


def _spread(logarithms: FloatArray, value: float) -> dict[str, float | None]:
    """Spread of a quantity over draws; null where fewer than two of them could be fitted.

    Args:
        logarithms: its logarithm in each of B draws, shape (B,).
        value: the quantity.
    """
    if len(logarithms) < 2:
        return dict.fromkeys(("std", "low", "high"))
    return {
        "std": float(np.std(logarithms, ddof=1) * value),
        "low": float(np.exp(np.quantile(logarithms, 0.025))),
        "high": float(np.exp(np.quantile(logarithms, 0.975))),
    }


def summary(found: Identification) -> list[str]:
    """The result for the terminal."""
    lines = []
    for name, words, unit in QUANTITIES:
        value, std = getattr(found.estimate, name), getattr(found.estimate, f"{name}_std")
        shown = f"{number(value)} +- unknown {unit}" if std is None else measured(value, std, unit)
        known = ""
        if not found.estimate.identifiable[name]:
            prior = std is not None and found.estimate.settings.rod.density_std > 0.0
            known = " (with density_std)" if prior else " (not determined by the recordings)"
        lines.append(f"{words}: {shown}{known}")
    for r in found.recordings:
        before = "unknown" if r.err_initial is None else f"{1e3 * r.err_initial:.2f} mm"
        after = "unknown" if r.err is None else f"{1e3 * r.err:.2f} mm"
        lines.append(
            f"{r.name} ({ROLES[r.role]}): the simulation is {before} off with the guess, {after} "
            "with the estimate (mean distance, ERR)"
        )
    lines += force_sentences(found) + alternative_sentences(found)
    return lines + _set_up(found) + _of_the_fit(found) + _model_errors(found)


def _headline(found: Identification) -> str:
    """The result in a line: E/mu, and how far off the simulation is with it."""
    line = summary(found)[len(QUANTITIES) - 1] + "."
    unused = [r for r in found.recordings if r.role == "validate"]
    errors = [r.err for r in unused or found.recordings if r.err is not None]
    if not errors:
        return line
    where = "recordings that were not used" if unused else "the recordings that it was fitted to"
    return f"{line} The simulation is {millimetres(sum(errors) / len(errors), 2)} off on {where}."


def _unit(name: str) -> str:
    """Unit of a number of the set-up."""
    effect, key, _ = split_name(name)
    return quantities(effect)[key].unit


def _set_up(found: Identification) -> list[str]:
    """Sentences on the numbers of the set-up that are off."""
    numbers = found.fitted.set_up
    if not numbers:
        return []
    counts = Counter(split_name(name)[:2] for name in numbers)
    off: dict[str, str] = {}
    for name, (value, std) in numbers.items():
        effect, key, index = split_name(name)
        q, count = quantities(effect)[key], counts[effect, key]
        if abs(value - q.neutral) <= CERTAIN * std:
            continue
        if index is not None and not q.counts:  # one of several along the DLO
            parameter = f"{effect}.{key}"
            values = [v for n, (v, _) in numbers.items() if split_name(n)[:2] == (effect, key)]
            span = spread(min(values), max(values), q.unit, q)
            off[parameter] = f"{label(parameter)} {span} along the DLO"
        else:
            words = label(name.removeprefix(EFFECTS_PREFIX), count)
            off[name] = f"{words} {off_by(value, std, effect, key, index, count)}"
    said = f": {'; '.join(off.values())}" if off else ", though no single number is off for certain"
    return [
        f"The set-up is not exactly what the parameter file says{said}. All its numbers, as "
        "fitted, stand in estimate.yaml as effects."
    ]


def force_sentences(found: Identification) -> list[str]:
    """A sentence on what measured forces determine, and by which of their parts."""
    forces = found.forces
    return [] if forces is None else [force_words(forces.scale.relative, forces.messages)]


def alternative_sentences(found: Identification) -> list[str]:
    """Sentences on effects that the identified material rather stands for, with another E/mu.

    Where it hardly is another one, the standard deviations say all.
    """
    result = []
    for other in found.fitted.alternatives:
        if abs(math.log(other.specific_modulus / found.estimate.specific_modulus)) < SMALL_SHARE:
            continue
        known = quantities(other.effect)
        values = ", ".join(
            f"{key} {bare(v, known[key].unit)}"
            for key, v in other.values.items() if isinstance(v, float)
        )  # fmt: skip
        result.append(
            f"A model in which {clause(other.effect)} ({values}) explains the recordings better; "
            f"there E/mu is {rounded(other.specific_modulus)} m^2/s^2, and the standard deviations "
            "here allow for it. `diagnose` tells what else the recordings show."
        )
    return result


def remarks(found: Identification) -> list[str]:
    """Sentences on what the recordings determine and what they do not."""
    result = sentences(found.estimate, found.fitted.information)
    result += force_sentences(found)
    result += alternative_sentences(found)
    result += _set_up(found) + _of_the_fit(found) + _model_errors(found)
    if found.fitted.error > 0.0:
        result.append(f"The simulation's own error is {rounded(1e3 * found.fitted.error)} mm.")
    return result


def _of_the_fit(found: Identification) -> list[str]:
    """Sentences on a fit that has not ended, and on pictures that do not count in it."""
    result = []
    if not found.fitted.converged:
        result.append("The fit has not converged; the numbers are where it stopped.")
    left_out = sum(found.fitted.left_out)
    if left_out:
        result.append(
            "1 picture deviates grossly and does not count in the fit."
            if left_out == 1
            else f"{left_out} pictures deviate grossly and do not count in the fit."
        )
    return result


def _model_errors(found: Identification) -> list[str]:
    """A sentence on the recordings that are farther off than their noise."""
    far = [
        (r.name, r.err / r.noise_floor)
        for r in found.recordings
        if r.err is not None
        and r.noise_floor is not None
        and r.err > MODEL_ERROR_RATIO * r.noise_floor
    ]
    if not far:
        return []
    times = enumerated([f"{number(ratio, digits=2)} times ({name})" for name, ratio in far])
    return [
        f"ERR is {times} what the noise from picture to picture would give. Something else is at "
        "work, and the numbers above absorb a part of it; `diagnose` looks for it."
    ]


def report(
    settings: Settings, found: Identification, recordings: Sequence[Manipulation]
) -> IdentificationReport:
    """The report for a person.

    Args:
        settings: the initial guess.
        found: the result, recordings in the order given here.
        recordings: the recordings that the estimate comes from.
    """
    estimate = found.estimate
    length = settings.rod.length
    ellipses, not_drawn = _ellipses(found)
    return IdentificationReport(
        title="Identification from recordings",
        headline=_headline(found),
        estimates=tuple(
            ReportedEstimate(
                words,
                unit,
                getattr(estimate, name),
                getattr(estimate, f"{name}_std"),
                identifiable=estimate.identifiable[name],
            )
            for name, words, unit in QUANTITIES
        ),
        recordings=tuple(
            RecordingRow(
                r.name, r.role, length, r.err_initial, r.err,
                _frames(r.forecast, measured, r.before), _residuals(r.forecast, measured, length),
            )
            for r, measured in zip(found.recordings, recordings, strict=True)
        ),
        noise_floor=found.noise_floor,
        remarks=tuple(remarks(found)),
        ellipses=tuple(ellipses),
        not_drawn=tuple(not_drawn),
        loads=borne(recordings, estimate.settings),
        cameras=settings.camera_positions,
        explained=True,
    )  # fmt: skip


def _frames(
    forecast: Forecast | None, measured: Manipulation, before: Forecast | None
) -> tuple[ShapeFrame, ...]:
    if forecast is None:
        return ()
    observed = {o.stamp: o.control_points for o in measured.observations}
    first = {} if before is None else dict(zip(before.stamps, before.predicted, strict=True))
    stamps = forecast.stamps
    every = max(1, len(stamps) // MOST_FRAMES)
    return tuple(
        ShapeFrame(
            (int(stamps[k]) - int(stamps[0])) * 1e-9,
            observed[int(stamps[k])],
            forecast.predicted[k],
            initial=first.get(stamps[k]),
            err=float(forecast.err[k]),
        )
        for k in range(0, len(stamps), every)
    )


def _residuals(
    forecast: Forecast | None, measured: Manipulation, length: float
) -> ResidualMap | None:
    if forecast is None or len(forecast.stamps) < 2:
        return None
    observed = {o.stamp: o.control_points for o in measured.observations}
    shapes = np.array([observed[int(s)][:, :3] for s in forecast.stamps])
    basis = SplineBasis(shapes.shape[1], length)
    u = np.linspace(0.0, length, PLACES)
    gap = basis.matrix(u) @ (shapes - forecast.predicted[:, :, :3])
    slope = basis.matrix(u, 1) @ forecast.predicted[:, :, :3]
    times = (forecast.stamps - forecast.stamps[0]) * 1e-9
    if np.any(shapes[..., 1]):  # in space no side is the left one
        speed = np.maximum(np.linalg.norm(slope, axis=2, keepdims=True), 1e-12)
        across = np.linalg.norm(np.cross(gap, slope / speed), axis=2)
        return ResidualMap(times, across, signed=False)
    # To the left of growing u as the camera sees it, in the board's plane.
    left = np.stack([-slope[:, :, 2], np.zeros(slope.shape[:2]), slope[:, :, 0]], axis=2)
    left /= np.maximum(np.linalg.norm(left, axis=2, keepdims=True), 1e-12)
    return ResidualMap(times, np.sum(gap * left, axis=2))


def _ellipses(found: Identification) -> tuple[list[Ellipse], list[str]]:
    """Ellipses of E/mu beside each damping and of E beside mu, and sentences on those not drawn.

    A guess, as the remarks call it, has no uncertainty that could be drawn.
    """
    known = {k.name: k for k in knowledge(found.estimate, found.fitted.information)}
    result = []
    left_out: dict[str, list[str]] = {}
    for pair in PAIRS:
        if not all(name in known for name in pair):
            continue  # a damping of zero, which is not fitted
        words = (known[pair[0]].words, known[pair[1]].words)
        guesses = [known[name].words for name in pair if known[name].source == "guess"]
        if guesses:
            left_out.setdefault(enumerated(guesses), []).append(" beside ".join(words))
            continue
        rows = np.array([COMBINATIONS[name] for name in pair])
        covariance = rows @ found.estimate.covariance @ rows.T
        if np.all(np.diag(covariance) > LEAST_VARIANCE):
            result.append(Ellipse(words, covariance))
    return result, [
        f"Not drawn: {enumerated(pairs)}, since these data do not determine {unknown}."
        for unknown, pairs in left_out.items()
    ]
