# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Knowledge of a cable's numbers: intervals, and draws of plausible cables."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dlo_ros.effects import build, quantities
from dlo_ros.errors import InputError
from dlo_ros.identification.estimate import known_information, logarithms, with_logarithms
from dlo_ros.parameters import EFFECTS_PREFIX, Settings
from dlo_ros.rod.sensitivity_parameters import effect_names
from dlo_ros.spline import FloatArray

UNKNOWN_STD = np.array([1.0, 0.3, 1.0, 1.0])
"""Standard deviations of the logarithms of E, mu and both dampings where nobody knows them: E by a
factor of three, the density by a third, dampings by a factor of three, to stay plausible."""
RATIO = np.array([1.0, -1.0, 0.0, 0.0])  # E/mu among the logarithms
TWO_SIDED = 1.96  # standard deviations to each side of a 95 % interval
SEED = 22  # of the draws: the same call gives the same cables


@dataclass(frozen=True)
class ParameterKnowledge:
    """Knowledge of the material and of the rod's other numbers.

    Args:
        covariance: covariance of the logarithms of `sensitivity_parameters.MATERIAL`, shape (4, 4).
        determined: whether recordings or the parameter file contain information on E.
        numbers: standard deviation of effects' numbers, by effect and key.
    """

    covariance: FloatArray
    determined: bool
    numbers: dict[tuple[str, str], FloatArray]

    @property
    def ratio_std(self) -> float:
        """Relative standard deviation of E/mu."""
        return math.sqrt(max(float(RATIO @ self.covariance @ RATIO), 0.0))


def read_knowledge(settings: Settings, estimate: Path | None) -> ParameterKnowledge:
    """The knowledge in estimate.json, or in the parameter file's standard deviations without it.

    Raises:
        InputError: the file is no estimate.json of `identify`.
    """
    information = known_information(settings, weighed=True)
    data = np.zeros((4, 4))
    set_up: dict[str, Any] = {}
    if estimate is not None:
        try:
            tree = json.loads(estimate.read_text())
            data = np.array(tree["information"]["matrix"], dtype=np.float64)
            set_up = dict(tree.get("setup", {}))
        except OSError as err:
            raise InputError(f"{estimate}: cannot be read ({err.strerror})") from err
        except (ValueError, KeyError, TypeError) as err:
            raise InputError(f"{estimate}: is no estimate.json of identify") from err
        if data.shape != (4, 4) or not np.all(np.isfinite(data)):
            raise InputError(f"{estimate}: its information is no matrix of four by four numbers")
    rod = settings.rod
    if estimate is None and rod.specific_modulus_std > 0.0:  # as identify writes it
        along = rod.specific_modulus / rod.specific_modulus_std * RATIO
        data = np.outer(along, along)
    whole = information + data + np.diag(UNKNOWN_STD**-2)
    absent = ~np.isfinite(logarithms(settings))  # a damping of zero stays what it is
    whole[np.ix_(absent, absent)] += 1e12 * np.eye(int(absent.sum()))
    return ParameterKnowledge(
        np.asarray(np.linalg.inv(whole), dtype=np.float64),
        bool(data.any()),
        _numbers(settings, set_up),
    )


def _numbers(settings: Settings, set_up: dict[str, Any]) -> dict[tuple[str, str], FloatArray]:
    """Standard deviations of the numbers of effects that the model contains."""
    found: dict[tuple[str, str], FloatArray] = {}
    for effect, keys in settings.effects.items():
        for key, value in keys.items():
            beforehand = settings.tolerances.get(f"{effect}.{key}")
            names = (n.removeprefix(EFFECTS_PREFIX) for n in effect_names(effect, key, value))
            of_all = set_up.get(f"{effect}.{key}", {})
            stated = [set_up.get(name, of_all) for name in names]
            stds = [s.get("std", beforehand) if isinstance(s, dict) else beforehand for s in stated]
            if any(std is not None for std in stds):
                known = np.array([std or 0.0 for std in stds], dtype=np.float64)
                found[effect, key] = known.reshape(np.shape(value))
    return found


def statement(settings: Settings, known: ParameterKnowledge) -> str:
    """E/mu with its 95 % interval, as a sentence."""
    ratio, spread = settings.rod.specific_modulus, TWO_SIDED * known.ratio_std
    if not known.determined:
        return (
            f"E/mu is {ratio:.4g} m^2/s^2; its uncertainty is not given "
            "(--estimate estimate.json gives it)"
        )
    low, high = ratio * math.exp(-spread), ratio * math.exp(spread)
    return f"E/mu is {ratio:.4g} m^2/s^2; 95 % interval {low:.4g} to {high:.4g} m^2/s^2"


def draw(settings: Settings, known: ParameterKnowledge) -> Iterator[Settings]:
    """Plausible cables without end, independent of each other and the same in every call.

    Numbers of effects that a cable does not have, as those of a camera, stay out.
    """
    random = np.random.default_rng(SEED)
    centre = logarithms(settings)
    present = np.isfinite(centre)
    while True:
        away = random.multivariate_normal(np.zeros(4), known.covariance)
        theta = np.where(present, centre + away, centre)
        effects = {name: dict(keys) for name, keys in settings.effects.items()}
        for (effect, key), std in known.numbers.items():
            if effect not in effects:
                continue
            q = quantities(effect)[key]
            value = np.asarray(effects[effect][key]) + std * random.normal(size=np.shape(std))
            value = np.clip(value, q.lower, q.upper)
            effects[effect][key] = tuple(value.tolist()) if value.ndim else float(value)
        yield replace(with_logarithms(settings, theta), effects=effects)


def described(settings: Settings) -> tuple[str, ...]:
    """The numbers of a cable, one line each."""
    rod, damping = settings.rod, settings.damping
    lines = [
        f"length {rod.length:g} m, diameter {rod.diameter:g} m",
        f"Young's modulus {rod.young_modulus:.5g} Pa, density {rod.density:.5g} kg/m^3, "
        f"Poisson's ratio {rod.poisson_ratio:g}",
        f"air drag {damping.air_drag:.4g} N s/m^2, relaxation time {damping.relaxation_time:.4g} s",
    ]
    for effect in build(settings.effects):
        keys = settings.effects[effect.name]
        values = ", ".join(f"{key} {_number(value)}" for key, value in keys.items())
        lines.append(f"{effect.called()}: {values}")
    return tuple(lines)


def _number(value: float | tuple[float, ...]) -> str:
    return " ".join(f"{v:.4g}" for v in np.atleast_1d(value))
