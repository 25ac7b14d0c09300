# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The joint model's numbers as they are reported: effects, material, set-up, measurement errors."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dlo_ros.diagnosis.explain.cause_naming import Cause
from dlo_ros.diagnosis.findings.diagnosis_outcome import (
    Fitted,
    Number,
    SetupNumber,
)
from dlo_ros.diagnosis.findings.least_std import least_std
from dlo_ros.effects import added_to_damping, damping_effect, effects, quantities
from dlo_ros.identification.force_scale import POWERS, with_scale
from dlo_ros.identification.information import model_shift
from dlo_ros.inference.joint import Evaluation, with_variances
from dlo_ros.inference.parameter import (
    OWN,
    Parameter,
    ParametricModel,
    number_of,
    split_name,
    value_of,
)
from dlo_ros.inference.thresholds import UNBOUNDED
from dlo_ros.inference.widened_covariance import widened_covariance
from dlo_ros.parameters import Settings, tolerance
from dlo_ros.rod.sensitivity_parameters import effect_names
from dlo_ros.rod_settings import RodParameters
from dlo_ros.spline import FloatArray

Doubts = Sequence[Mapping[str, float]]
"""See `Explanation.doubts`."""
UNKNOWN = 1e-12
"""Share of a guess's information that counts in a standard deviation that is reported: none."""


def effect_numbers(
    effect: str, at: Evaluation, given: Settings, widening: Mapping[str, float] | None = None,
    doubts: Doubts = (),
) -> dict[str, Number]:  # fmt: skip
    """Values of an effect's keys with standard deviations.

    Args:
        widening: factors of the std of parameters, see `confirmed_uncertainty`.
        doubts: see `Explanation`.
    """
    spread = dict(zip(at.model.names, outer_stds(at, widening, doubts), strict=True))
    name, _ = added_to_damping().get(effect, ("", ""))
    result = {}
    shown = damping_as_effects(at.model.settings, given, (effect,))
    for key, value in shown.effects[effect].items():
        names = effect_names(effect, key, value)
        stds = [spread.get(n, spread.get(name)) for n in names]
        known = tuple(s for s in stds if s is not None)
        std: float | tuple[float, ...] | None = None
        if len(known) == len(stds):
            std = known if isinstance(value, tuple) else known[0]
        own = {
            n: value_of(at.model.settings, n) for n in spread if OWN in n and number_of(n) in names
        }
        if own:
            std = _of_mean(list(own.values()), [float(spread[n]) for n in own])
        by_recording = {n.partition(OWN)[2]: x for n, x in own.items()}
        std = _no_less(std, effect, key, value, given.rod)
        result[key] = Number(value, std, quantities(effect)[key].unit, by_recording)
    return result


def _of_mean(values: Sequence[float], stds: Sequence[float]) -> float:
    """Standard deviation of the mean of numbers that recordings have of their own, which contains
    how much they differ.
    """
    return math.hypot(float(np.std(values)), *(s / len(stds) for s in stds))


def _no_less(
    std: float | tuple[float, ...] | None, effect: str, key: str,
    value: float | tuple[float, ...], rod: RodParameters,
) -> float | tuple[float, ...] | None:  # fmt: skip
    """Standard deviations of an effect's key with what no shape tells, see `least_std`."""
    if isinstance(std, tuple) and isinstance(value, tuple):
        pairs = zip(std, value, strict=True)
        return tuple(math.hypot(s, least_std(effect, key, v, rod)) for s, v in pairs)
    if isinstance(std, float) and isinstance(value, float):
        return math.hypot(std, least_std(effect, key, value, rod))
    return std


def damping_as_effects(settings: Settings, given: Settings, names: Iterable[str]) -> Settings:
    """Settings that tell a fitted damping as the parameter file's damping and an added effect.

    Args:
        settings: settings with the fitted damping.
        given: the parameter file.
        names: effects as which dampings are reported; others, and effects that the settings contain
            already, are left as they are.
    """
    effects_ = {k: dict(v) for k, v in settings.effects.items()}
    damping = settings.damping
    for effect, (name, key) in added_to_damping().items():
        if effect in names and effect not in effects_:
            before: float = getattr(given.damping, name)
            effects_[effect] = {key: getattr(damping, name) - before}
            changed: dict[str, Any] = {name: before}
            damping = replace(damping, **changed)
    return replace(settings, damping=damping).with_effects(effects_)


def outer_stds(
    at: Evaluation, widening: Mapping[str, float] | None = None, doubts: Doubts = ()
) -> FloatArray:
    """Standard deviations of the values of all parameters, shape (P,): `_covariance_at_scale`.

    Args:
        widening, doubts: see `effect_numbers`.
    """
    spread = _covariance_at_scale(at, widening) + _covariance_of(doubts, at)
    stds = np.sqrt(np.diag(spread))
    pairs = zip(at.model.parameters, stds, at.model.theta(), strict=True)
    return np.array([p.outer_std(x, s) for p, s, x in pairs])


def _covariance_of(doubts: Doubts, at: Evaluation) -> FloatArray:
    """Covariance of a model's parameters by what may or may not act, each by itself, shape (P, P).

    What an effect does to E, it does to the forces that are known as shares of it: to those of a
    cause in the place of which it acts, too.
    """
    shifts = np.array([_shift(at, changes) for changes in doubts])
    shifts = shifts.reshape(-1, len(at.model.names))
    return np.asarray(shifts.T @ shifts)


def _shift(at: Evaluation, changes: Mapping[str, float]) -> FloatArray:
    """Changes of all parameters with those of some, to first order, shape (P,)."""
    guessed = at.model.parameters[at.model.index("density")].guessed
    scale = changes.get("density", 0.0) if guessed else 0.0
    rows = zip(at.model.parameters, at.model.theta(), _forces(at), strict=True)
    sizes = [POWERS[p.unit] * (1.0 if p.logarithmic else x) if f else 0.0 for p, x, f in rows]
    pairs = zip(at.model.names, sizes, strict=True)
    return np.array([changes.get(name, scale * size) for name, size in pairs])


def reported_covariance(
    at: Evaluation, widening: Mapping[str, float] | None = None, doubts: Doubts = ()
) -> FloatArray:
    """Covariance in which guesses count for nothing, and the recordings' disagreement does, shape
    (P, P).

    With a guessed density nor do the sizes that the forces of causes mostly have.

    Args:
        widening, doubts: see `effect_numbers`.
    """
    guessed = np.array([p.guessed for p in at.model.parameters])
    if guessed[at.model.index("density")]:
        guessed |= _forces(at)
    known = _covariance(at, np.where(guessed, UNKNOWN, 1.0), widening)
    return known + _covariance_of(doubts, at)


def _covariance_at_scale(at: Evaluation, widening: Mapping[str, float] | None = None) -> FloatArray:
    """The reported covariance, but with a scale of all forces in any case, shape (P, P).

    Where nothing tells how large forces are, those of an effect are known as well as the guesses of
    density and dampings are, whose tolerances are factors of two and three.
    """
    spread = reported_covariance(at, widening)
    if not _of_any_scale(at, spread):
        return spread
    return _covariance(at, np.where(_forces(at), UNKNOWN, 1.0), widening)


def _covariance(
    at: Evaluation, counted: FloatArray, widening: Mapping[str, float] | None
) -> FloatArray:
    """Covariance with a share of each prior's information, shape (P, P)."""
    factors = np.array([(widening or {}).get(n, 1.0) for n in at.model.names])
    precision = counted * at.model.precision()
    spread = widened_covariance(at.spectra, at.variances, at.model.offset(), precision)
    return np.asarray(spread * np.outer(factors, factors))


def _forces(at: Evaluation) -> NDArray[np.bool_]:
    """Parameters that are as large as all forces, and that nobody has stated, shape (P,)."""
    return np.array([p.unit in POWERS and not p.tolerated and bool(p.effect)
                     for p in at.model.parameters])  # fmt: skip


def _of_any_scale(at: Evaluation, covariance: FloatArray) -> bool:
    """Whether all forces may be larger or smaller together: see `force_scale`.

    Args:
        covariance: the reported one.
    """
    k = at.model.index("density")
    return bool(at.model.parameters[k].guessed and covariance[k, k] >= UNBOUNDED**2)


def at_guessed_scale(at: Evaluation) -> Evaluation:
    """The model with the scale of all forces that the guesses of its material say.

    Where nothing tells that scale, a fit has it from the sizes that the forces of causes mostly
    have, too: of a drag twelve times its usual size, a DLO three times too light.
    """
    if not _of_any_scale(at, reported_covariance(at)):
        return at
    model, guessed = at.model, np.array([p.guessed for p in at.model.parameters])
    way = _at_scale(model, 1.0).theta() - model.theta()  # of logarithms, as guesses are
    counted = guessed * model.precision() * way
    step = float(counted @ model.offset() / (counted @ way))
    scaled = [
        1.0 if p.logarithmic else math.exp(step * POWERS.get(p.unit, 0.0)) for p in model.parameters
    ]
    fields = tuple((left, slopes / np.array(scaled)[:, None]) for left, slopes in at.fields)
    return with_variances(replace(at, model=_at_scale(model, step), fields=fields), at.variances)


def _at_scale(model: ParametricModel, log: float) -> ParametricModel:
    """The model with all forces multiplied by exp(log)."""
    return replace(model, settings=with_scale(model.settings, log))


def fitted_material(
    at: Evaluation, err_train: float | None, err_holdout: float | None, widening: float = 1.0,
    doubts: Doubts = (),
) -> Fitted:  # fmt: skip
    """The material with standard deviations, and errors [m].

    Args:
        widening: factor of the std, see `confirmed_uncertainty`.
        doubts: see `Explanation`.
    """
    spread, rod = widening**2 * reported_covariance(at), at.model.settings.rod
    spread = spread + _covariance_of(doubts, at)
    stiffness_error = float(model_shift(at.model.settings, usual=True)[0])
    modulus, density = at.model.axis("young_modulus"), at.model.axis("density")
    scale_std = widening * math.sqrt(float(density @ _covariance_at_scale(at) @ density))

    def of_data(axis: FloatArray) -> float:
        return math.sqrt(max(float(axis @ spread @ axis), 0.0))

    def known(value: float, axis: FloatArray) -> tuple[float, float | None]:
        std = math.hypot(of_data(axis), stiffness_error * float(axis @ modulus))
        return value, value * std if std < UNBOUNDED else None

    return Fitted(
        at.model.settings, known(rod.young_modulus, modulus), known(rod.density, density),
        known(rod.specific_modulus, modulus - density), err_train, err_holdout, scale_std,
    )  # fmt: skip


def plain_material(plain: Settings, err_train: float | None, err_holdout: float | None) -> Fitted:
    """The plain model, without standard deviations, which mean nothing where it is wrong."""
    rod = plain.rod
    return Fitted(
        plain, (rod.young_modulus, None), (rod.density, None),
        (rod.specific_modulus, None), err_train, err_holdout,
    )  # fmt: skip


def with_plain_values(fitted: Fitted, plain: Settings) -> Fitted:
    """A fitted model with the plain model's values, which are known no better."""
    rod = plain.rod

    def known(value: float, before: tuple[float, float | None]) -> tuple[float, float | None]:
        centre, std = before
        return value, None if std is None else std * value / centre

    return replace(
        fitted,
        settings=plain,
        young_modulus=known(rod.young_modulus, fitted.young_modulus),
        density=known(rod.density, fitted.density),
        specific_modulus=known(rod.specific_modulus, fitted.specific_modulus),
    )


def set_up_numbers(
    at: Evaluation, causes: Sequence[Cause], given: Settings, doubts: Doubts = ()
) -> dict[str, SetupNumber]:
    """Numbers that were fitted and are no cause, by effect and key.

    These are those of the set-up; the dampings, as what their effects would add to those of the
    parameter file; and those of effects which the model contains without their being certain. Of a
    moment that each recording has of its own it is the mean.

    Args:
        doubts: see `effect_numbers`.
    """
    named = {name for c in causes for name in c.names}
    covariance = reported_covariance(at)
    spread = np.sqrt(np.diag(covariance))
    density = at.model.index("density")
    held = covariance[:, density] / spread[density]
    doubt = np.sqrt(np.diag(_covariance_of(doubts, at)))
    held = np.hypot(np.sqrt(np.maximum(spread**2 - held**2, 0.0)), doubt)
    spread = np.hypot(spread, doubt)
    result: dict[str, SetupNumber] = {}
    own: dict[str, list[SetupNumber]] = {}
    for p, x, s, h in zip(at.model.parameters, at.model.theta(), spread, held, strict=True):
        if p.name in named or p.name in ("young_modulus", "density"):
            continue
        name, value, effect = f"{p.effect}.{p.key}", p.outer(x), p.effect
        if effect:
            key = split_name(p.name)[1]
        else:
            effect = damping_effect(p.name)
            key = added_to_damping()[effect][1]
            name = f"{effect}.{key}"
            if effect in at.model.settings.effects:
                continue  # what is added stands there
            value -= getattr(given.damping, p.name)
        least = least_std(effect, key, value, given.rod)
        std, held_std = (
            None if p.logarithmic and v >= UNBOUNDED
            else math.hypot(p.outer_std(x, float(v)), least)
            for v in (s, h)
        )  # fmt: skip
        result[name] = SetupNumber(
            value, std, _tolerance(p, given), p.unit, held_std if std is None else None
        )
        if OWN in p.name:
            own.setdefault(name, []).append(result[name])
    return result | {name: _mean_number(numbers) for name, numbers in own.items()}


def _mean_number(numbers: Sequence[SetupNumber]) -> SetupNumber:
    """The mean of a number that recordings have of their own."""
    values = [n.value for n in numbers]
    std, held = (
        None if None in stds else _of_mean(values, [s for s in stds if s is not None])
        for stds in ([n.std for n in numbers], [n.held_std for n in numbers])
    )
    return replace(numbers[0], value=float(np.mean(values)), std=std, held_std=held)


def _tolerance(p: Parameter, given: Settings) -> float | None:
    """Tolerance in the parameter's own unit; None of what is guessed, or is no part of a set-up."""
    if p.tolerated or (not p.effect and not p.guessed):
        return p.outer_std(p.centre, p.std)
    effect, key, _ = split_name(p.name)
    stated = f"{effect}.{key}" in given.tolerances
    if not p.effect or not (stated or effects()[p.effect].in_setup):
        return None
    width = tolerance(given, f"{effect}.{key}")
    return None if width is None else p.outer_std(p.inner(quantities(effect)[key].neutral), width)


def systematic_errors(at: Evaluation) -> dict[str, Number]:
    """Errors of the measurement and of the model, as root mean squares along the DLO [m]."""
    parts = ("across", "along", "out_of_plane")
    result = {}
    for kind in ("white", "nodal", "lasting", "rough", "shared", "shared_rough", "fading"):
        rows = np.array([getattr(v, kind) for v in at.variances])
        for part, value in zip(parts, np.sqrt(rows.mean(axis=0)), strict=False):
            name = "discrepancy" if kind == "fading" else f"{kind}_error"
            result[f"{name}_{part}"] = Number(float(value), None, "m")
    return result
