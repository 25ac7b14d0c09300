# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Separate estimates of E and mu, from shapes and the forces measured at the grips.

The information of shapes enters as a Gaussian; forces are predicted with the whole simulation, and
their derivatives are differences of it. Where a DLO bears no force of its own (a weight, a draught)
every force is proportional to E, mu and the drag together, which gives the derivative by mu
exactly.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dlo_ros.errors import SimulationError
from dlo_ros.identification.estimate import (
    known_information,
    logarithms,
    search_information,
    with_logarithms,
)
from dlo_ros.identification.force_scale import bounded, grip_wrenches
from dlo_ros.identification.information import widened
from dlo_ros.inference.forecast import Forecast, Manipulation, forecast
from dlo_ros.inference.parallel import Pool, Threads
from dlo_ros.inference.parameter import value_of, with_value
from dlo_ros.inference.priors import DIAMETER_STD
from dlo_ros.inference.wrench import (
    WrenchField,
    from_change,
    from_mean,
    wrench_field,
    wrench_information,
)
from dlo_ros.parameters import Settings
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

DIRECTIONS = {
    "young_modulus": (np.array([1.0, 0.0, 0.0, 0.0]), 0.05),
    "air_drag": (np.array([0.0, 0.0, 1.0, 0.0]), 0.2),
    "relaxation_time": (np.array([0.0, 0.0, 0.0, 1.0]), 0.2),
}
"""Logarithms that are moved to either side for a difference, and by how much."""
TOGETHER = (np.array([1.0, 1.0, 1.0, 0.0]), 0.1)
"""The common scale of all forces."""
ITERATIONS = 5
CLOSE = 0.2
"""Step in standard deviations at which the iteration ends."""
LONGEST_STEP = 1.5
"""Change of a logarithm in one iteration."""
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
        std: standard deviation of ln mu with all information; from how forces change alone; and
            from their mean alone.
        left: root mean square residual of forces [N] and torques [N m], for each recording and end.
        messages: number of measured messages.
    """

    theta: FloatArray
    information: FloatArray
    gradient: FloatArray
    std: tuple[float, float, float]
    left: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    messages: int = 0

    @property
    def relative(self) -> tuple[float | None, float | None, float | None]:
        """The three standard deviations of mu over mu; None where that leaves it unknown."""
        return bounded(self.std)


def information_with_forces(
    train: Sequence[Manipulation],
    settings: Settings,
    theta: FloatArray,
    shapes: FloatArray,
    given: Settings,
    spans: Sequence[int | None],
    set_up: Mapping[str, tuple[float, float]],
    pool: Pool | None = None,
) -> ForceInformation | None:
    """The estimate with measured forces; None where there are none.

    Args:
        train: recordings.
        settings: settings of the fit to shapes, set-up included.
        theta: ln (E, mu, c, t_r) of that fit.
        shapes: information of that fit, shape (4, 4).
        given: the parameter file.
        spans: knot spans of each recording's simulation.
        set_up: numbers of the set-up with the standard deviations that shapes leave.
        pool: pool in which simulations run.

    Raises:
        SimulationError: a recording cannot be simulated.
    """
    pairs = [(r, s) for r, s in zip(train, spans, strict=True) if r.wrenches]
    if not pairs:
        return None
    # Shapes and forces alike determine E D^4 and mu D^2: the error of D is added at the end.
    diameter = given.rod.diameter_std / given.rod.diameter or (DIAMETER_STD if set_up else 0.0)
    stated, shapes = shapes, _exact_diameter(shapes, diameter)
    known = known_information(given, weighed=True)
    hardly = GUESS_WEIGHT * search_information(given)
    guess = np.where(np.isfinite(logarithms(given)), logarithms(given), theta)
    usable = np.isfinite(theta)
    centre, mu = np.where(usable, theta, 0.0), np.eye(len(theta))[MU]
    expected = shapes + known + hardly
    spread = np.asarray(np.linalg.inv(expected), dtype=np.float64)
    # E/mu, c/mu and t_r are left to the shapes: the effect of a small error of the set-up on
    # torques would else be attributed to E/mu, which shapes determine better.
    ratios = np.linalg.cholesky(RATIOS @ spread @ RATIOS.T)
    pull = (shapes + hardly) @ centre + known @ np.where(usable, guess, 0.0)
    now = centre.copy()
    for _ in range(ITERATIONS):
        at = with_logarithms(settings, np.where(usable, now, -np.inf))
        fields = _fields(pairs, at, given, set_up, ratios, pool or Threads())
        if not fields:
            LOG.warning("no measured force lies near an observed shape at a grip; none is used")
            return None
        offset, precision = (spread @ pull - now)[[MU]], 1.0 / spread[[MU]][:, [MU]]
        found = [wrench_information(f, offset, precision) for f in fields]
        information = _on_mu([t.information for t in found])
        gradient = float(np.sum([t.gradient for t in found])) * mu
        whole = expected + information
        step = np.linalg.solve(whole, pull + information @ now + gradient) - now
        step = np.where(usable, step, 0.0)
        step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
        now, gradient = now + step, gradient - information @ step
        if float(step @ whole @ step) < CLOSE**2:
            break
    else:
        LOG.warning("forces and shapes have not come to agree after %d iterations", ITERATIONS)
    changing = [from_change(f, t.variance) for f, t in zip(fields, found, strict=True)]
    mean = [from_mean(f, t.variance) for f, t in zip(fields, found, strict=True)]
    alone = (information, _on_mu(changing), _on_mu(mean))
    everything, change, weight = (
        float(np.hypot(np.sqrt(np.linalg.inv(expected + part)[MU, MU]), 2.0 * diameter))
        for part in alone
    )
    left = {}
    for f, t in zip(fields, found, strict=True):
        sizes = [t.left[f.torque == kind] for kind in (False, True)]
        force, torque = (float(np.sqrt(np.mean(s**2))) if len(s) else 0.0 for s in sizes)
        left[f.name] = force, torque
    messages = sum(len(w.stamps) for r, _ in pairs for w in r.wrenches)
    result = np.where(usable, now, theta)
    whole = widened(shapes + information, diameter * np.array([4.0, 2.0, 0.0, 0.0]))
    return ForceInformation(
        result, whole - stated, gradient, (everything, change, weight), left, messages
    )


def _exact_diameter(shapes: FloatArray, diameter: float) -> FloatArray:
    """Information (4, 4) of shapes at the stated diameter, whose std over it they contain."""
    moved = shapes @ (2.0 * diameter * np.eye(len(shapes))[0])
    left = 1.0 - 2.0 * diameter * float(moved[0])
    return shapes + np.outer(moved, moved) / left if left > ROUNDING else shapes


def _on_mu(parts: Sequence[FloatArray]) -> FloatArray:
    """Information (4, 4) of forces on ln mu, the sum of that of all ends, (1, 1) each."""
    return np.diag(max(float(np.sum(parts)), 0.0) * np.eye(len(MATERIAL))[MU])


def _fields(
    pairs: Sequence[tuple[Manipulation, int | None]], at: Settings, given: Settings,
    set_up: Mapping[str, tuple[float, float]], ratios: FloatArray, pool: Pool,
) -> list[WrenchField]:  # fmt: skip
    """Measured and predicted forces of all recordings, with derivatives by ln mu alone.

    Args:
        ratios: root of the covariance of `RATIOS`, shape (3, 3).
    """
    sets, sensed = _around(at, set_up), _sensed(at, given)
    tasks = [(recording, one, spans) for recording, spans in pairs for one in sets]
    forecasts = pool.map(_borne, tasks)
    result = []
    for k, (recording, _) in enumerate(pairs):
        group = forecasts[k * len(sets) : (k + 1) * len(sets)]
        here = group[0]
        if here is None:
            raise SimulationError(f"{recording.name}: cannot be simulated with its forces")
        for measured in recording.wrenches:
            predicted = _wrench(here, measured.end)
            if predicted is None:
                LOG.warning(
                    "%s: no command holds the %s of the DLO; forces there are not used",
                    recording.name, measured.end,
                )  # fmt: skip
                continue
            derivative, more = _differences(group, measured.end, at, len(set_up), ratios)
            found = wrench_field(
                f"{recording.name}, {measured.end}", measured, [int(s) for s in here.stamps],
                predicted, derivative, sensed, recording.commands, more,
            )  # fmt: skip
            if found is not None:
                result.append(found)
    return result


def _sensed(at: Settings, given: Settings) -> Settings:
    """Settings with the weight of the parameter file, since priors must not follow the fit."""
    return at.with_material(at.rod.young_modulus, given.rod.density)


def _around(at: Settings, set_up: Mapping[str, tuple[float, float]]) -> list[Settings]:
    """The settings, then for each direction those above and below, then one for each number."""
    theta = logarithms(at)
    result = [at]
    for direction, size in _directions(at):
        result += [with_logarithms(at, theta + s * size * direction) for s in (1.0, -1.0)]
    for name, (_, std) in set_up.items():
        result.append(with_value(at, name, value_of(at, name) + std))
    return result


def _directions(at: Settings) -> list[tuple[FloatArray, float]]:
    """Directions of the logarithms that are moved."""
    theta = logarithms(at)
    own = [d for d in DIRECTIONS.values() if np.isfinite(theta[d[0] > 0.0]).all()]
    return [*own, TOGETHER]


def _borne(task: tuple[Manipulation, Settings, int | None]) -> Forecast | None:
    """A forecast with loads; None where the simulation fails."""
    recording, settings, spans = task
    try:
        return forecast(recording, settings, spans=spans, loads=True)
    except SimulationError:
        return None


def _wrench(found: Forecast | None, end: str) -> FloatArray | None:
    """Force and torque of the grip at an end, shape (F, 6); None where it holds nothing."""
    return None if found is None else grip_wrenches(found.loadings, end)


def _differences(
    group: Sequence[Forecast | None], end: str, at: Settings, numbers: int, ratios: FloatArray
) -> tuple[FloatArray, list[FloatArray]]:
    """Derivative by ln mu with all ratios kept (F, 6, 1), and what these and the set-up's numbers
    may do, in standard deviations, (F, 6) each.
    """
    here = _wrench(group[0], end)
    assert here is not None
    scale, moves = np.zeros_like(here), np.zeros((*here.shape, len(RATIOS)))
    for k, (direction, size) in enumerate(_directions(at)):
        above, below = (_wrench(group[1 + 2 * k + s], end) for s in (0, 1))
        if above is None or below is None:
            raise SimulationError("a neighbouring set of parameters cannot be simulated")
        slope = (above - below) / (2.0 * size)
        if direction is TOGETHER[0]:
            scale = slope
        else:
            moves[:, :, int(np.argmax(RATIOS @ direction))] = slope
    more = list(np.moveaxis(moves @ ratios, 2, 0))
    for found in group[len(group) - numbers :] if numbers else []:
        moved = _wrench(found, end)
        if moved is not None:
            more.append(moved - here)
    return scale[:, :, None], more
