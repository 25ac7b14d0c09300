# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The state of a rod that starts from its first observed shapes, with its sensitivities.

Where the DLO truly was follows from what was seen by the camera's errors, and its ends from the
command by those of the clamps: a parameter of these moves the first shape, too. The derivatives are
differences of two such states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.effects.base import MEASUREMENT
from dlo_ros.errors import InputError
from dlo_ros.observation import Observation
from dlo_ros.rod.boundary.conditions import THETA
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.boundary.twist_free_frame import EndFrame, material_frame
from dlo_ros.rod.compiled_rod import both_sides, compiled
from dlo_ros.rod.dynamics import accelerated
from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import growth_at, nothing_varies, true_command
from dlo_ros.rod.parameter_names import acts_on
from dlo_ros.rod.planar_model import in_plane
from dlo_ros.rod.sensitivity.sensitivity_state import SensitivityState
from dlo_ros.rod.state import State, bent_once, rest_state
from dlo_ros.rod.statics import hold, reachable
from dlo_ros.rod.stretch_relaxation import Relaxation
from dlo_ros.spline import FloatArray, SplineBasis

ROUNDING = 1e-14  # of an angle [rad]


@dataclass(frozen=True)
class FirstShapes:
    """Knowledge of a DLO when its simulation starts.

    Args:
        observations: one observation, or two for simulation.start `moving`, with the instants at
            which the DLO truly had these shapes.
        command: command that holds at that time.
        shape: true control points at the last of these instants, published basis, shape (n, 4).
    """

    observations: tuple[Observation, ...]
    command: Command
    shape: FloatArray

    @property
    def stamp(self) -> int:
        """The instant of the start [ns]."""
        return self.observations[-1].stamp


def observed_start(
    model: RodModel, boundary: Boundary, first: FirstShapes, measurement: MeasurementMap,
    parameters: Sequence[str] = (),
) -> State:  # fmt: skip
    """The state that begins with the observed shape, held as commanded and not stretched.

    Args:
        measurement: map from true shapes to measured ones, with the rates of these parameters.
        parameters: parameters whose sensitivities are wanted, see `sensitivity_parameters`.

    Raises:
        InputError: the first two observed shapes have the same stamp.
        SimulationError: imposed ends out of reach.
    """
    begun = _Begun(model, boundary, first, measurement, None)
    reachable(model, begun.held, boundary)
    shape, pull = begun.relaxation.solution()
    still = bent_once(begun.state(shape), model)
    true = true_command(model, first.command)
    flat = in_plane(model, still, true, parameters)
    rod = compiled(model, boundary, first.command, parameters, flat=flat)
    state = accelerated(model, rod, still, true, flat=flat)
    if not parameters:
        return state
    varying, variant = nothing_varies(state, len(parameters)), 0
    for k, name in enumerate(parameters):
        pair = []
        # How far a grip gives depends on the stiffness of the DLO, too.
        moved = rod.moves[k] or acts_on(name, MEASUREMENT) or model.settings.gives
        for varied, asked in both_sides(model, first.command, name):
            there, variant = still, variant + 1
            if moved:
                asking, mapping = replace(first, command=asked), MeasurementMap(varied.settings)
                other = _Begun(varied, boundary, asking, mapping, begun)
                there = other.state(other.shape_near(shape, pull, begun))
            there = bent_once(there, varied)  # what yields does so by the varied law
            pair.append(accelerated(model, rod, there, true, variant, flat=flat))
        _set_difference(varying, k, pair[0], pair[1], rod.step[k])
    # A longer delay sets the first shapes earlier; at a given instant the DLO has moved on since.
    later = measurement.later_rate[:, None, None]
    varying.q[:] += later * state.velocity
    varying.velocity[:] += later * state.acceleration
    return replace(state, sensitivity=varying)


class _Begun:
    """A rod with its true first shapes and what holds it then."""

    def __init__(
        self, model: RodModel, boundary: Boundary, first: FirstShapes, measurement: MeasurementMap,
        near: _Begun | None,
    ) -> None:  # fmt: skip
        self.model, self.boundary, self._first = model, boundary, first
        rod = model.settings.rod
        lift = model.basis.projection(SplineBasis(rod.control_points, rod.length))
        self.seen = [lift @ measurement.true(o.control_points) for o in first.observations]
        true = true_command(model, first.command)
        self._frame: EndFrame | None = (
            material_frame(true, first.stamp) if near is None else near._frame
        )
        self._resting: dict[tuple[bytes, float], State] = {} if near is None else near._resting
        at_rest = self._at_rest(self.seen[-1])
        self.held = hold(model, boundary, at_rest, first.command, first.stamp)
        since = np.array([(first.stamp - first.command.stamp) / NANOSECONDS])
        self._growth = float(growth_at(model, boundary, first.command, since)[0])

    def _at_rest(self, shape: FloatArray, angle: float = 0.0) -> State:
        """The rod at rest in a shape (n, 4), which many variants of it share.

        Args:
            angle: see `rest_state`.
        """
        key = shape.tobytes(), angle
        if key not in self._resting:
            stamp = self._first.stamp
            self._resting[key] = rest_state(stamp, shape, self.model, self._frame, angle)
        return self._resting[key]

    @property
    def relaxation(self) -> Relaxation:
        """The search for the shape that it begins with."""
        return Relaxation(self.model, self.boundary, self.held, self.seen[-1], self._growth)

    def shape_near(self, shape: FloatArray, pull: float, other: _Begun) -> FloatArray:
        """The shape (n, 4) of the start, where that of another is known, found with a pull."""
        if self._begins_as(other):
            return shape
        return self.relaxation.solution_near(shape, pull)

    def _begins_as(self, other: _Begun) -> bool:
        """Whether the first shapes, and all that decides how they are held, are the same."""
        return (
            all(np.array_equal(a, b) for a, b in zip(self.seen, other.seen, strict=True))
            and np.array_equal(self.held.target[:, :3], other.held.target[:, :3])
            and np.array_equal(self.held.pins, other.held.pins)
            and self._growth == other._growth
            and np.array_equal(
                self.model.stiffness.stretch_rest, other.model.stiffness.stretch_rest
            )
            and np.array_equal(self._hinges, other._hinges)
        )

    @property
    def _hinges(self) -> FloatArray:
        """Numbers that decide how the DLO is bent where a grip gives, shape (m, 6)."""
        body = self.model.body
        hinge = np.broadcast_to(body.hinge, body.weight.shape)
        numbers = np.column_stack([hinge, body.bend_matrix, body.bend_rest])
        return np.asarray(numbers[body.hinged])

    def state(self, shape: FloatArray) -> State:
        """The state in a shape (n, 4), with the velocity that was observed, not accelerated."""
        model, observations = self.model, self._first.observations
        turned = 0.0 if self._frame is None else float(self.held.frames[self._frame.end, THETA])
        angle = turned if abs(turned) > ROUNDING else 0.0
        state = replace(self._at_rest(shape, angle), frames=self.held.frames)
        if model.settings.simulation.start == "moving":
            elapsed = (observations[-1].stamp - observations[0].stamp) / NANOSECONDS
            if elapsed <= 0.0:
                raise InputError("the first two observed shapes have the same stamp")
            velocity = (self.seen[-1] - self.seen[0]) / elapsed
            velocity[:, 3] = 0.0
            state = replace(state, velocity=velocity)
        return state


def _set_difference(
    varying: SensitivityState, k: int, above: State, below: State, step: float
) -> None:
    """Write the derivatives by parameter k, from the states above and below its value."""

    def difference(high: FloatArray, low: FloatArray) -> FloatArray:
        return np.asarray((high - low) / (2.0 * step))

    for name in ("q", "velocity", "acceleration", "auxiliary"):
        getattr(varying, name)[k] = difference(getattr(above, name), getattr(below, name))
    varying.stretch[k] = difference(above.strains.stretch, below.strains.stretch)
    varying.stretch_before[k] = varying.stretch[k]
    varying.other[k] = difference(above.strains.other, below.strains.other)
    varying.other_before[k] = varying.other[k]
    rows = zip(varying.reference, above.reference, below.reference, strict=True)
    for change, high, low in (
        *rows,
        *zip(varying.internal, above.internal, below.internal, strict=True),
    ):
        change[k] = difference(high, low)
    varying.frames[k] = above.frames, below.frames
