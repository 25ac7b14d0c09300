# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fitted numbers with their standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.diagnosis.findings.diagnosis_outcome import Fitted, Number, SetupNumber
from dlo_ros.diagnosis.fitting.candidate_model import logarithmic, names
from dlo_ros.diagnosis.fitting.evaluation import CandidateEvaluation, evaluate
from dlo_ros.diagnosis.fitting.levenberg_marquardt import known, solve, total
from dlo_ros.effects import added_to_damping, quantities
from dlo_ros.errors import SimulationError
from dlo_ros.identification.estimate import UNBOUNDED
from dlo_ros.identification.residual_information import model_shifts
from dlo_ros.identification.residual_noise import correlation_length
from dlo_ros.inference.measured import Recording
from dlo_ros.parameters import Settings
from dlo_ros.spline import DEGREE, FloatArray

FINER, SHORTER = 2, 10.0
"""Times the knot spans, and smaller time steps' tolerance, that tell of the simulation's error."""


def own_error(
    at: CandidateEvaluation, recordings: Sequence[Recording], given: Settings
) -> FloatArray:
    """Change of the open parameters that a finer simulation would cause, shape (P,)."""
    assert at.jacobians is not None
    finer = [_finer(r, given) for r in recordings]
    try:
        fine = evaluate(at.model, finer, given, derivatives=False)
    except SimulationError:
        return np.zeros(len(at.model.free))
    gradient = np.zeros(len(at.model.free))
    for jacobian, here, there in zip(at.jacobians, at.residuals, fine.residuals, strict=True):
        gradient += np.einsum("fpk,fk->p", jacobian, there - here) / at.excess
    most = at.model.natural()
    return np.clip(solve(total(at, given).hessian, gradient), -most, most)


def _finer(recording: Recording, given: Settings) -> Recording:
    spans = recording.spans or recording.observed.shape[1] - DEGREE
    tolerance = recording.tolerance or given.simulation.tolerance
    return replace(recording, spans=FINER * spans, tolerance=tolerance / SHORTER)


def covariance(
    at: CandidateEvaluation, given: Settings, own: FloatArray | None = None
) -> FloatArray:
    """Covariance of the open parameters in the units of the fit, shape (P, P).

    Residuals count as noise, model errors included. What repeats in time counts once; what all
    pictures of a recording have in common counts fully, however small it is.

    Args:
        own: see `own_error`; it does not shrink with the number of pictures.
    """
    autocorrelation_time = correlation_length([r[:, :, None] for r in at.residuals], 0)
    common = [len(r) * float(np.mean(r.mean(axis=0) ** 2)) for r in at.residuals]
    autocorrelation_time = max(autocorrelation_time, float(np.mean(common)) / at.excess)
    beforehand = known(at.model, given).hessian
    information = (total(at, given).hessian - beforehand) / autocorrelation_time + beforehand
    spread = solve(information, np.eye(len(information)))
    return spread if own is None else spread + np.outer(own, own)


def fitted(
    at: CandidateEvaluation, given: Settings, err_train: float | None, err_holdout: float | None,
    own: FloatArray | None = None,
) -> Fitted:  # fmt: skip
    """A model's material, with standard deviations, and its errors [m].

    Args:
        own: see `own_error`.
    """
    spread = covariance(at, given, own)
    rod = at.model.settings.rod
    free = at.model.free
    modulus = np.array([name == "young_modulus" for name in free], dtype=np.float64)
    density = np.array([name == "density" for name in free], dtype=np.float64)
    # Errors of ln E that no residual shows: of the rod theory, and of the stated diameter.
    of_stiffness = float(np.linalg.norm(model_shifts(at.model.settings, 1)))
    result: list[tuple[float, float | None]] = []
    for value, c in (
        (rod.young_modulus, modulus),
        (rod.density, density),
        (rod.specific_modulus, modulus - density),
    ):
        std = float(
            np.hypot(np.sqrt(max(float(c @ spread @ c), 0.0)), of_stiffness * (c @ modulus))
        )
        result.append((value, value * std if std < UNBOUNDED else None))
    settings = at.model.settings
    return Fitted(settings, result[0], result[1], result[2], err_train, err_holdout)


def damping_numbers(
    at: CandidateEvaluation, given: Settings, own: FloatArray | None = None
) -> dict[str, SetupNumber]:
    """Fitted dampings that are no cause, as what their effects would add to the parameter file's.

    Args:
        own: see `own_error`.
    """
    free, spread = at.model.free, covariance(at, given, own)
    density = free.index("density") if "density" in free else None
    result = {}
    for effect, (name, key) in added_to_damping().items():
        if name not in free or effect in at.model.settings.effects:
            continue
        k = free.index(name)
        of_density = 0.0 if density is None else spread[k, density] ** 2 / spread[density, density]
        value, before = (getattr(s.damping, name) for s in (at.model.settings, given))
        std, held_std = (
            float(value * np.sqrt(v)) if v < UNBOUNDED**2 else None
            for v in (spread[k, k], max(spread[k, k] - of_density, 0.0))
        )
        stated: float = getattr(given.damping, f"{name}_std")
        result[f"{effect}.{key}"] = SetupNumber(
            value - before, std, stated or None, quantities(effect)[key].unit,
            held_std if std is None else None,
        )  # fmt: skip
    return result


def numbers(
    at: CandidateEvaluation,
    effect: str,
    given: Settings,
    alike: Sequence[CandidateEvaluation] = (),
    own: FloatArray | None = None,
) -> dict[str, Number]:
    """The values of an effect's keys.

    Args:
        alike: other fits of the same parameters that explain the data as well: the standard
            deviations reach them.
        own: see `own_error`.
    """
    spread = np.sqrt(np.maximum(np.diag(covariance(at, given, own)), 0.0))
    for other in alike:
        if other.model.free == at.model.free:
            spread = np.maximum(spread, np.abs(other.model.theta() - at.model.theta()))
    block = at.model.settings.effects[effect]
    described = quantities(effect)
    result: dict[str, Number] = {}
    for key, value in block.items():
        found = []
        for name, v in zip(
            names(effect, block, (key,)), value if isinstance(value, tuple) else (value,),
            strict=True,
        ):  # fmt: skip
            if name in at.model.free:
                std = float(spread[at.model.free.index(name)])
                found.append(std * abs(v) if logarithmic(name) else std)
        spreads: float | tuple[float, ...] | None = None
        if found:
            spreads = tuple(found) if isinstance(value, tuple) else found[0]
        result[key] = Number(value, spreads, described[key].unit)
    return result
