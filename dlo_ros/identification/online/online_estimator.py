# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Live identification of (E, mu) while the DLO moves.

A model of its own runs along with the observed splines and carries exact sensitivities. Every
observation adds its information to a linearised least-squares problem (a recursive Gauss-Newton
filter on ln E, ln mu, ln c, ln t_r). When the estimate has moved away from where the model was
linearised, the recent past is simulated again with the new parameters, so that early steps taken
far from the truth leave no trace. At a few moments after the start, rival values of E/mu are tried
on that past, since far from the truth a shape may lie on another branch.

Nothing of that keeps a caller waiting: what takes long is done piece by piece, some with every
observation, and until it is ready the estimate goes on from the old linearisation.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dlo_ros.command import Command, Motion
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.cooperative_tasks import LONG, SHORT, Pieces, Worker
from dlo_ros.identification.estimate import (
    Estimate,
    logarithms,
    search_information,
    searchable,
    summarise,
    with_logarithms,
    within_noise,
)
from dlo_ros.identification.information import model_shift
from dlo_ros.identification.online.accumulated_information import (
    AUTOCORRELATION_EVERY,
    FORGETTING,
    AccumulatedInformation,
)
from dlo_ros.identification.online.linearised_model import (
    SHORTEST_STEP,
    JudgedResolution,
    Linearised,
    PriorInformation,
    Run,
)
from dlo_ros.identification.online.observed_window import ObservedWindow
from dlo_ros.identification.online.online_force_scale import Forces
from dlo_ros.identification.online.rival_branches import best_rival
from dlo_ros.identification.online.set_up_errors import BEGINNING, SETTLED, SetUpErrors
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.model_registry import simulation_of
from dlo_ros.spline import DEGREE, FloatArray

LOG = logging.getLogger(__name__)

BUDGET = 0.0028  # [s] of processor time that an update takes where work is due
PIECE_SHARE = 0.4  # of the budget that a piece of work should take
# Observations that are simulated again in a piece; one a time would never catch up.
FEWEST_AT_ONCE, MOST_AT_ONCE = 2, 20
ITERATIONS = 4  # before the work begins that else would wait
WINDOW = 20.0  # [s] of past that is simulated again; older information is kept as a summary
RETRY_GROWTH = 1.2  # growth of the past after which a failed relinearisation is tried again
TRIALS = (0.3, 0.8, 1.6, 3.2)  # [s] of past after which rivals are tried
UNKNOWN_WEIGHT = 0.1  # of a change that leaves E/mu alone where only E/mu is determined
ASSUMED_ERROR = 1e-3  # of L: the simulation's own error that is reckoned with before it is judged


class OnlineEstimator:
    """Recursive estimator of (E, mu).

    Feed it commands and observed splines as they come; read `estimate` whenever.

    Args:
        settings: initial guess, prior knowledge, how the simulation starts.
        budget: see `BUDGET`; infinite: everything that is due is done at once [s].
        clock: function that returns the time by which the budget counts [s].
    """

    def __init__(
        self,
        settings: Settings,
        *,
        budget: float = BUDGET,
        clock: Callable[[], float] = time.thread_time,
    ) -> None:
        self._initial = searchable(settings)
        self._motion = Motion()
        self._worker = Worker(budget, clock)
        self._set_up_worker = Worker(budget, clock)
        self.reset()

    def reset(self) -> None:
        """Forget all observations and return to the initial guess; commands are kept."""
        self._guess = logarithms(self._initial)
        self._passed = self._guess[:2]  # what the running simulation is known to have
        self._past = ObservedWindow(self._motion, self._initial.rod.length)
        self._judged_resolution: JudgedResolution | None = None
        self._run: Run | None = None
        self._worker.drop()
        self._stale = False  # whether the past is simulated with a motion that was not the true one
        self._retry = 0  # observations before which a relinearisation need not be tried again
        self._prior = PriorInformation(search_information(self._initial), self._guess)
        self.forces = Forces(self._initial)
        self._pending = list(TRIALS)
        self._information = AccumulatedInformation()
        self._set_up_worker.drop()
        self._set_up = SetUpErrors(self._initial)
        self._estimate = summarise(self._initial, self._guess, np.zeros((4, 4)))

    @property
    def estimate(self) -> Estimate:
        """The present estimate."""
        return self._estimate

    @property
    def run(self) -> Run | None:
        """The model along the observations; None before the first ones."""
        return self._run

    @property
    def settings(self) -> Settings:
        """The parameter file with the physics that the model runs along with."""
        run = self._run
        return self._initial if run is None else self._initial.with_physics(run.simulation.settings)

    @property
    def busy(self) -> bool:
        """Whether work is left that `observe` or `proceed` will continue."""
        return self._worker.busy or self._set_up_worker.busy or self._set_up_is_due()

    def window(self) -> Manipulation | None:
        """Commands and observations since the start; None once the beginning is dropped."""
        return self._past.manipulation()

    def set_command(self, command: Command) -> None:
        """Take an imposed motion; past observations it bears on are judged anew with it."""
        self._stale |= self._past.impose(command)

    def observe(self, observation: Observation) -> None:
        """Take an observed spline and update the estimate.

        A spline that is older than the last one is put in its place; one that the model cannot
        follow is left out with a warning.

        Raises:
            InputError: it has another number of control points.
        """
        begin = self._worker.clock()
        if len(observation.control_points) != self._initial.rod.control_points:
            raise InputError(
                f"the observed spline has {len(observation.control_points)} control points; "
                f"rod.control_points is {self._initial.rod.control_points}"
            )
        if not self._motion.commands:
            return
        if not self._past.add(observation):
            return  # one that came late counts from the next relinearisation on
        if self._run is not None:
            try:
                self._run.add(self._past.observations[-1:])
            except SimulationError as err:
                # A command that came late may lead from where it never was; see `_stale`.
                if not (self._stale or self._worker.busy):
                    self._start_over(err)
        self._worker.turn(begin, self._due)
        self._publish()
        if math.isinf(self._worker.budget) and self._set_up_is_due():
            self._set_up_worker.turn(begin, self._examine_set_up)
            self._publish()
        self._fold()

    def proceed(self) -> None:
        """Go on with the work that the last observation left over; see `busy`."""
        if self._worker.busy:
            self._worker.turn(self._worker.clock(), self._due)
        elif self.busy:
            # Its pieces are too long for an update.
            self._set_up_worker.turn(self._worker.clock(), self._examine_set_up)
        else:
            return
        self._publish()

    def _start_over(self, err: SimulationError) -> None:
        """Forget a past that the model cannot follow."""
        LOG.warning("the model cannot follow the observed motion: %s", err)
        self._run = None
        self._past.forget()
        self._worker.drop()

    def _due(self) -> Pieces[None]:
        """All that is due, piece by piece."""
        if self._run is None:
            if len(self._past.observations) > (self._initial.simulation.start == "moving"):
                yield from self._adopt(logarithms(self._estimate.settings))
                if self._run is None:
                    self._past.forget()
            return
        if self._stale:
            self._stale = False
            yield from self._adopt(logarithms(self._estimate.settings))
        if self._run.used < BEGINNING:
            return
        elapsed = self._past.elapsed
        rival = None
        if self._pending and elapsed >= self._pending[0]:
            self._pending = [t for t in self._pending if t > elapsed]
            past = self.window()
            if past is not None:
                rival = yield from best_rival(past, self._run, self._initial)
        yield from self._information.measure(self._run, self._prior)
        if rival is not None:
            yield from self._adopt(rival)
            yield from self._information.measure(self._run, self._prior)
        yield from self._relinearise()
        if elapsed >= SETTLED:
            yield from self._judge_resolution()
        yield from self.forces.weigh(self._run, self._past, self._prior)

    def _adopt(self, theta: FloatArray) -> Pieces[None]:
        """Take over a run with given parameters, where the past can be simulated with them."""
        self._run = (yield from self._again(theta)) or self._run

    def _again(self, theta: FloatArray) -> Pieces[Run | None]:
        """Simulate the past with given parameters; None where that fails."""
        settings = with_logarithms(self._initial, theta)
        spans, error = self._resolution(settings)
        if error < ASSUMED_ERROR:
            settings = self._finer(settings)
        yield LONG
        try:
            simulation = yield from self._past.started(settings, spans)
            run = Run(Linearised(theta), simulation, self._past.noise_unit, error)
            yield from self._catch_up(run)
            return run
        except SimulationError as err:
            LOG.warning("the past cannot be simulated with the new estimate: %s", err)
            return None

    def _catch_up(self, run: Run) -> Pieces[None]:
        """Lead a run through the observations that it has not seen yet."""
        size = FEWEST_AT_ONCE
        while self._unseen(run):
            yield SHORT
            piece = self._unseen(run)[:size]
            begin = self._worker.clock()
            run.add(piece)
            share = (self._worker.clock() - begin) / (PIECE_SHARE * self._worker.budget)
            size = int(min(max(len(piece) / max(share, 0.01), FEWEST_AT_ONCE), MOST_AT_ONCE))

    def _unseen(self, run: Run) -> list[Observation]:
        """The observations that a run has not reached yet."""
        seen = run.stamps[-1] if run.stamps else run.simulation.stamp - (self._past.anchor is None)
        return self._past.after(seen)

    def _resolution(self, settings: Settings) -> tuple[int, float]:
        """Knot spans to simulate with, and the error that they have over L."""
        judged = self._judged_resolution
        if judged is not None and judged.holds(self._finer(settings)):
            return judged.spans, judged.error
        # Twice the published ones, until the parameters are worth a closer look.
        return 2 * (settings.rod.control_points - DEGREE), ASSUMED_ERROR

    def _judge_resolution(self) -> Pieces[None]:
        """Judge the simulation's own error at the estimate; refine where it is too large."""
        run = self._run
        assert run is not None
        settings = self._finer(with_logarithms(self._initial, run.at.theta))
        before = self._judged_resolution
        if self._past.anchor is not None or (before is not None and before.holds(settings)):
            return
        judge, seen = simulation_of(settings, self._motion), self._past.observations
        spans, error = run.simulation.basis.even_spans, ASSUMED_ERROR
        try:
            yield from judge.judging(seen[:2], seen[-1].stamp)
            if judge.resolution is not None:
                spans, error = judge.resolution.spans, judge.resolution.error
        except SimulationError as err:
            LOG.warning("the resolution cannot be judged: %s", err)
        self._judged_resolution = JudgedResolution(settings, spans, error)
        if spans == run.simulation.basis.even_spans:
            run.error = error
        else:
            yield from self._adopt(run.at.theta)

    def _finer(self, settings: Settings) -> Settings:
        """Ask for a simulation whose own error lies below the noise, once that is known."""
        run = self._run
        if run is None or run.used < AUTOCORRELATION_EVERY:
            return settings
        return within_noise(settings, math.sqrt(run.at.left(self._prior.step(run.at)) / run.used))

    def _relinearise(self) -> Pieces[None]:
        """Simulate the past anew while the estimate lies beyond what a linear model is good for."""
        for _ in range(ITERATIONS):
            run = self._run
            assert run is not None
            step = self._prior.step(run.at)
            if self._prior.linear(run.at, step) or run.used < self._retry:
                return
            for share in (1.0, 0.3):
                # A step that makes things worse was too long for a linear model.
                new = yield from self._again(run.at.theta + share * step)
                if (
                    new is not None
                    and new.at.sum_of_squares / new.used <= run.at.sum_of_squares / run.used
                ):
                    self._run = new
                    yield from self._information.measure(new, self._prior)
                    break
            else:
                self._retry = int(RETRY_GROWTH * run.used) + 1
                return

    def _set_up_is_due(self) -> bool:
        return self._set_up.due(self._run, self._past, self._estimate)

    def _examine_set_up(self) -> Pieces[None]:
        try:
            yield from self._set_up.compute(self._run, self._past, self._estimate, self._prior)
        except SimulationError as err:
            LOG.info("the set-up's tolerances are not looked at: %s", err)

    def _publish(self) -> None:
        """Solve for the estimate."""
        run = self._run
        if run is None or run.used < BEGINNING:
            return
        at = run.at
        step = self._prior.step(at)
        linear = self._prior.linear(at, step)
        stuck = not linear and run.used < self._retry
        theta = at.theta if stuck else at.theta + step
        information = self._prior.forces
        known = self._information.weighed(run, step, self._prior)
        if known is not None:
            shifts = (model_shift(run.simulation.settings), *self._set_up.shifts)
            information = information + known.information(*shifts)
        low, high = self._guess - np.log(1e4), self._guess + np.log(1e4)
        estimate = summarise(self._initial, np.clip(theta, low, high), information)
        change = logarithms(estimate.settings)[:2] - self._passed
        whole = estimate.identifiable["density"]
        scale = float(np.abs(change).max()) * (1.0 if whole else UNKNOWN_WEIGHT)
        large = max(scale, abs(float(change[0] - change[1]))) > SHORTEST_STEP
        significant = large and (linear or stuck)
        if significant:
            self._passed = self._passed + change
        self._estimate = replace(estimate, significant=significant, delay=self._set_up.delay)

    def _fold(self) -> None:
        """Keep the window's information as a summary, and start a new window at the present."""
        run = self._run
        elapsed = self._past.elapsed
        # Work that is under way may end first, but not for ever.
        if run is None or elapsed <= WINDOW or (self._worker.busy and elapsed <= 1.5 * WINDOW):
            return
        theta = logarithms(self._estimate.settings)
        step = self._prior.beyond(theta, run.at.theta)
        self._information.fold(run, step, self._prior)
        self._prior.fold(run.at, theta, FORGETTING)
        self.forces.fold()
        anchor = run.simulation.fork(with_logarithms(self._initial, theta))
        self._past.move(anchor)
        simulation = anchor.fork(anchor.settings)
        self._run = Run(Linearised(theta), simulation, self._past.noise_unit, run.error)
        self._worker.drop()
        self._pending, self._retry = [], 0
