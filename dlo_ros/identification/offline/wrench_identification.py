# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Separate estimates of E and mu, from shapes and the forces measured at the grips.

Shapes leave the common scale of E, mu and drag open, and forces tell it (`force_scale`). What
shapes tell over mu only, such as a mass that hangs on the DLO, goes with it. What else they leave
uncertain, the ratios of these three and the numbers of the set-up, changes forces as well; these
changes are differences of whole simulations.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from dlo_ros.errors import SimulationError
from dlo_ros.identification.cooperative_tasks import exhausted
from dlo_ros.identification.estimate import (
    known_information,
    logarithms,
    search_information,
    with_logarithms,
)
from dlo_ros.identification.force_scale import (
    GripForces,
    Scale,
    borne_along,
    grip_wrenches,
    scale_of,
)
from dlo_ros.identification.information import widened
from dlo_ros.identification.offline.set_up_estimate import MaterialFit
from dlo_ros.inference.forecast import Forecast, Manipulation, forecast
from dlo_ros.inference.joint import evaluate
from dlo_ros.inference.parallel import Pool, Threads
from dlo_ros.inference.parameter import ParametricModel, value_of, with_values
from dlo_ros.inference.smoothly_led import smoothly_led
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

DIRECTIONS = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0], [1.0, 1.0, 1.0, 0]])
STEPS = (0.05, 0.2, 0.2, 0.1)
"""Directions in which differences are taken, and the steps to either side: the logarithms of E, c
and t_r, each of which moves one of `RATIOS`, and the common scale of all forces."""
GUESS_WEIGHT = 0.01
"""Weight of what was only guessed, where forces were measured."""
MU = MATERIAL.index("density")
RATIOS = np.array([[1.0, -1.0, 0, 0], [0, -1.0, 1.0, 0], [0, 0, 0, 1.0]])
"""Logarithms of E/mu, c/mu and t_r from those of `MATERIAL`."""
ROUNDING = 1e-9
"""Least share of the shapes' information on E/mu that is not lost to the diameter."""


@dataclass(frozen=True)
class ForceInformation:
    """The information of measured forces.

    Args:
        theta: ln (E, mu, c, t_r) of shapes and forces.
        information: information of the forces on theta, shape (4, 4).
        gradient: information times the step from theta to where forces alone would go, shape (4,).
        scale: scale of all forces over that of the fit to shapes; its stds are those of ln mu.
        messages: number of measured messages.
    """

    theta: FloatArray
    information: FloatArray
    gradient: FloatArray
    scale: Scale
    messages: int


def information_with_forces(
    train: Sequence[Manipulation], found: MaterialFit, given: Settings, pool: Pool | None = None
) -> ForceInformation | None:
    """The estimate with measured forces; None where there are none.

    Args:
        train: recordings.
        found: fit to their shapes.
        given: the parameter file.
        pool: pool in which simulations run.

    Raises:
        SimulationError: a recording cannot be simulated.
    """
    spans = (recording.spans for recording in found.recordings)
    length = given.rod.length
    pairs = [(smoothly_led(r, length), s) for r, s in zip(train, spans, strict=True) if r.wrenches]
    if not pairs:
        return None
    # Shapes and forces alike determine E D^4 and mu D^2: the error of D is added at the end.
    diameter = found.diameter
    shapes = _exact_diameter(found.information, diameter)
    known = known_information(given, weighed=True)
    hardly = GUESS_WEIGHT * search_information(given)
    spread = np.asarray(np.linalg.inv(shapes + known + hardly), dtype=np.float64)
    # E/mu, c/mu and t_r are left to the shapes: the effect of a small error of the set-up on
    # torques would else be attributed to E/mu, which shapes determine better.
    ratios = np.linalg.cholesky(RATIOS @ spread @ RATIOS.T)
    borne = _borne_along(pairs, found, ratios, pool or Threads())
    precision = 1.0 / float(spread[MU, MU])
    # The weight is that of the parameter file, since priors must not follow the fit.
    sensed = found.settings.with_material(found.settings.rod.young_modulus, given.rod.density)
    scale = exhausted(scale_of(borne, sensed, known=precision))
    if scale is None:
        LOG.warning("no measured force lies near an observed shape at a grip; none is used")
        return None
    own = np.eye(len(MATERIAL))[MU]
    whole = shapes + max(scale.information, 0.0) * np.outer(own, own)
    whole = widened(whole, diameter * np.array([4.0, 2.0, 0.0, 0.0]))
    everything, change, mean = (float(np.hypot(s, 2.0 * diameter)) for s in scale.std)
    known_by = replace(scale, std=(everything, change, mean))
    step = np.where(np.isfinite(found.theta), spread[:, MU] * precision * scale.log, 0.0)
    messages = sum(len(w.stamps) for r, _ in pairs for w in r.wrenches)
    return ForceInformation(
        found.theta + step,
        whole - found.information,
        precision * scale.log * own,
        known_by,
        messages,
    )


def with_scale_of_forces(found: MaterialFit, forces: ForceInformation) -> MaterialFit:
    """A fit to shapes with the material of shapes and forces, and the set-up that goes with it.

    Shapes do not tell a mass on the DLO but its ratio to mu: it changes as much as mu does.

    Raises:
        SimulationError: a recording cannot be simulated.
    """
    follows, left = _following(found)
    model = _followed(found, forces.scale.log)
    model = replace(model, settings=with_logarithms(model.settings, forces.theta))
    spread = np.hypot(left, follows * np.exp(forces.scale.log) * forces.scale.std[0])
    set_up = {
        p.name: (value_of(model.settings, p.name), p.outer_std(float(x), float(std)))
        for p, x, std in zip(model.parameters, model.theta(), spread, strict=True)
        if p.effect
    }
    at = evaluate(model, found.recordings, found.at.variances)
    return replace(found, at=at, set_up=set_up, information=found.information + forces.information)


def _following(found: MaterialFit) -> tuple[FloatArray, FloatArray]:
    """Changes of the fit's numbers with ln mu where shapes stay, and their stds at a given mu.

    Returns:
        Change of each of the P parameters for a unit change of ln mu, and standard deviation, both
        as inference sees them, shape (P,); zero for the material, which `MATERIAL` has.
    """
    covariance = found.at.posterior.covariance
    own = np.array([bool(p.effect) for p in found.at.model.parameters])
    k = found.at.model.index("density")
    slope = covariance[k] / covariance[k, k]
    variance = np.diag(covariance) - slope**2 * covariance[k, k]
    return np.where(own, slope, 0.0), np.where(own, np.sqrt(np.maximum(variance, 0.0)), 0.0)


def _followed(found: MaterialFit, log: float) -> ParametricModel:
    """The fitted model with the set-up that goes with a change of ln mu, its material as it was.

    It goes with mu itself: half of it takes half of a mass.
    """
    model = found.at.model
    return model.at(model.theta() + np.expm1(log) * _following(found)[0])


def _exact_diameter(shapes: FloatArray, diameter: float) -> FloatArray:
    """Information (4, 4) of shapes at the stated diameter, whose std over it they contain."""
    moved = shapes @ (2.0 * diameter * np.eye(len(shapes))[0])
    left = 1.0 - 2.0 * diameter * float(moved[0])
    return shapes + np.outer(moved, moved) / left if left > ROUNDING else shapes


def _borne_along(
    pairs: Sequence[tuple[Manipulation, int | None]],
    found: MaterialFit,
    ratios: FloatArray,
    pool: Pool,
) -> list[GripForces]:
    """Measured and predicted forces of all recordings, with what may be wrong with these.

    Args:
        ratios: root of the covariance of `RATIOS`, shape (3, 3).
    """
    sets = _around(found)
    tasks = [(recording, one, spans) for recording, spans in pairs for one in sets]
    forecasts = iter(pool.map(_forecast, tasks))
    result = []
    for recording, _ in pairs:
        here, *others = islice(forecasts, len(sets))
        if here is None:
            raise SimulationError(f"{recording.name}: cannot be simulated with its forces")
        borne = borne_along(recording, here.loadings, here.stamps, found.settings)
        ends = sorted({w.end for w in recording.wrenches})
        for end in (e for e in ends if grip_wrenches(here.loadings, e) is None):
            LOG.warning(
                "%s: no command holds the %s of the DLO; forces there are not used",
                recording.name, end,
            )  # fmt: skip
        result += [_with_differences(b, others, ratios) for b in borne]
    return result


def _around(found: MaterialFit) -> list[Settings]:
    """The settings, then for each direction those above and below, then one for each number."""
    at, model = found.settings, found.at.model
    theta, result = logarithms(at), [at]
    for direction, step in zip(DIRECTIONS, STEPS, strict=True):
        for s in (step, -step):
            # Along the scale of all forces, the last one, masses change as mu does.
            there = _followed(found, s * direction[MU]).settings
            result.append(with_logarithms(there, theta + s * direction))
    for p, x, std in zip(model.parameters, model.theta(), _following(found)[1], strict=True):
        if p.effect:
            more = value_of(at, p.name) + p.outer_std(float(x), float(std))
            result.append(with_values(at, {p.name: more}))
    return result


def _forecast(task: tuple[Manipulation, Settings, int | None]) -> Forecast | None:
    """A forecast with loads; None where the simulation fails."""
    recording, settings, spans = task
    try:
        return forecast(recording, settings, spans=spans, loads=True)
    except SimulationError:
        return None


def _with_differences(
    borne: GripForces, others: Sequence[Forecast | None], ratios: FloatArray
) -> GripForces:
    """Forces with their derivative by the scale, and what ratios and the set-up may change.

    Args:
        others: forecasts with the settings of `_around` but the first.
        ratios: see `_borne_along`.
    """
    end, count = borne.measured.end, len(borne.stamps)
    wrenches = [grip_wrenches(found.loadings[-count:] if found else (), end) for found in others]
    differences = []
    for k, step in enumerate(STEPS):
        above, below = wrenches[2 * k : 2 * k + 2]
        if above is None or below is None:
            raise SimulationError("a neighbouring set of parameters cannot be simulated")
        differences.append((above - below) / (2.0 * step))
    *moves, slope = differences
    moved = np.moveaxis(np.stack(moves, axis=2) @ ratios, 2, 0)
    set_up = [m - borne.predicted for m in wrenches[2 * len(STEPS) :] if m is not None]
    return replace(borne, slope=slope, columns=(*moved, *set_up))
