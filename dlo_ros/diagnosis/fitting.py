# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Simulates recordings with a model and fits its open parameters (Levenberg-Marquardt)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.measured import Recording
from dlo_ros.diagnosis.model import Model, prior
from dlo_ros.errors import SimulationError
from dlo_ros.identification.bundle import forecast_together
from dlo_ros.identification.forecast import Forecast, forecast, whitening
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

CONVERGED = 0.05
"""Gain of the cost in one iteration, per root of the number of measurements."""
CLEARLY_WRONG = 4.0
"""Excess over the noise from which a fit need not be driven to the last digit."""
COARSE = 0.01
"""Share of the squared residuals that an iteration must still gain there."""
TINY = 1e-200
ROUGH = ("obstacle",)
"""Effects with which a motion has no derivatives worth the name: a rope that hits something and
leaves it again answers to small changes in jumps. What counts is how it answers to changes as large
as a fit makes."""
SAME = 1e-6
"""Of the length, by which shapes may differ that such an effect does not touch."""
IN_LANES = (
    "air_drag", "constant_force", "gravity_tilt", "internal_damping", "intrinsic_curvature",
    "point_mass", "stiff_segment", "stiffness_gradient",
)  # fmt: skip
"""Effects of which many values are simulated at once in the plane: their differences are cheaper
than exact derivatives."""
DIFFERENCE = 0.01
"""Of a parameter's natural size, for differences."""
POLISH = 3
ROUGH_POLISH = 6
DAMPING = 1e-4
CONTINUED = 1e-7
"""Marquardt's damping of a fit at first, and of one that is continued."""
UNDAMPED = 1e-9
DAMPED, LEAST_DAMPING = 100.0, 1e-4
"""By which it grows with a step that has failed, and to which at least."""
TRIES = 5
LARGEST_STEP = 2.0
"""Of a parameter in one iteration, in natural units."""


@dataclass(frozen=True)
class Evaluation:
    """A model held against recordings.

    Args:
        model: with its values.
        residuals: per recording in units of the noise, shape (F, K).
        jacobians: derivatives of the prediction by the open parameters as the fit sees them, per
            recording, shape (F, P, K); None where not asked for.
        power: sum of squared residuals.
        cost: minus twice the log likelihood, the noise as large as what is left over but no smaller
            than measured, and what the prior adds: a model that misses much must not pay for it
            with what is known.
        predicted: control points per recording, shape (F, n, 4).
        err: eq. (10) per recording and frame [m].
    """

    model: Model
    residuals: tuple[FloatArray, ...]
    jacobians: tuple[FloatArray, ...] | None
    power: float
    cost: float
    predicted: tuple[FloatArray, ...]
    err: tuple[FloatArray, ...]

    @property
    def excess(self) -> float:
        """Mean square of the residuals where it is larger than the noise, else 1."""
        return max(1.0, self.power / sum(r.size for r in self.residuals))


def is_rough(model: Model) -> bool:
    """Whether a model contains a rough effect."""
    return any(name in ROUGH for name in model.effects)


def evaluate(
    model: Model, recordings: Sequence[Recording], given: Settings, *, derivatives: bool = True,
    exact: bool = False,
) -> Evaluation:  # fmt: skip
    """Simulate recordings.

    Args:
        derivatives: whether they are wanted.
        exact: whether they are the simulation's own where differences are cheaper. Of what the
            data leave open, differences pretend to know something.

    Raises:
        SimulationError: one of them cannot be simulated with this model.
    """
    residuals, jacobians, predicted, err = [], [], [], []
    for recording in recordings:
        found, jacobian = _held_against(model, recording, derivatives, exact)
        residuals.append(recording.residual(found.predicted))
        predicted.append(found.predicted)
        err.append(found.err)
        if jacobian is not None:
            jacobians.append(jacobian)
    power, cost = _judged(model, residuals, given)
    if not np.isfinite(cost):
        raise SimulationError("the simulation gives no finite shapes")
    return Evaluation(
        model,
        tuple(residuals),
        tuple(jacobians) if derivatives else None,
        power,
        cost,
        tuple(predicted),
        tuple(err),
    )


def _judged(model: Model, residuals: Sequence[FloatArray], given: Settings) -> tuple[float, float]:
    """See `Evaluation.power` and `Evaluation.cost`."""
    centre, information = prior(model, given)
    power, count = sum(float(np.sum(r**2)) for r in residuals), sum(r.size for r in residuals)
    cost = count * (1.0 + np.log(power / count)) if power > count else power
    return power, cost + float(information @ (model.theta() - centre) ** 2)


def earlier(
    at: Evaluation, recordings: Sequence[Recording], drafts: Sequence[Recording], given: Settings
) -> Evaluation:
    """What an evaluation says, without derivatives, of recordings that may end earlier."""
    ends = [len(d.times) - len(r.times) or None for r, d in zip(recordings, drafts, strict=True)]
    residuals = tuple(r[:end] for r, end in zip(at.residuals, ends, strict=True))
    power, cost = _judged(at.model, residuals, given)
    return replace(
        at, residuals=residuals, jacobians=None, power=power, cost=cost, predicted=(), err=()
    )


def _held_against(
    model: Model, recording: Recording, derivatives: bool, exact: bool
) -> tuple[Forecast, FloatArray | None]:
    """A forecast and its derivatives by the open parameters, shape (F, P, K)."""
    settings, spans = _as_fine(model.settings, recording), recording.spans
    manipulation = recording.manipulation
    if not derivatives:
        return forecast(manipulation, settings, spans=spans), None
    rough = is_rough(model)
    if rough:
        untouched = _untouched(model, recording, exact)
        if untouched is not None:
            return untouched
    if not rough and (exact or not all(name in IN_LANES for name in model.effects)):
        return _exact(model, recording, settings)
    moved, steps = _moved(model)
    sets = [settings, *(_as_fine(m.settings, recording) for m in moved)]
    found = None if rough else forecast_together(manipulation, sets, spans)
    if found is None and not rough:
        return _exact(model, recording, settings)
    if found is None:
        found = [forecast(manipulation, one, spans=spans) for one in sets]
    here, *others = found
    if here is None or any(other is None for other in others):
        return _exact(model, recording, settings)
    change = np.stack([o.predicted - here.predicted for o in others if o is not None], axis=1)
    return here, recording.white(change[..., :3]) / steps[:, None]


def _untouched(
    model: Model, recording: Recording, exact: bool
) -> tuple[Forecast, FloatArray] | None:
    """The same where rough effects do nothing; None where they do something."""
    settings = _as_fine(model.settings, recording)
    here = forecast(recording.manipulation, settings, spans=recording.spans)
    bare = model
    for name in ROUGH:
        bare = bare.without(name)
    found, jacobian = _held_against(bare, recording, bool(bare.free), exact)
    if np.abs(found.predicted - here.predicted).max() > SAME * settings.rod.length:
        return None
    result = np.zeros((len(here.predicted), len(model.free), len(recording.noise)))
    if jacobian is not None:
        result[:, [model.free.index(name) for name in bare.free]] = jacobian
    return here, result


def _exact(model: Model, recording: Recording, settings: Settings) -> tuple[Forecast, FloatArray]:
    """A forecast with the simulation's own sensitivities."""
    found = forecast(recording.manipulation, settings, parameters=model.free, spans=recording.spans)
    assert found.derivative is not None
    rod = settings.rod
    back = np.linalg.inv(whitening(rod.control_points, rod.length))
    return found, recording.white(back @ found.derivative) * model.chain()[:, None]


def _moved(model: Model) -> tuple[list[Model], FloatArray]:
    """The model with each open parameter changed, and the steps, shape (P,), within its range."""
    theta, models = model.theta(), []
    steps = DIFFERENCE * np.minimum(model.natural(), 1.0)
    for k in range(len(theta)):
        for sign in (1.0, -1.0):
            other = theta.copy()
            other[k] += sign * steps[k]
            moved = model.at(other)
            if moved.theta()[k] != theta[k]:
                break
        models.append(moved)
        steps[k] *= sign
    return models, steps


def _as_fine(settings: Settings, recording: Recording) -> Settings:
    """The settings with the time steps that a recording asks for."""
    if recording.tolerance is None:
        return settings
    simulation = replace(settings.simulation, tolerance=recording.tolerance)
    return replace(settings, simulation=simulation)


@dataclass(frozen=True)
class Normal:
    """The normal equations of a linearised model, of any part of the measurements.

    Args:
        hessian: J^T J, shape (P, P).
        gradient: J^T r, shape (P,).
        power: r^T r.
    """

    hessian: FloatArray
    gradient: FloatArray
    power: float

    def __add__(self, other: Normal) -> Normal:
        return Normal(
            self.hessian + other.hessian, self.gradient + other.gradient, self.power + other.power
        )

    def scaled(self, factor: float) -> Normal:
        """With another weight."""
        return Normal(factor * self.hessian, factor * self.gradient, factor * self.power)

    def minimum(self) -> tuple[FloatArray, float]:
        """Where the linearised cost is smallest, from here, and its value there."""
        step = solve(self.hessian, self.gradient)
        return step, self.power - float(self.gradient @ step)


def solve(hessian: FloatArray, right: FloatArray) -> FloatArray:
    """Solve positive definite equations whose unknowns differ widely in size."""
    diagonal = np.diag(hessian)
    # An unknown of which nothing is known stays where it is.
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.maximum(diagonal, TINY)), 0.0)
    scaled = hessian * scale[:, None] * scale
    scaled += 1e-12 * np.eye(len(scaled))
    shape = (-1,) + (1,) * (right.ndim - 1)
    return np.asarray(scale.reshape(shape) * np.linalg.solve(scaled, scale.reshape(shape) * right))


def normal(residual: FloatArray, jacobian: FloatArray) -> Normal:
    """Normal equations of frames: residual (F, K), jacobian (F, P, K)."""
    j = jacobian.transpose(0, 2, 1).reshape(-1, jacobian.shape[1])
    r = residual.ravel()
    return Normal(j.T @ j, j.T @ r, float(r @ r))


def known(model: Model, given: Settings) -> Normal:
    """What is known beforehand, as normal equations."""
    centre, information = prior(model, given)
    off = centre - model.theta()
    return Normal(np.diag(information), information * off, float(information @ off**2))


def total(at: Evaluation, given: Settings, masks: Sequence[np.ndarray] | None = None) -> Normal:
    """Normal equations of everything, the noise as large as what is left over.

    Args:
        masks: frames of each recording that count, shape (F,); default: all.
    """
    assert at.jacobians is not None
    result = known(at.model, given)
    for k, (residual, jacobian) in enumerate(zip(at.residuals, at.jacobians, strict=True)):
        keep = slice(None) if masks is None else masks[k][-len(residual) :]
        result = result + normal(residual[keep], jacobian[keep]).scaled(1.0 / at.excess)
    return result


def bounded(model: Model, hessian: FloatArray, gradient: FloatArray) -> FloatArray:
    """A step that stays within the ranges; what meets its border no longer moves the others."""
    theta = model.theta()
    step = np.zeros(len(theta))
    held = np.zeros(len(theta), dtype=np.bool_)
    for _ in range(len(theta)):
        free = ~held
        right = gradient[free] - hessian[np.ix_(free, held)] @ step[held]
        step[free] = solve(hessian[np.ix_(free, free)], right)
        step *= min(1.0, LARGEST_STEP / float(np.abs(step / model.natural()).max() or 1.0))
        within = model.at(theta + step).theta() - theta
        met = free & (np.abs(within - step) > 1e-9 * (1.0 + np.abs(step)))
        if not met.any():
            break
        step[met] = within[met]
        held |= met
    return step


def fit(
    start: Evaluation, recordings: Sequence[Recording], given: Settings, iterations: int, *,
    exact: bool = False, damping: float = DAMPING,
) -> Evaluation:  # fmt: skip
    """Levenberg-Marquardt from an evaluation with derivatives.

    A step that cannot be simulated or makes things worse is shortened; what leaves its range stays
    at the border.

    Args:
        exact: see `evaluate`.
        damping: Marquardt's, at first; it keeps a fit from going far along what the data leave
            open, and makes it slow along narrow valleys.
    """
    best = start
    count = sum(r.size for r in start.residuals)
    for _ in range(iterations):
        equations = total(best, given)
        enough = CONVERGED * np.sqrt(count)
        if best.excess > CLEARLY_WRONG:
            enough += COARSE * count
        gain = 0.0
        for k in range(TRIES):
            lhs = equations.hessian + damping * np.diag(np.diag(equations.hessian))
            step = bounded(best.model, lhs, equations.gradient)
            if step @ (2.0 * equations.gradient - equations.hessian @ step) < enough:
                return best
            trial = best.model.at(best.model.theta() + step)
            try:
                after = _tried(trial, recordings, given, exact, best.cost)
            except SimulationError:
                damping = max(DAMPED * damping, LEAST_DAMPING)
                continue
            gain = best.cost - after.cost
            if gain > 0.0:
                break
            if k and -gain < enough:
                return best
            damping = max(DAMPED * damping, LEAST_DAMPING)
        if gain <= 0.0:
            return best
        best, damping = after, 0.1 * damping
        if gain < enough:
            return best
    return best


def _tried(
    model: Model, recordings: Sequence[Recording], given: Settings, exact: bool, before: float
) -> Evaluation:
    """An evaluation, with derivatives where they are cheap or its cost is lower than before."""
    if is_rough(model):
        after = evaluate(model, recordings, given, derivatives=False)
        if after.cost >= before:
            return after
    return evaluate(model, recordings, given, exact=exact)


def attempt(
    model: Model, recordings: Sequence[Recording], given: Settings, iterations: int, *,
    damping: float = DAMPING,
) -> Evaluation | None:  # fmt: skip
    """A fit that begins with a model; None where that cannot be simulated."""
    try:
        at = evaluate(model, recordings, given)
    except SimulationError:
        return None
    return fit(at, recordings, given, iterations, damping=damping)


def polished(at: Evaluation, recordings: Sequence[Recording], given: Settings) -> Evaluation:
    """The fit finished with exact derivatives: what the data leave open is as known beforehand.

    Of rough effects there are none; their fit goes on as it was, with the fine simulation.
    """
    rough = is_rough(at.model)
    iterations, damping = (ROUGH_POLISH, DAMPING) if rough else (POLISH, UNDAMPED)
    try:
        here = evaluate(at.model, recordings, given, exact=not rough)
    except SimulationError:
        return at
    return fit(here, recordings, given, iterations, exact=not rough, damping=damping)
