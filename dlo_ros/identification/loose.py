# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What is known only about as well as it was set up: clamps' directions, level, length.

Nobody measures to a degree how a wire leaves its clamp, and a shape held at both ends shows it:
left out, it is laid to E/mu. So these numbers may be fitted along with E and mu, about zero and
with the standard deviation that they are known to; what they take from the information on E and mu
widens the estimate's standard deviation.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.effects.measurement.length_error import LengthError
from dlo_ros.effects.physics.clamp_angle import ClampAngle
from dlo_ros.effects.physics.gravity_tilt import GravityTilt
from dlo_ros.errors import InputError
from dlo_ros.identification.estimate import (
    logarithms,
    search_information,
    with_logarithms,
)
from dlo_ros.identification.fit import count_numbers, repeats, without
from dlo_ros.identification.uncertainty import FITTED, data_information
from dlo_ros.inference.forecast import Forecast, Manipulation, forecast
from dlo_ros.parameters import Settings
from dlo_ros.rod.tangents import MATERIAL
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

ROUNDS = 12
CONVERGED = 1e-3  # of a standard deviation, or of a logarithm
LONGEST_STEP = 0.5  # of a logarithm, in a round
CLAMPS = {"start": ("start", "control_point_2"), "end": ("end", "control_point_{}")}


@dataclass(frozen=True)
class Loose:
    """Standard deviations of what was set up; 0: it is taken as exact.

    Args:
        clamp_angle: of the direction of each clamp in the plane [rad].
        tilt: of gravity in the plane, as where the camera hangs askew [rad].
        length: of the DLO's length [m].
    """

    clamp_angle: float = 0.0
    tilt: float = 0.0
    length: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(
                    f"the standard deviation of {name} is {value:g}; it must be zero or positive"
                )

    def names(self, train: Sequence[Manipulation], settings: Settings) -> dict[str, float]:
        """Parameters that are open with their standard deviations, named as in `tangents`."""
        imposed = {name for recording in train for c in recording.commands for name in c.names}
        result = {}
        second = settings.rod.control_points - 1
        for end, ways in CLAMPS.items():
            held = any(way.format(second) in imposed for way in ways)
            if held and self.clamp_angle > 0.0:
                result[ClampAngle.parameter(end)] = self.clamp_angle
        if self.tilt > 0.0:
            result[GravityTilt.parameter("angle")] = self.tilt
        if self.length > 0.0:
            result[LengthError.parameter("difference")] = self.length
        return result


@dataclass(frozen=True)
class Loosened:
    """What the fit of the loose numbers has found.

    Args:
        settings: with their values as effects, for the final fit of E, mu and damping.
        theta: ln (E, mu, c, t_r) beside them.
        values: of each, with the standard deviation from data and knowledge together.
    """

    settings: Settings
    theta: FloatArray
    values: dict[str, tuple[float, float]]


def loosened(
    train: Sequence[Manipulation],
    settings: Settings,
    loose: Loose,
    start: FloatArray,
    ignored: Sequence[np.ndarray],
) -> Loosened:
    """Fit the loose numbers together with E, mu and damping.

    Args:
        train: recordings.
        settings: as `searchable` gives them; the fit of E, mu and damping has used them.
        loose: what is known how well.
        start: ln (E, mu, c, t_r) of that fit.
        ignored: pictures of each recording that were seen wrongly.
    """
    stds = loose.names(train, settings)
    given = np.array([_value(settings, name) for name in stds])
    guess, std = logarithms(settings), np.array(list(stds.values()))
    theta, values = start.copy(), given.copy()
    count = len(MATERIAL)
    prior = np.zeros((count + len(std), count + len(std)))
    prior[:count, :count] = search_information(settings)
    prior[count:, count:] = np.diag(std**-2.0)
    information = prior
    for _ in range(ROUNDS):
        forecasts = _forecasts(train, _with(settings, theta, stds, values), stds, ignored)
        normal, gradient, scale = _equations(forecasts)
        off = np.where(np.isfinite(guess), theta - guess, 0.0)
        pull = prior @ np.concatenate([off, values - given])
        information = scale * normal + prior
        step = np.linalg.solve(information, scale * gradient - pull)
        step[:count] = np.where(np.isfinite(guess), step[:count], 0.0)
        step *= min(1.0, LONGEST_STEP / max(float(np.abs(step[:count]).max()), 1e-300))
        theta, values = theta + step[:count], values + step[count:]
        if max(float(np.abs(step[:count]).max()), float(np.abs(step[count:] / std).max())) < (
            CONVERGED
        ):
            break
    else:
        LOG.warning("the loose numbers have not converged after %d rounds", ROUNDS)
    spread = np.sqrt(np.diag(np.linalg.inv(information))[count:])
    known = {name: (float(v), float(s)) for name, v, s in zip(stds, values, spread, strict=True)}
    found = _with(settings, guess, stds, values)
    return Loosened(found, theta, known)


def marginal(
    train: Sequence[Manipulation],
    settings: Settings,
    loose: Loose,
    values: Mapping[str, tuple[float, float]],
    ignored: Sequence[np.ndarray],
    shifts: Sequence[FloatArray],
) -> FloatArray:
    """Information (4, 4) on ln (E, mu, c, t_r) that is left when the loose numbers are open.

    Args:
        settings: fitted, the loose numbers among their effects.
        values: what was found for them, see `Loosened`.
        shifts: by which ln (E, mu, c, t_r) may be wrong besides, each (4,).
    """
    stds = loose.names(train, settings)
    forecasts = _forecasts(train, settings, stds, ignored)
    # A number that the knowledge of it holds where it is takes nothing out of the residuals.
    taken = sum(1.0 - (values[name][1] / std) ** 2 for name, std in stds.items())
    more = [np.append(shift, np.zeros(len(stds))) for shift in shifts]
    told = data_information(forecasts, settings, more, FITTED + taken)
    n = len(MATERIAL)
    own = told[n:, n:] + np.diag(np.array(list(stds.values())) ** -2.0)
    return np.asarray(told[:n, :n] - told[:n, n:] @ np.linalg.solve(own, told[n:, :n]))


def _forecasts(
    train: Sequence[Manipulation], settings: Settings, stds: dict[str, float],
    ignored: Sequence[np.ndarray],
) -> list[Forecast]:  # fmt: skip
    wanted = (*MATERIAL, *stds)
    found = [forecast(recording, settings, parameters=wanted) for recording in train]
    return [without(f, mask) for f, mask in zip(found, ignored, strict=True)]


def _equations(forecasts: Sequence[Forecast]) -> tuple[FloatArray, FloatArray, float]:
    """J^T J, J^T r, and the information per squared metre of residual, repeats counted once."""
    assert forecasts[0].derivative is not None
    size = forecasts[0].derivative.shape[1]
    normal, gradient, power, count = np.zeros((size, size)), np.zeros(size), 0.0, 0
    for f in forecasts:
        assert f.derivative is not None
        j = f.derivative.transpose(0, 2, 3, 1).reshape(f.residual.size, -1)
        normal += j.T @ j
        gradient += j.T @ f.residual.ravel()
        power, count = power + float(np.sum(f.residual**2)), count + count_numbers(f.residual)
    return normal, gradient, count / (power * repeats(forecasts))


def _with(
    settings: Settings, theta: FloatArray, stds: dict[str, float], values: FloatArray
) -> Settings:
    """The settings with logarithms of the material and values of the loose numbers."""
    effects = {k: dict(v) for k, v in settings.effects.items()}
    for name, value in zip(stds, values, strict=True):
        _, effect, key = name.split(".")
        effects.setdefault(effect, {})[key] = float(value)
    return with_logarithms(settings.with_effects(effects), theta)


def _value(settings: Settings, name: str) -> float:
    """What the settings say of a loose number; 0 where they say nothing."""
    _, effect, key = name.split(".")
    return float(np.sum(settings.effects.get(effect, {}).get(key, 0.0)))
