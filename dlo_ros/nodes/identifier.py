# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The node `identifier`: observed and predicted splines in; ERR and estimates of E and mu out."""

from __future__ import annotations

import math
import time
from collections import OrderedDict, deque
from typing import Any

from std_srvs.srv import SetBool

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.diagnosis.monitor.residual_monitor import Suspicion
from dlo_ros.errors import InputError
from dlo_ros.identification.estimate import Estimate
from dlo_ros.inference.err import deviation
from dlo_ros.nodes import qos
from dlo_ros.nodes.commands import CommandSubscription
from dlo_ros.nodes.estimator_thread import EstimatorThread
from dlo_ros.nodes.markers import Markers
from dlo_ros.nodes.measured_forces import MeasuredForces
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.metrics import ESTIMATES, Metrics
from dlo_ros.nodes.node_base import JUMP_BACK, DloNode
from dlo_ros.nodes.pairing import Pairing
from dlo_ros.nodes.received_data import BACKLOG
from dlo_ros.nodes.runtime import run
from dlo_ros.nodes.simulator_link import SimulatorLink
from dlo_ros.observation import CentrelinePoints, Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import float_message
from dlo_ros.recordings.messages import read_observation, read_points, read_spline, stamp_of
from dlo_ros.rod.boundary.shape_orientation import along
from dlo_ros.rod.compile_rod import compile_kernels
from dlo_ros.spline import SplineBasis

PATIENCE = 0.1
"""Seconds that an observed spline waits for its measured points, where somebody publishes them."""

CLOUDS = 50
"""Measured points that are kept until their spline comes."""


class IdentifierNode(DloNode):
    """Compares prediction and observation, estimates E and mu, keeps the simulator in step."""

    def __init__(self, **options: Any) -> None:
        super().__init__("identifier", "identification", "observed splines", **options)
        rod = self.settings.rod
        self._basis = SplineBasis(rod.control_points, rod.length)
        self._pairing = Pairing()
        self._motion = Motion()
        self._determined: tuple[str, ...] = ()
        self._clouds: OrderedDict[int, CentrelinePoints] = OrderedDict()
        self._held: deque[tuple[float, Observation]] = deque()
        self._last_observed = 0
        self._err = math.nan
        self._err_publisher = self.publisher(topics.ERR, qos.RELIABLE)
        self._young_publisher = self.publisher(topics.YOUNG_MODULUS, qos.LATCHED)
        self._density_publisher = self.publisher(topics.DENSITY, qos.LATCHED)
        self._metrics = Metrics(self)
        self._markers = Markers(self, "identified", (1.0, 1.0, 1.0))
        self._link = SimulatorLink(self, self.settings.simulator_node)
        self._wake = self.create_guard_condition(self.guarded("estimator", self._take_outcomes))
        self._estimator = EstimatorThread(self.settings, self._wake.trigger)
        self._command_subscription = CommandSubscription(self, self._on_command)
        self.subscribe(topics.OBSERVED, self._on_observed, qos.DEEP)
        self.subscribe(topics.OBSERVED_POINTS, self._on_points, qos.DEEP)
        self.subscribe(topics.PREDICTED, self._on_predicted, qos.DEEP)
        self._forces = MeasuredForces(self)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.every(PATIENCE / 2, self._release)
        self._say_state()
        self.prepare(("rod",), compile_kernels)

    def begin(self) -> None:
        """Start the estimator; it has the commands that have arrived meanwhile."""
        self._estimator.start()

    def reset(self) -> None:
        """Forget estimates and what was received; the command still holds."""
        self._link.forget()
        self._begin_again()

    def _begin_again(self) -> None:
        self._forget()
        self._estimator.restart(self.settings)
        for command in self._motion.commands:
            self._estimator.command(command)

    def restart(self, now: int) -> None:
        """Time went back: start afresh."""
        limit = now + round(JUMP_BACK * NANOSECONDS)
        if self._last_observed > limit:
            self._link.begin_again()
            self._begin_again()
        self._pairing.forget_after(limit)

    def apply(self, settings: Settings) -> None:
        """Changed parameters are a new initial guess."""
        self.reset()

    def destroy_node(self) -> None:
        """End the estimator's thread, too."""
        self._estimator.stop()
        super().destroy_node()

    def _forget(self) -> None:
        self._pairing.clear()
        self._clouds.clear()
        self._held.clear()
        self._forces.forget()
        self._last_observed = 0
        self._err = math.nan
        self._determined = ()
        self.health.values.clear()
        self._say_state()

    def _on_command(self, command: Command) -> None:
        self._motion.add(command)
        del self._motion.commands[:-500]
        self._estimator.command(command)
        self._say_state()

    def _on_points(self, message: Any) -> None:
        points = read_points(message, self.settings)
        if self.is_earlier(stamp_of(message)):
            return
        self._clouds[stamp_of(message)] = points
        while len(self._clouds) > CLOUDS:
            self._clouds.popitem(last=False)
        self._release()

    def _on_observed(self, message: Any) -> None:
        observation = read_observation(message, self.settings)
        stamp = observation.stamp
        self.check_stamp(stamp, topics.OBSERVED)
        if self.is_earlier(stamp):
            return
        if not self.ready:
            self.health.count("splines before the node was ready")
            return
        if stamp < self._last_observed - JUMP_BACK * NANOSECONDS:
            self.health.warn("restart", "the observed splines start again, starting afresh")
            self._link.begin_again()
            self._begin_again()
        self.health.solved(topics.OBSERVED)
        self.health.count("observed splines")
        self._pairing.observed(stamp, observation.control_points)
        self._compare()
        if stamp <= self._last_observed:
            self.health.count("late splines left out of the estimate")
            return
        self._last_observed = stamp
        self._say_state()
        self._held.append((time.monotonic() + PATIENCE, observation))
        self._release()

    def _on_predicted(self, message: Any) -> None:
        shape = read_spline(message, self.settings, topics.PREDICTED)
        self.check_stamp(stamp_of(message), topics.PREDICTED)
        if self.is_earlier(stamp_of(message)):
            return
        self._pairing.predicted(stamp_of(message), shape)
        self._compare()

    def _compare(self) -> None:
        """Publish ERR of each observed spline for which the prediction is known."""
        for stamp, seen, predicted in self._pairing.pairs():
            # What was seen before the command was known may have its ends swapped.
            turned = along(self._motion, Observation(stamp, seen), self._basis.length)
            observed = turned.control_points
            apart = deviation(predicted, observed, self._basis)
            self._err = apart.mean
            self._err_publisher.publish(float_message(ROS_MESSAGES, self._err))
            self._metrics.err(stamp, apart)
            self.health.count("compared splines")
            self.health.values["ERR [mm]"] = 1000.0 * self._err
            self._markers.text(stamp, observed[0], f"ERR {1000.0 * self._err:.2f} mm")
        self.health.values["splines without prediction"] = self._pairing.missed

    def _release(self) -> None:
        """Hand observed splines to the estimator, in order, with their points where they come."""
        if self._held and not self._estimator.paused:
            for measured in self._forces.take(self._motion.commands):
                self._estimator.feel(measured)
        expected = self.is_published(topics.OBSERVED_POINTS)
        while self._held:
            deadline, observation = self._held[0]
            points = self._clouds.pop(observation.stamp, None)
            if points is None and expected and time.monotonic() < deadline:
                return
            self._held.popleft()
            if not self._estimator.paused:
                self._estimator.observe(
                    Observation(observation.stamp, observation.control_points, points)
                )
        self.health.values[BACKLOG] = self._estimator.waiting
        self.health.values["splines dropped"] = self._estimator.dropped

    def _take_outcomes(self) -> None:
        for outcome in self._estimator.take():
            if outcome.problem:
                self.health.warn("estimator", f"estimate not updated: {outcome.problem}")
            elif outcome.estimate is not None:
                if not outcome.later:
                    self.health.values["latency [ms]"] = (self.now() - outcome.stamp) / 1e6
                self._publish(outcome.stamp, outcome.estimate)
                if not outcome.later:
                    self.health.count("estimates")
                self._suspect(outcome.suspicion)

    def _publish(self, stamp: int, estimate: Estimate) -> None:
        try:
            young = float_message(ROS_MESSAGES, estimate.young_modulus)
            density = float_message(ROS_MESSAGES, estimate.density)
        except InputError as err:
            self.health.warn("estimator", f"estimate not published: {err}")
            return
        self._young_publisher.publish(young)
        self._density_publisher.publish(density)
        self._metrics.estimate(stamp, estimate)
        self.health.solved("estimator")
        self._link.pass_on(estimate)
        self._describe(estimate)
        self.health.refresh(
            [f"{name}{what} [{unit}]" for name, unit in ESTIMATES.items() for what in ("", " std")]
        )

    def _describe(self, estimate: Estimate) -> None:
        values = self.health.values
        for name, unit in ESTIMATES.items():
            values[f"{name} [{unit}]"] = float(getattr(estimate, name))
            std = getattr(estimate, f"{name}_std")
            values[f"{name} std [{unit}]"] = "unbounded" if std is None else float(std)
            values[f"{name} identifiable"] = bool(estimate.identifiable.get(name, False))
        delay, std = estimate.delay or ("unknown", "unknown")
        values["command delay [s]"], values["command delay std [s]"] = delay, std
        values["traded"] = "; ".join(f"{a} and {b}" for a, b in estimate.traded) or "none"
        self._determined = tuple(name for name, yes in estimate.identifiable.items() if yes)
        self._say_state()

    def _say_state(self) -> None:
        """Set the status: what is missing, or what the data determine."""
        missing = [] if self._motion.commands else [topics.COMMAND]
        if not self._last_observed:
            missing.append(topics.OBSERVED)
        if missing:
            paused = "; paused" if self._estimator.paused else ""
            self.health.waiting(" and ".join(missing) + paused)
            return
        state = "paused" if self._estimator.paused else "estimating"
        known = ", ".join(self._determined)
        self.health.running(
            f"{state}; the data determine {known}"
            if known
            else f"{state}; the data do not determine the material yet"
        )

    def _suspect(self, suspicion: Suspicion | None) -> None:
        """Report suspected causes as long as they last."""
        if suspicion is None:
            self.health.solved("model")
            self.health.values["suspected model errors"] = "none"
            return
        self.health.values["suspected model errors"] = str(suspicion.suspects or "") or "unknown"
        self.health.warn("model", str(suspicion))

    def _on_pause(self, request: Any, response: Any) -> Any:
        self._estimator.pause(bool(request.data))
        self._say_state()
        self._wake.trigger()  # a step that was under way has had its outcome meanwhile
        response.success = True
        response.message = "paused" if self._estimator.paused else "running"
        return response


def main(arguments: list[str] | None = None) -> int:
    """Run the node until Ctrl-C; returns the exit status."""
    return run("identifier", IdentifierNode, arguments)
