# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The simulation of a DLO under imposed motion: start, resolution, steps, published shapes."""

from __future__ import annotations

import logging
from collections.abc import Generator, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from typing import ClassVar

import numpy as np

from dlo_ros.command import Command, Motion
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.observation import Observation
from dlo_ros.rod import dynamics, resolution
from dlo_ros.rod.boundary.command_timeline import CommandTimeline
from dlo_ros.rod.boundary.conditions import HELD
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.initial_state import beginning, initial_state
from dlo_ros.rod.loads.grip_reactions import Loading, dense, loadings, loadings_along
from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.motion_validation import in_order, possible, steady
from dlo_ros.rod.packing import insensitive, true_command
from dlo_ros.rod.parameter_names import acts_on_measurement
from dlo_ros.rod.planar_model import in_plane
from dlo_ros.rod.prediction import Prediction
from dlo_ros.rod.protocol import RodSimulation, instability
from dlo_ros.rod.sensitivity_parameters import variation_of
from dlo_ros.rod.simulation_batch import SimulationBatch, StartedSet
from dlo_ros.rod.state import State, refined, strains_of, twist_along, twist_angle, with_history
from dlo_ros.rod.statics import reachable_through, settle
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

LOG = logging.getLogger(__name__)

RESTING = 0.01  # speed over the length below which a DLO counts as resting [1/s]


class Simulation(RodSimulation):
    """One simulated DLO, a dynamic spline.

    Args:
        settings: the parameter file.
        motion: the imposed motion; commands may be added while the simulation runs.
        parameters: parameters by which derivatives are wanted, named as in
            `sensitivity_parameters`.
        spans: knot spans of the simulation; default: as many as simulation.tolerance needs.
        loads: whether predictions say what the DLO and its grips bear.

    Raises:
        InputError: an unknown parameter is asked for.
    """

    differentiable: ClassVar[bool] = True

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
            variation_of(settings, name)
        self.settings = settings
        self.motion = motion
        self.published = SplineBasis(settings.rod.control_points, settings.rod.length)
        self._differentiate_by(parameters)
        self._spans, self._loads = spans, loads
        self._timeline = CommandTimeline(motion)
        self.resolution: resolution.Resolution | None = None
        self.state: State | None = None
        self.stable = True
        self._flat = False  # whether the first equilibrium is one in the plane
        self._judged = settings.rod.specific_modulus

    def _differentiate_by(self, parameters: Sequence[str]) -> None:
        """Choose the parameters by which predictions have derivatives.

        The rod itself need not be differentiated by what acts on its measurement alone, unless it
        starts from a measured shape.
        """
        names = self.parameters = tuple(parameters)
        unmoved = self.settings.simulation.start == "equilibrium"
        moving = [k for k, n in enumerate(names) if not (unmoved and acts_on_measurement(n))]
        self._moving = np.array(moving, dtype=np.int64)
        self._rod_parameters = tuple(names[k] for k in moving)
        self._measurement = MeasurementMap(self.settings, names)

    def warn_of_instability(self) -> None:
        """Log a warning where a real DLO would leave the equilibrium that was started from.

        It is no news where the parameters are a hypothesis, such as an effect that is tried.
        """
        if not self.stable:
            LOG.warning("%s", instability(flat=self._flat))

    def starting(
        self, observations: Sequence[Observation], last_stamp: int | None = None
    ) -> Generator[None, None, None]:
        """The start as by `start`, in short pieces; stability is not reported."""
        if self._spans is None:
            yield from self.judging(observations, last_stamp)
        assert self._spans is not None
        begin = beginning(self.settings, self._timeline, self._measurement, observations)
        model, boundary = resolution.build(self.settings, begin.command, self._spans)
        found = yield from initial_state(
            model, boundary, begin, self._measurement, self._rod_parameters
        )
        self.stable, self._flat = found.stable, found.flat
        self._judged = self.settings.rod.specific_modulus
        self._timeline.following = begin.command
        self.state, self.model, self.boundary = found.state, model, boundary

    def judging(
        self, observations: Sequence[Observation], last_stamp: int | None = None
    ) -> Generator[None, None, None]:
        """Find the resolution that `start` needs, in short pieces; arguments as there.

        Raises:
            InputError, SimulationError: as `start`.
        """
        begin = beginning(self.settings, self._timeline, self._measurement, observations)
        stop = begin.command.end_stamp
        if last_stamp is not None:
            stop = last_stamp - self._measurement.later
        stamps = np.linspace(begin.stamp, max(stop, begin.stamp), 200).astype(np.int64)
        self.resolution = yield from resolution.choosing(
            self.settings, begin.command, begin.shape, [int(s) for s in stamps]
        )
        self._spans = self.resolution.spans

    @property
    def stamp(self) -> int:
        """The simulated instant, at the time of its measurement [ns]."""
        return self._started().stamp + self._measurement.later

    def fork(
        self, settings: RodSettings, motion: Motion | None = None, *, loads: bool | None = None
    ) -> Simulation:
        """An independent simulation that goes on from the present state with other parameters.

        Args:
            motion: imposed from here on; default: the same. One of its own suits another thread.
            loads: whether loads are computed, as in the class; default: as in this simulation.
        """
        twin = copy(self)
        twin._loads = self._loads if loads is None else loads
        twin._timeline = self._timeline.another()
        if motion is not None:
            twin.motion = twin._timeline.motion = motion
        twin.update(settings)
        return twin

    def with_sensitivities(self, parameters: Sequence[str], present: Command) -> Simulation:
        """An independent simulation; see `RodSimulation.with_sensitivities`."""
        twin = copy(self)
        twin._differentiate_by(parameters)
        names = twin._rod_parameters
        state = insensitive(self._started(), len(names))
        slowest = RESTING * self.published.length
        if names and self.model.plain and np.abs(state.velocity[:, :3]).max() < slowest:
            with suppress(SimulationError):
                state = settle(
                    self.model, self.boundary, state, present, state.stamp, parameters=names
                ).state
        twin.state, twin._timeline = state, self._timeline.another()
        return twin

    def batching(
        self, sets: Sequence[RodSettings], last_stamp: int
    ) -> Generator[None, None, SimulationBatch | None]:
        """Parameter sets of a rod that stays in the plane; see `RodSimulation.batching`."""
        state, begin = self._started(), self.stamp
        if any(begin < c.stamp < last_stamp for c in self.motion.commands):
            return None
        command = self.motion.at(begin)
        assert command is not None  # it has started
        model, boundary = self.model, self.boundary
        halved = model.basis.halvings > 0
        alike = all(one.batched and (halved or not one.gives) for one in sets)
        if not (alike and dynamics.in_lanes(model, boundary)):
            return None
        if not in_plane(model, state, true_command(model, command)):
            return None
        first = StartedSet(model, state, self.stable)
        return (yield from SimulationBatch.starting(first, sets[1:], boundary, command))

    def _insensitive(self, state: State) -> State:
        """The state with zero sensitivities: it does not depend on the parameters."""
        return insensitive(state, len(self._rod_parameters))

    def _command(self, stamp: int) -> Command:
        return self._timeline.at(stamp, slips=self.settings.slips)

    def advance_through(self, stamps: Sequence[int]) -> list[Prediction]:
        """Simulate to a series of stamps [ns], growing.

        Raises:
            InputError: not started, or stamps that do not grow from the present instant on.
            SimulationError: the motion cannot be followed; the state stays as it was.
        """
        state, model, boundary = self._started(), self.model, self.boundary
        in_order(self.stamp, stamps)
        stamps = [int(stamp) - self._measurement.later for stamp in stamps]
        predictions: list[Prediction] = []
        wanted = set(stamps)
        course = self._timeline.another()
        for stops in course.legs(state.stamp, stamps):
            command = course.at(max(stops[0] - 1, state.stamp), slips=self.settings.slips)
            held = boundary.names
            if command.names != held:
                state, model, boundary = self._regrip(state, command)
            steady(boundary, state, true_command(model, command), stops[-1], held)
            command = course.begin(state.stamp, command, state.q, model.basis)
            course.following = command
            flat = in_plane(model, state, true_command(model, command), self._rod_parameters)
            # In space the loads on a shape need its whole state, so stops come one by one.
            together = not self._loads or (flat and model.plain and dense([state.stamp, *stops]))
            fast = self._loads or bool(self.parameters)
            made: list[State] = []
            reachable_through(model, boundary, true_command(model, command), stops)
            for leg in [stops] if together else [[s] for s in stops]:
                before, several = state, len(leg) > 1
                asked = (model, boundary, state, command, leg, self._rod_parameters)
                track = dynamics.follow(*asked, speeds=fast and several, stepwise=self._loads)
                state = track.state
                if not several:
                    made += [state] * (leg[0] in wanted)
                    continue
                borne = loadings_along(model, boundary, before, leg, track) if self._loads else []
                shapes = track.shapes
                if not flat:
                    shapes[..., 3] = twist_along(model, shapes[:, 0, 3], track.twists)
                seen = self._seen(model, leg, shapes, track.speeds, track.derivatives, borne)
                predictions += [p for p, stop in zip(seen, leg, strict=True) if stop in wanted]
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
        """Keep the shape until a stamp [ns], where a motion cannot be followed."""
        state, stamp = self._started(), stamp - self._measurement.later
        zero = np.zeros_like(state.q)
        self.state = self._insensitive(
            replace(
                state, stamp=stamp, velocity=zero, acceleration=zero, auxiliary=zero,
                previous=state.strains, last_step=0.0, next_step=0.0,
            )
        )  # fmt: skip

    def resettle(self, stamp: int) -> Prediction:
        """Settle to equilibrium under the command at a stamp [ns], from the present shape.

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
        shape = state.q.copy()
        shape[:, 3] = twist_angle(state, model)
        change = np.zeros((0, *shape.shape)) if state.sensitivity is None else state.sensitivity.q
        loads = [borne] if borne else []
        return self._seen(
            model, [state.stamp], shape[None], state.velocity[None], change[None], loads
        )[0]

    def _seen(
        self, model: RodModel, stamps: Sequence[int], shapes: FloatArray, speeds: FloatArray,
        derivatives: FloatArray, borne: Sequence[Loading],
    ) -> list[Prediction]:  # fmt: skip
        """Shapes in the published basis, as the camera measures them.

        Args:
            stamps: S simulated instants [ns].
            shapes, speeds: control points in the simulation's basis with the axial twist as theta,
                and their velocities, shape (S, m, 4).
            derivatives: derivatives of the control points by the R parameters that move the rod,
                shape (S, R, m, 4).
            borne: see `Prediction.loading`; none where they are not wanted.
        """
        down, later = self.published.projection(model.basis), self._measurement.later
        shapes = down @ shapes
        seen, changes = self._measurement.measured(shapes), None
        if self.parameters and derivatives.shape[1] == len(self._moving):
            moves = np.zeros((len(stamps), len(self.parameters), *shapes.shape[1:-1], 3))
            moves[:, self._moving] = (down @ derivatives)[..., :3]
            changes = self._measurement.sensitivity(shapes, (down @ speeds)[..., :3], moves)
        return [
            Prediction(
                stamp + later, seen[k], None if changes is None else changes[k],
                borne[k] if borne else None,
            )
            for k, stamp in enumerate(stamps)
        ]  # fmt: skip

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
        if settings.gives and not self.model.basis.halvings:
            with suppress(SimulationError):  # a DLO that is folded keeps its knot spans
                self._refine(self.model.basis.even_spans)
        before, self.model = self.model, self.model.with_settings(settings)
        if self.model.remembers != before.remembers:
            self.state = self._insensitive(with_history(self.state, self.model))
        if self.model.body.lengthening != before.body.lengthening:
            try:
                self.resettle(self.stamp)
            except SimulationError as err:
                LOG.warning("the DLO goes on with its other length from where it was: %s", err)
        ratio = settings.rod.specific_modulus / self._judged
        if max(ratio, 1.0 / ratio) < resolution.RECHECK_RATIO or self.resolution is None:
            return
        self._judged = settings.rod.specific_modulus
        command = self._command(self.state.stamp)
        stamps = np.linspace(self.state.stamp, max(command.end_stamp, self.state.stamp), 200)
        shape = self.prediction().control_points
        try:
            found = resolution.choose(settings, command, shape, [int(s) for s in stamps])
            if found.spans > self.model.basis.even_spans:
                self._refine(found.spans)
                self._spans, self.resolution = found.spans, found
        except SimulationError as err:
            LOG.warning("the resolution could not be judged anew: %s", err)

    def _refine(self, spans: int) -> None:
        """Go on with the basis that the present parameters need with a number of knot spans."""
        state = self._started()
        finer, boundary = resolution.build(self.settings, self._command(state.stamp), spans)
        self.state = self._insensitive(refined(state, self.model, finer))
        self.model, self.boundary = finer, boundary

    def _started(self) -> State:
        if self.state is None:
            raise InputError("the simulation has no initial shape yet")
        return self.state

    @property
    def basis(self) -> SplineBasis:
        """The simulation's own spline basis, once it has started."""
        self._started()
        return self.model.basis

    def true_shape(self) -> FloatArray:
        """Control points x, y, z [m], theta [rad] in `basis`, effects of measurement not applied.

        Shape (m, 4).
        """
        return self._started().q.copy()
