"""Identify (E, mu) while the DLO moves.

A model of its own runs along with the observed splines and carries exact sensitivities. Every
observation adds its information to a linearised least-squares problem (a recursive Gauss-Newton
filter on ln E, ln mu, ln c, ln t_r). When the estimate has moved away from where the model was
linearised, the recent past is simulated again with the new parameters, so that early steps taken
far from the truth leave no trace. At a few moments after the start, rival values of E/mu are tried
on that past, since far from the truth a shape may lie on another branch.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.bundle import forecast_each
from dlo_ros.identification.estimate import (
    Estimate,
    logarithms,
    search_information,
    searchable,
    summarise,
    with_logarithms,
    within_noise,
)
from dlo_ros.identification.forecast import Forecast, Manipulation, whitening
from dlo_ros.identification.uncertainty import data_information
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.orientation import along
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod.tangents import MATERIAL
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

WINDOW = 20.0  # [s] of past that is simulated again; older information is kept as a summary
FEWEST = 3  # observations before anything is concluded
SHORTEST_STEP = 0.01  # change of a logarithm that never needs a new linearisation
NUISANCE_WEIGHT = 0.1
NEGLECTED = 1.0  # second-order part of a change of the shapes that may be neglected, in sigma
SMALLEST_STD = 1e-6  # [m] of a residual number; below is rounding
LONGEST_STEP = 1.5  # change of a logarithm at one relinearisation
RIVALS = (1 / 30, 1 / 8, 1 / 3, 3.0, 8.0, 30.0)  # of E/mu
TRIALS = (0.3, 0.8, 1.6, 3.2)  # [s] of past after which rivals are tried
SIGNIFICANT = 0.01  # change of a logarithm that is worth passing on
UNKNOWN_WEIGHT = 0.1  # of a change that leaves E/mu alone where only E/mu is determined
FORGETTING = 0.7  # weight of older windows: a DLO warms up and wears
REPEATS_EVERY = 10  # observations between looks at the correlation of the residuals


@dataclass
class _Pass:
    """One run of the model along the observations, linearised at theta."""

    theta: FloatArray
    simulation: Simulation
    normal: FloatArray = field(default_factory=lambda: np.zeros((4, 4)))
    gradient: FloatArray = field(default_factory=lambda: np.zeros(4))
    residuals: list[FloatArray] = field(default_factory=list)
    derivatives: list[FloatArray] = field(default_factory=list)
    predicted: list[FloatArray] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)
    used: int = 0

    def add(self, observation: Observation, white: FloatArray) -> None:
        """Advance to an observation and take in its residual."""
        prediction = self.simulation.advance(observation.stamp)
        gap = observation.control_points[:, :3] - prediction.control_points[:, :3]
        residual = white @ gap
        if prediction.sensitivity is not None:
            self.derivatives.append(white @ prediction.sensitivity)
            j = self.derivatives[-1].reshape(4, -1).T
            self.normal += j.T @ j
            self.gradient += j.T @ residual.ravel()
        self.residuals.append(residual)
        self.predicted.append(prediction.control_points)
        self.stamps.append(observation.stamp)
        self.used += 1

    def information(self) -> FloatArray:
        """What the residuals tell, for what they really are (4, 4); see `uncertainty`."""
        judged = self.simulation.resolution
        found = Forecast(
            np.array(self.stamps),
            np.array(self.predicted),
            np.array(self.residuals),
            np.array(self.derivatives),
            np.zeros(self.used),
            self.simulation.model.basis.spans,
            judged.error if judged else np.nan,
        )
        return data_information([found], self.simulation.settings)

    @property
    def power(self) -> float:
        """Sum of squared residuals [m^2]."""
        return float(sum(np.sum(r**2) for r in self.residuals))


class OnlineEstimator:
    """Recursive estimator of (E, mu).

    Feed it commands and observed splines as they come; read `estimate` whenever.

    Args:
        settings: initial guess, prior knowledge, how the simulation starts.
    """

    def __init__(self, settings: Settings) -> None:
        self._initial = searchable(settings)
        self._white = whitening(settings.rod.control_points, settings.rod.length)
        self._motion = Motion()
        self.reset()

    def reset(self) -> None:
        """Forget all observations and return to the initial guess; commands are kept."""
        self._guess = logarithms(self._initial)
        self._passed = self._guess[:2]  # what the running simulation is known to have
        self._past: list[Observation] = []
        self._anchor: Simulation | None = None  # where the window starts, once it has moved
        self._spans: tuple[tuple[float, float], int] | None = None
        self._pass: _Pass | None = None
        self._summary = np.zeros((4, 4))  # information from before the window
        self._centre = self._guess.copy()  # and where that information is centred
        self._pending = list(TRIALS)
        self._repeats = 1.0
        self._told = np.zeros((4, 4))  # by the present pass, when it was last judged
        self._judged: _Pass | None = None
        self._estimate = summarise(self._initial, self._guess, np.zeros((4, 4)))

    @property
    def estimate(self) -> Estimate:
        """The present estimate."""
        return self._estimate

    def set_command(self, command: Command) -> None:
        """Take an imposed motion; past observations it bears on are judged anew with it."""
        self._motion.add(command)
        if self._past and command.stamp < self._past[-1].stamp:
            self._run_again(self._current())

    def observe(self, observation: Observation) -> None:
        """Take an observed spline and update the estimate.

        A spline that is older than the last one is put in its place; one that the model cannot
        follow is left out with a warning.
        """
        if len(observation.control_points) != self._initial.rod.control_points:
            raise InputError(
                f"the observed spline has {len(observation.control_points)} control points; "
                f"rod.control_points is {self._initial.rod.control_points}"
            )
        if not self._motion.commands:
            return
        observation = along(self._motion, observation, self._initial.rod.length)
        if any(o.stamp == observation.stamp for o in self._past[-50:]):
            return
        late = bool(self._past) and observation.stamp < self._past[-1].stamp
        self._past.append(observation)
        if late:
            if observation.stamp < self._past[0].stamp:
                self._past.pop()  # from before the window: its place is gone
                return
            self._past.sort(key=lambda o: o.stamp)
            return  # it counts from the next relinearisation on
        try:
            self._follow()
        except SimulationError as err:
            LOG.warning("the model cannot follow the observed motion: %s", err)
            self._pass = None
            self._past = [observation]
            return
        self._conclude()

    def _follow(self) -> None:
        """Bring the running pass up to the last observation, starting one where there is none."""
        if self._pass is None:
            needed = 2 if self._initial.simulation.start == "moving" else 1
            if len(self._past) >= needed:
                self._pass = self._run(self._current(), MATERIAL)
            return
        self._pass.add(self._past[-1], self._white)

    def _current(self) -> FloatArray:
        theta = logarithms(self._estimate.settings)
        return np.where(np.isfinite(self._guess), theta, self._guess)

    def _run(self, theta: FloatArray, parameters: Sequence[str], spans: int | None = None) -> _Pass:
        """Simulate the past with given parameters."""
        settings = self._finer(with_logarithms(self._initial, theta))
        new_start = self._anchor is None
        if self._anchor is not None:
            simulation = self._anchor.fork(settings)
        else:
            ratio = settings.rod.specific_modulus
            key = (ratio, settings.simulation.tolerance)
            if spans is None and self._spans and self._comparable(key):
                spans = self._spans[1]
            simulation = Simulation(settings, self._motion, parameters=parameters, spans=spans)
            simulation.start(self._past[:2], self._past[-1].stamp)
            if spans is None:
                self._spans = (key, simulation.model.basis.spans)
        new = _Pass(theta, simulation)
        first = 1 if new_start and settings.simulation.start == "moving" else 0
        for observation in self._past[first:]:
            new.add(observation, self._white)
        return new

    def _comparable(self, key: tuple[float, float]) -> bool:
        """Whether E/mu and tolerance are near those for which the knot spans were judged."""
        assert self._spans is not None
        ratios = [a / b for a, b in zip(key, self._spans[0], strict=True)]
        return all(1 / 1.5 < r < 1.5 for r in ratios)

    def _finer(self, settings: Settings) -> Settings:
        """Ask for a simulation whose own error lies below the noise, once that is known."""
        run = self._pass
        if run is None or run.used < REPEATS_EVERY:
            return settings
        return within_noise(settings, (run.power / run.used) ** 0.5)

    def _run_again(self, theta: FloatArray) -> None:
        try:
            self._pass = self._run(theta, MATERIAL)
        except SimulationError as err:
            LOG.warning("the past cannot be simulated with the new estimate: %s", err)

    def _conclude(self) -> None:
        """Solve for the estimate, try rivals where due, and relinearise where needed."""
        if self._pass is None or self._pass.used < FEWEST:
            return
        elapsed = (self._past[-1].stamp - self._past[0].stamp) / NANOSECONDS
        if self._pending and elapsed >= self._pending[0]:
            self._pending = [t for t in self._pending if t > elapsed]
            self._try_rivals()
        for _ in range(3):
            theta = self._solve(self._pass)
            step = theta - self._pass.theta
            step = np.where(np.isfinite(step), step, 0.0)
            if self._linear(self._pass, step):
                break
            step *= min(1.0, LONGEST_STEP / float(np.abs(step).max()))
            previous = self._pass
            self._run_again(previous.theta + step)
            if self._pass.power > previous.power and self._pass.used == previous.used:
                # The step was too long for a linear model: halve it, keep the better one.
                self._run_again(previous.theta + 0.3 * step)
                if self._pass.power > previous.power:
                    self._pass = previous
                    theta = previous.theta
                    break
        self._publish(theta)
        if elapsed > WINDOW:
            self._fold()

    def _linear(self, run: _Pass, step: FloatArray) -> bool:
        """Whether a step is so short that what the linear model neglects lies below the noise."""
        # Damping is a nuisance here: it may be further off before it matters to E/mu.
        largest = max(abs(float(step[0] - step[1])), NUISANCE_WEIGHT * float(np.abs(step).max()))
        effect = np.sqrt(max(float(step @ run.normal @ step) * self._scale(run), 0.0))
        return largest < SHORTEST_STEP or largest * effect < NEGLECTED

    def _scale(self, run: _Pass) -> float:
        """Information per squared metre of residual, correlation left aside."""
        count = 2 * run.used * self._initial.rod.control_points
        variance = max(run.power / max(count - 2, 1), SMALLEST_STD**2)
        return 1.0 / variance

    def _solve(self, run: _Pass) -> FloatArray:
        prior = search_information(self._initial)
        scale = self._scale(run) / self._repeats
        usable = np.isfinite(self._guess)
        off = np.where(usable, run.theta - self._guess, 0.0)
        old = np.where(usable, run.theta - self._centre, 0.0)
        lhs = scale * run.normal + prior + self._summary
        rhs = scale * run.gradient - prior @ off - self._summary @ old
        return run.theta + np.linalg.solve(lhs, rhs)

    def _publish(self, theta: FloatArray) -> None:
        run = self._pass
        assert run is not None
        white = run.normal * self._scale(run)
        every = REPEATS_EVERY * max(1, run.used // 100)
        if run.used % every == 0 or run is not self._judged or run.used < REPEATS_EVERY:
            told = run.information()
            if told[0, 0] > 0.0:
                self._repeats = max(1.0, float(white[0, 0] / told[0, 0]))
            self._told, self._judged = told, run
        information = self._told + self._summary
        low, high = self._guess - np.log(1e4), self._guess + np.log(1e4)
        theta = np.where(np.isfinite(self._guess), np.clip(theta, low, high), self._guess)
        estimate = summarise(self._initial, theta, information)
        change = logarithms(estimate.settings)[:2] - self._passed
        known = estimate.identifiable["density"]
        scale = float(np.abs(change).max()) * (1.0 if known else UNKNOWN_WEIGHT)
        if max(scale, abs(float(change[0] - change[1]))) > SIGNIFICANT:
            self._passed = self._passed + change
            estimate = replace(estimate, significant=True)
        self._estimate = estimate

    def _try_rivals(self) -> None:
        """Replace the pass by one from another E/mu where that explains the past better."""
        run = self._pass
        assert run is not None
        best, least = None, run.power
        spans = 2 * (self._initial.rod.control_points - 3)
        thetas = []
        for factor in RIVALS:
            theta = run.theta.copy()
            theta[0] = self._guess[0] - self._guess[1] + theta[1] + np.log(factor)
            thetas.append(theta)
        sets = [with_logarithms(self._initial, theta) for theta in thetas]
        past = Manipulation("past", tuple(self._motion.commands), tuple(self._past))
        for theta, rival in zip(thetas, forecast_each(past, sets, spans=spans), strict=True):
            power = np.inf if rival is None else float(np.sum(rival.residual**2))
            if power < 0.5 * least:
                best, least = theta, power
        if best is not None:
            self._run_again(best)

    def _fold(self) -> None:
        """Keep what the window has told as a summary, and start a new one at the present state."""
        run = self._pass
        assert run is not None
        theta = self._current()
        self._summary = FORGETTING * self._summary + self._told
        self._told = np.zeros((4, 4))
        self._centre = theta
        self._past = []
        self._anchor = run.simulation.fork(with_logarithms(self._initial, theta))
        self._pass = _Pass(theta, self._anchor.fork(self._anchor.settings))
        self._pending = []
