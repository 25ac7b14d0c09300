# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Simulate a DLO under imposed motion: the rod, its start, its resolution, what is published."""

from __future__ import annotations

import logging
from collections.abc import Generator, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.observation import Observation
from dlo_ros.rod import dynamics, resolution
from dlo_ros.rod.boundary.command_timeline import CommandTimeline
from dlo_ros.rod.boundary.conditions import HELD
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.loads.grip_reactions import Loading, dense, loadings, loadings_along
from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.motion_validation import possible, steady
from dlo_ros.rod.packing import nothing_varies, true_command
from dlo_ros.rod.planar_model import in_plane
from dlo_ros.rod.prediction import Prediction
from dlo_ros.rod.sensitivity_parameters import compiled, tangent
from dlo_ros.rod.state import (
    State,
    refined,
    rest_state,
    strains_of,
    twist_angle,
    with_history,
)
from dlo_ros.rod.statics import hold, reachable, relax_stretch, settle
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import DEGREE, FloatArray, SplineBasis

LOG = logging.getLogger(__name__)

RECHECK_RATIO = 1.5  # change of E/mu after which the resolution is judged anew


class Simulation:
    """One simulated DLO.

    Args:
        settings: the parameter file.
        motion: the imposed motion; commands may be added while the simulation runs.
        parameters: by which derivatives are wanted, named as in `sensitivity_parameters`.
        spans: knot spans of the simulation; default: as many as simulation.tolerance needs.
        loads: whether predictions say what the DLO and its grips bear.

    Raises:
        InputError: an unknown parameter is asked for.
    """

    def __init__(
        self,
        settings: RodSettings,
        motion: Motion,
        *,
        parameters: Sequence[str] = (),
        spans: int | None = None,
        loads: bool = False,
    ) -> None:
        for name in parameters:
            tangent(settings, name)
        self.settings = settings
        self.motion = motion
        self.published = SplineBasis(settings.rod.control_points, settings.rod.length)
        self.parameters = tuple(parameters)
        self._spans, self._loads = spans, loads
        self._timeline = CommandTimeline(motion)
        self._measurement = MeasurementMap(settings, self.parameters)
        self.resolution: resolution.Resolution | None = None
        self.state: State | None = None
        self.stable = True
        self._flat = False  # whether the first equilibrium is one in the plane
        self._judged = settings.rod.specific_modulus

    def start(self, observations: Sequence[Observation], last_stamp: int | None = None) -> None:
        """Set the initial state as simulation.start says.

        Args:
            observations: the first observed shapes; one, or two for `moving`.
            last_stamp: until when the motion matters for the resolution [ns]; default: the
                command's end.

        Raises:
            InputError: too few observations, a wrong number of control points, no command.
            SimulationError: no equilibrium, or imposed ends out of reach.
        """
        for _ in self.starting(observations, last_stamp):
            pass
        self.warn_of_instability()

    def warn_of_instability(self) -> None:
        """Log a warning where a real DLO would leave the equilibrium that was started from.

        It is no news where the parameters are a hypothesis, such as an effect that is tried.
        """
        if not self.stable:
            LOG.warning(
                "a real DLO would not stay in the first shape at rest: it is unstable%s",
                " out of the plane y = 0, in which it is simulated all the same"
                if self._flat
                else "",
            )

    def starting(
        self, observations: Sequence[Observation], last_stamp: int | None = None
    ) -> Generator[None, None, None]:
        """As `start`, piece by piece for who must not wait; whether it is stable is not told."""
        if self._spans is None:
            yield from self.judging(observations, last_stamp)
        assert self._spans is not None
        mode = self.settings.simulation.start
        seen, command, shape = self._beginning(observations)
        first = seen[-1]
        model, boundary = resolution.build(self.settings, command, self._spans)
        lift = model.basis.projection(self.published)
        at_rest = rest_state(first.stamp, lift @ shape, model)
        yield
        if mode == "equilibrium":
            moved = true_command(model, command)
            self._flat = in_plane(model, at_rest, moved, self.parameters)
            compiled(model, boundary, command, self.parameters, flat=self._flat)  # is kept
            yield
            found = settle(
                model, boundary, at_rest, command, first.stamp, fresh=True,
                parameters=self.parameters,
            )  # fmt: skip
            state, self.stable = found.state, found.stable
            if found.buckled:
                LOG.info(
                    "the DLO buckles on its way to its first equilibrium; where nothing decides "
                    "between two sides, its weight or the camera's first shape should"
                )
        else:
            held = hold(model, boundary, at_rest, command, first.stamp)
            reachable(model, held, boundary)
            state = rest_state(
                first.stamp, relax_stretch(model, boundary, held, lift @ shape), model
            )
            if mode == "moving":
                before = seen[0]
                elapsed = (first.stamp - before.stamp) / NANOSECONDS
                if elapsed <= 0.0:
                    raise InputError("the first two observed shapes have the same stamp")
                velocity = lift @ (shape - self._measurement.true(before.control_points)) / elapsed
                velocity[:, 3] = 0.0
                state = replace(state, velocity=velocity)
            state = self._insensitive(state)
            state = dynamics.with_consistent_acceleration(
                model, boundary, state, command, self.parameters
            )
        self._judged = self.settings.rod.specific_modulus
        self._timeline.following = command
        self.state, self.model, self.boundary = state, model, boundary

    def judging(
        self, observations: Sequence[Observation], last_stamp: int | None = None
    ) -> Generator[None, None, None]:
        """Find the resolution that `start` needs, piece by piece; arguments as there.

        Raises:
            InputError, SimulationError: as `start`.
        """
        observations, command, shape = self._beginning(observations)
        first = observations[-1].stamp
        stop = command.end_stamp if last_stamp is None else last_stamp - self._measurement.later
        stamps = np.linspace(first, max(stop, first), 200).astype(np.int64)
        self.resolution = yield from resolution.choosing(
            self.settings, command, shape, [int(s) for s in stamps]
        )
        self._spans = self.resolution.spans

    def _beginning(
        self, observations: Sequence[Observation]
    ) -> tuple[list[Observation], Command, FloatArray]:
        """The observations that are needed, at true instants; the command; the true first shape."""
        mode = self.settings.simulation.start
        needed = 2 if mode == "moving" else 1
        if len(observations) < needed:
            raise InputError(f"simulation.start '{mode}' needs {needed} observed shapes")
        n = self.published.control_points
        for observation in observations[:needed]:
            if len(observation.control_points) != n:
                raise InputError(
                    f"the observed spline has {len(observation.control_points)} control points; "
                    f"rod.control_points is {n}"
                )
        possible(self.settings)
        seen = [replace(o, stamp=o.stamp - self._measurement.later) for o in observations[:needed]]
        self._timeline.began = seen[0].stamp
        command = self._command(seen[-1].stamp)
        shape = self._measurement.true(seen[-1].control_points)
        return seen, command, shape

    @property
    def stamp(self) -> int:
        """The simulated instant, as it is seen [ns]."""
        return self._started().stamp + self._measurement.later

    def fork(
        self, settings: RodSettings, motion: Motion | None = None, *, loads: bool | None = None
    ) -> Simulation:
        """An independent simulation that goes on from the present state with other parameters.

        Args:
            motion: imposed from here on; default: the same. One of its own suits another thread.
            loads: as in the class; default: as here.
        """
        twin = copy(self)
        twin._loads = self._loads if loads is None else loads
        twin._timeline = self._timeline.another()
        if motion is not None:
            twin.motion = twin._timeline.motion = motion
        twin.update(settings)
        return twin

    def carrying(self, state: State, parameters: Sequence[str]) -> Simulation:
        """One that goes on from a state whose sensitivities to parameters were found elsewhere."""
        twin = copy(self)
        twin.state, twin.parameters = state, tuple(parameters)
        twin._timeline, twin._measurement = (
            self._timeline.another(),
            MeasurementMap(self.settings, parameters),
        )
        return twin

    def _insensitive(self, state: State) -> State:
        """The state as given, whatever the parameters are."""
        count = len(self.parameters)
        return replace(state, sensitivity=nothing_varies(state, count) if count else None)

    def _command(self, stamp: int) -> Command:
        return self._timeline.at(stamp, slips=self.settings.slips)

    def advance(self, stamp: int) -> Prediction:
        """Simulate to a stamp [ns]; see `advance_through`."""
        if stamp == self.stamp:
            return self.prediction()
        return self.advance_through([stamp])[0]

    def advance_through(self, stamps: Sequence[int]) -> list[Prediction]:
        """Simulate to a series of stamps [ns], growing.

        Raises:
            InputError: not started, or a stamp lies before the present instant.
            SimulationError: the motion cannot be followed; the state stays as it was.
        """
        state, model, boundary = self._started(), self.model, self.boundary
        if stamps and stamps[0] < self.stamp:
            raise InputError(
                f"the simulation is at {self.stamp / NANOSECONDS:.3f} s and cannot go back to "
                f"{stamps[0] / NANOSECONDS:.3f} s; reset it"
            )
        stamps = [stamp - self._measurement.later for stamp in stamps]
        predictions: list[Prediction] = []
        course = self._timeline.another()
        for stops in course.legs(state.stamp, stamps):
            command = course.at(max(stops[0] - 1, state.stamp), slips=self.settings.slips)
            held = boundary.names
            if command.names != held:
                state, model, boundary = self._regrip(state, command)
            steady(boundary, state, true_command(model, command), stops[-1], held)
            command = course.begin(state.stamp, command, state.q, model.basis)
            course.following = command
            # In space the twist angle of a shape needs its whole state, so stops come one by one.
            together = in_plane(model, state, command, self.parameters) and (
                not self._loads or (model.plain and dense([state.stamp, *stops]))
            )
            made: list[State] = []
            for leg in [stops] if together else [[s] for s in stops]:
                for stop in leg:
                    reachable(model, hold(model, boundary, state, command, stop), boundary)
                before, several = state, len(leg) > 1
                asked = (model, boundary, state, command, leg, self.parameters)
                track = dynamics.follow(*asked, speeds=self._loads and several)
                state = track.state
                if not several:
                    made += [state] * (leg[0] in stamps)
                    continue
                borne = loadings_along(model, boundary, before, leg, track) if self._loads else []
                down = self.published.projection(model.basis)
                for k, stop in enumerate(leg):
                    if stop in stamps:
                        seen = down @ track.shapes[k], down, track.speeds[k], track.derivatives[k]
                        predictions.append(self._seen(stop, *seen, borne[k] if borne else None))
            borne = loadings(model, boundary, made, command) if self._loads and made else []
            for one in made:
                predictions.append(self._published(one, model, borne.pop(0) if borne else None))
        self.state, self.model, self.boundary, self._timeline = state, model, boundary, course
        return predictions

    def _regrip(self, state: State, command: Command) -> tuple[State, RodModel, Boundary]:
        """The state with the boundary conditions of a command that holds other things."""
        assert self._spans is not None
        model, boundary = resolution.build(self.settings, command, self._spans)
        frames = state.frames.copy()
        frames[:, HELD] = 0.0  # a new grip takes the DLO as it is
        now = strains_of(state.q, model, state.reference)
        state = replace(state, frames=frames, strains=now, previous=now, last_step=0.0)
        return self._insensitive(state), model, boundary

    def hold(self, stamp: int) -> None:
        """Stand still until a stamp [ns]: what a motion that cannot be followed leaves to do."""
        state, stamp = self._started(), stamp - self._measurement.later
        zero = np.zeros_like(state.q)
        self.state = self._insensitive(
            replace(
                state, stamp=stamp, velocity=zero, acceleration=zero, auxiliary=zero,
                previous=state.strains, last_step=0.0, next_step=0.0,
            )
        )  # fmt: skip

    def resettle(self, stamp: int) -> Prediction:
        """Come to rest under the command at a stamp [ns], led there from the present shape.

        Raises:
            SimulationError: there is no equilibrium; the state stays as it was.
        """
        state, model, boundary = self._started(), self.model, self.boundary
        stamp -= self._measurement.later
        command = self._command(stamp)
        if command.names != boundary.names:
            state, model, boundary = self._regrip(state, command)
        state = settle(model, boundary, state, command, stamp).state
        state = self._insensitive(state)
        self._timeline.following = command
        self.state, self.model, self.boundary = state, model, boundary
        return self.prediction()

    def prediction(self) -> Prediction:
        """The present shape in the published basis."""
        state, command, borne = self._started(), self._timeline.following, None
        if self._loads and command is not None:
            (borne,) = loadings(self.model, self.boundary, [state], command)
        return self._published(state, self.model, borne)

    def _published(self, state: State, model: RodModel, borne: Loading | None = None) -> Prediction:
        down = self.published.projection(model.basis)
        derivative = None if state.sensitivity is None else state.sensitivity.q
        shape = state.q.copy()
        shape[:, 3] = twist_angle(state, model)
        return self._seen(state.stamp, down @ shape, down, state.velocity, derivative, borne)

    def _seen(
        self, stamp: int, shape: FloatArray, down: FloatArray, velocity: FloatArray,
        derivative: FloatArray | None, borne: Loading | None = None,
    ) -> Prediction:  # fmt: skip
        """A shape (n, 4) in the published basis, as and when the camera measures it.

        Args:
            down: projection onto the published basis.
            velocity, derivative: in the simulation's basis, shape (m, 4) and (P, m, 4).
            borne: see `Prediction.loading`.
        """
        stamp, seen = stamp + self._measurement.later, self._measurement.measured(shape)
        if not self.parameters or derivative is None:
            return Prediction(stamp, seen, loading=borne)
        change = np.einsum("ij,pjc->pic", down, derivative[:, :, :3])
        speed = (down @ velocity)[:, :3]
        return Prediction(stamp, seen, self._measurement.sensitivity(shape, speed, change), borne)

    def update(self, settings: RodSettings) -> None:
        """Change material, damping, gravity, effects or tolerance while the simulation runs.

        The basis is refined where the new parameters need it (never coarsened). A DLO of another
        length comes to rest first.

        Raises:
            SimulationError: effects leave no DLO; nothing is changed then.
        """
        possible(settings)
        self.settings = settings
        self._measurement = MeasurementMap(settings, self.parameters)
        if self.state is None:
            return
        before, self.model = self.model, self.model.with_settings(settings)
        if self.model.remembers != before.remembers:
            self.state = self._insensitive(with_history(self.state, self.model))
        if self.model.body.lengthening != before.body.lengthening:
            try:
                self.resettle(self.stamp)
            except SimulationError as err:
                LOG.warning("the DLO goes on with its other length from where it was: %s", err)
        ratio = settings.rod.specific_modulus / self._judged
        if max(ratio, 1.0 / ratio) < RECHECK_RATIO or self.resolution is None:
            return
        self._judged = settings.rod.specific_modulus
        command = self._command(self.state.stamp)
        stamps = np.linspace(self.state.stamp, max(command.end_stamp, self.state.stamp), 200)
        shape = self.prediction().control_points
        try:
            found = resolution.choose(settings, command, shape, [int(s) for s in stamps])
            if found.spans > self.model.basis.spans:
                finer, boundary = resolution.build(settings, command, found.spans)
                self.state = self._insensitive(refined(self.state, self.model, finer))
                self.model, self.boundary = finer, boundary
                self._spans, self.resolution = found.spans, found
        except SimulationError as err:
            LOG.warning("the resolution could not be judged anew: %s", err)

    def _started(self) -> State:
        if self.state is None:
            raise InputError("the simulation has no initial shape yet")
        return self.state

    @property
    def control_points(self) -> int:
        """Control points of the simulation's own basis."""
        return (self._spans or self.published.spans) + DEGREE
