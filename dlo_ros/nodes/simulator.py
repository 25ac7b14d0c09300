# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The node `simulator`: imposed motion and first observed shape in, predicted splines out."""

from __future__ import annotations

import math
import time
from typing import Any

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import DloError
from dlo_ros.nodes import qos
from dlo_ros.nodes.commands import CommandSubscription
from dlo_ros.nodes.load_publishing import LoadPublisher
from dlo_ros.nodes.markers import Markers
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.node_base import JUMP_BACK, DloNode
from dlo_ros.nodes.rehearsal import Rehearsing
from dlo_ros.nodes.runtime import run
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import spline_message
from dlo_ros.recordings.messages import read_observation
from dlo_ros.rod.boundary.shape_orientation import all_along
from dlo_ros.rod.compile_rod import compile_kernels
from dlo_ros.rod.live_simulation import LiveSimulation
from dlo_ros.rod.motion_validation import possible

WINDOW = 1.0
"""Seconds of observed shapes that are kept while no command has come; the oldest one is the start.

A recording's first shape is thus not lost where its command arrives a little later, and a node that
waits for hours does not start from a shape of then.
"""

LONGEST_GAP = 10.0
"""Seconds that the simulation catches up with; further behind it starts afresh."""

CATCH_UP = 2.0
"""Seconds behind the clock up to which no prediction is left out: a start takes its time."""

TURN = 0.1
"""Seconds of wall time after which other callbacks have their turn."""

BURST = 8
"""Predictions that are published at once when there is something to catch up with; subscribers with
the usual depth of 10 then lose none."""

COMMANDS = 500
"""Commands that are remembered; each but the last is partly replaced by the next."""

FRAMES_LATE = 0.1
"""Seconds that predictions wait for a robot's frames, which come after their instant.

Otherwise each prediction would hold the clamps where they were, and move them in jumps. After that
the clamps are taken to rest.
"""

LONGEST_TICK = 0.02
"""Seconds of wall time between two looks at what is due."""

RETRY = 0.5
"""Seconds of wall time between two attempts to start, at least as long as the last one took: what
does not converge may take seconds to say so, and other callbacks shall have half of the time."""


CLOCK = "/clock (use_sim_time is set)"
"""The missing topic while simulated time has not begun."""

CLOCK_FOLLOWS = 0.2
"""Seconds of wall time in which /clock goes back after the shapes have: `ros2 bag play` publishes
it some ten times a second."""

REPORTED_CHANGE = 0.1
"""Relative change of E or density that is logged at INFO; the identifier sends new values with
every image, and less is hardly to be seen in the shape."""


class SimulatorNode(DloNode):
    """Predicts the DLO's shape from `dlo/command`, at `simulation.rate` on the ROS clock."""

    def __init__(self, **options: Any) -> None:
        super().__init__("simulator", "prediction", "predictions", **options)
        self._simulation = LiveSimulation(self.settings)
        self._observations: list[Observation] = []
        self._next = 0
        self._untried = False
        self._period = round(NANOSECONDS / self.settings.simulation.rate)
        self._retry_at = 0.0
        self._reported = self.settings
        self._publisher = self.publisher(topics.PREDICTED, qos.RELIABLE)
        self._loads = LoadPublisher(self)
        self._rehearsing = Rehearsing(self, self._simulation)
        self._markers = Markers(self, "predicted", (1.0, 0.5, 0.0))
        self._command_subscription = CommandSubscription(self, self._on_command)
        self.subscribe(topics.OBSERVED, self._on_observed, qos.RELIABLE)
        # Wall time, and more often than it publishes: what is due is read off the ROS clock, whose
        # own timers would leave the rest undone where /clock stops.
        self.every(min(0.5 / self.settings.simulation.rate, LONGEST_TICK), self._tick)
        self._say_what_is_missing()
        self.prepare(("rod",), compile_kernels)

    def destroy_node(self) -> None:
        """Leave the graph."""
        self._rehearsing.stop()
        super().destroy_node()

    def begin(self) -> None:
        """Start from the messages that have arrived meanwhile."""
        self._try_to_start()

    def reset(self) -> None:
        """Start afresh from the next observed shape; the command still holds."""
        self._observations.clear()
        self._rehearsing.forget()
        self._stop()

    def restart(self, now: int) -> None:
        """Time went back: what was simulated or seen beyond is forgotten."""
        self._rehearsing.forget()
        limit = now + round(JUMP_BACK * NANOSECONDS)
        self._observations = [o for o in self._observations if o.stamp <= limit]
        if not self._simulation.started or self._next > limit:
            self._stop()

    def check_settings(self, settings: Settings) -> None:
        """Refuse a DLO that the model cannot bear, such as one that its own weight would tear."""
        possible(settings)

    def apply(self, settings: Settings) -> None:
        """Take changed parameters over, without interrupting the motion."""
        self._simulation.update(settings)
        self._untried = True
        effects = f", with {', '.join(settings.effects)}" if settings.effects else ""
        text = (
            f"E {settings.rod.young_modulus:.4g} Pa, density {settings.rod.density:.4g} kg/m^3"
            f"{effects}"
        )
        if differs(settings, self._reported):
            self._reported = settings
            self.get_logger().info(text)
        else:
            self.get_logger().debug(text)

    def _on_command(self, command: Command) -> None:
        self._simulation.set_command(command)
        # What lies long before the newest is over; a robot may send thousands.
        del self._simulation.motion.commands[:-COMMANDS]
        self._untried = True
        self._try_to_start()

    def _on_observed(self, message: Any) -> None:
        observation = read_observation(message, self.settings)
        self.check_stamp(observation.stamp, topics.OBSERVED)
        if self.is_earlier(observation.stamp):
            return
        self.health.solved(topics.OBSERVED)
        last = self._observations[-1].stamp if self._observations else observation.stamp
        if observation.stamp < last - JUMP_BACK * NANOSECONDS:
            self.restart(observation.stamp)
            self._retry_at = time.monotonic() + CLOCK_FOLLOWS
        if self._simulation.started:
            self._observations = [observation]
            return
        kept = {o.stamp: o for o in (*self._observations, observation)}
        newest = max(kept)
        self._observations = [kept[s] for s in sorted(kept) if newest - s <= WINDOW * NANOSECONDS]
        self._untried = True
        self._try_to_start()

    def _needed(self) -> int:
        return 2 if self.settings.simulation.start == "moving" else 1

    def _try_to_start(self) -> None:
        """Start where all is there, and something is new since the last attempt failed."""
        if not self.ready or self._simulation.started:
            return
        if not self._simulation.ready or not self._untried:
            return
        if len(self._observations) < self._needed() or time.monotonic() < self._retry_at:
            return
        # What was seen before the command was known may have its ends swapped.
        motion, length = self._simulation.motion, self.settings.rod.length
        chosen = all_along(motion, self._observations[: self._needed()], length)
        now = self.now()
        off = (now - chosen[-1].stamp) / NANOSECONDS
        if now == 0:
            return  # simulated time has not begun
        if abs(off) > LONGEST_GAP:
            self._retry_at = time.monotonic() + RETRY
            self.health.warn(
                "clock",
                f"the observed shape is {off:.1f} s older than the clock; "
                "with a recording set use_sim_time and play it with /clock",
            )
            return
        began = time.monotonic()
        try:
            self._simulation.start(chosen)
        except DloError as err:
            self._wait_after(began, RETRY)
            self._untried = False
            self.health.warn("start", f"the simulation does not start: {err}")
            return
        self._next = chosen[-1].stamp
        self.health.solved("start")
        self.health.solved("clock")
        self.health.running("predicting")
        self.get_logger().info(f"simulation starts at {self._next / 1e9:.3f} s")

    def _tick(self) -> None:
        if not self._simulation.started:
            self._say_what_is_missing()
            self._try_to_start()
            return
        now = self._known_until()
        behind = (now - self._next) / NANOSECONDS
        if behind > LONGEST_GAP:
            self.health.warn("lag", f"{behind:.1f} s behind the clock; starting afresh")
            self._stop()
            return
        self.health.values["lag [s]"] = max(behind, 0.0)
        if time.monotonic() < self._retry_at:
            return
        until = time.monotonic() + TURN
        for _ in range(BURST):
            if self._next > now or time.monotonic() > until:
                break
            self._predict(self._next)
            self._next += self._period
        if (now - self._next) / NANOSECONDS > CATCH_UP:
            # Too slow for this rate: fewer predictions, but each at its right time.
            self._next += (now - self._next) // self._period * self._period
            self.health.warn(
                "lag", f"slower than real time; {behind:.2f} s behind, predictions are left out"
            )

    def _known_until(self) -> int:
        """The instant [ns] to which to predict: now, or the newest stamp of a robot's frames."""
        now, commands = self.now(), self._simulation.motion.commands
        if self.settings.command.source == "topic" or not commands:
            return now
        reported = commands[-1].end_stamp
        return reported if 0 < now - reported < FRAMES_LATE * NANOSECONDS else now

    def _predict(self, stamp: int) -> None:
        began = time.monotonic()
        try:
            prediction = self._simulation.advance(stamp)
            message = spline_message(
                ROS_MESSAGES, prediction.stamp, self.settings.frame_id, prediction.control_points
            )
        except DloError as err:
            self._wait_after(began)
            self.health.warn("simulation", f"the last good shape is held: {err}")
            return
        self.health.solved("simulation")
        self._publisher.publish(message)
        self.health.count("predictions")
        self.health.values["computing time [ms]"] = 1000.0 * (time.monotonic() - began)
        self._markers.spline(prediction.stamp, prediction.control_points)
        if prediction.loading is not None:
            self._loads.publish(prediction.stamp, prediction.loading)

    def _wait_after(self, began: float, least: float = 0.0) -> None:
        """Pause before the next attempt for as long as the failed one took."""
        took = time.monotonic() - began
        if max(took, least) > TURN:
            self._retry_at = time.monotonic() + max(took, least)

    def _stop(self) -> None:
        self._simulation.reset()
        self.health.values.clear()
        self._next = 0
        self._retry_at = 0.0
        self._untried = True

    def _say_what_is_missing(self) -> None:
        missing = [] if self.now() else [CLOCK]
        if not self._simulation.ready:
            missing.append(topics.COMMAND)
        if len(self._observations) < self._needed():
            missing.append(f"{self._needed()} of {topics.OBSERVED}")
        self.health.waiting(" and ".join(missing) or "an observed shape that it can start from")


def differs(settings: Settings, reported: Settings) -> bool:
    """Whether parameters differ visibly from those that were logged last."""
    changes = [
        math.log(getattr(settings.rod, name) / getattr(reported.rod, name))
        for name in ("young_modulus", "density")
    ]
    return max(map(abs, changes)) > REPORTED_CHANGE or settings.effects != reported.effects


def main(arguments: list[str] | None = None) -> int:
    """Run the node until Ctrl-C; returns the exit status."""
    return run("simulator", SimulatorNode, arguments)
