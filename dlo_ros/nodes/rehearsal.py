# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rehearsals in the simulator: `dlo/rehearsal_command` in, `dlo/rehearsal` out."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import CommandError, InputError
from dlo_ros.identification.estimate import stated_covariance
from dlo_ros.nodes import qos
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.nodes.rehearsal_thread import WAITING, Answer, RehearsalThread, Request
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import spline_message
from dlo_ros.recordings.messages import read_command
from dlo_ros.rod.live_simulation import LiveSimulation
from dlo_ros.rod.motion_rehearsal import Rehearsal, at_rest, rehearse, stamps_of, varied_by
from dlo_ros.rod.protocol import RodSimulation
from dlo_ros.spline import FloatArray

PERIOD = 0.02
"""Seconds of wall time between two bursts of an answer."""
BURST = 4
"""Splines of an answer that are published at once: two bursts together, after a late timer, are
less than the usual depth of 10 of a subscriber; 5 s at 50 Hz are out in 1.3 s."""
AHEAD = 60.0
"""Seconds that a rehearsal may begin after now; until then the DLO is simulated, too."""


class Rehearsing:
    """Simulates requested motions beside the running simulation, and publishes the results.

    Args:
        node: the simulator.
        simulation: the running simulation, which is only read.
    """

    def __init__(self, node: DloNode, simulation: LiveSimulation) -> None:
        self._node, self._simulation = node, simulation
        self._thread = RehearsalThread()
        self._outgoing: deque[tuple[int, FloatArray]] = deque()
        self._publisher = node.publisher(topics.REHEARSAL, qos.DEEP)
        node.subscribe(topics.REHEARSAL_COMMAND, self._on_command, qos.RELIABLE)
        node.every(PERIOD, self._tick)

    def forget(self) -> None:
        """Drop the requests that wait."""
        self._thread.forget()
        self._outgoing.clear()

    def stop(self) -> None:
        """End the thread."""
        self._thread.stop()

    def _on_command(self, message: Any) -> None:
        node, settings = self._node, self._node.settings
        if not node.ready:
            raise InputError(f"{topics.REHEARSAL_COMMAND}: the node is not ready yet")
        now = node.now()
        try:
            command = read_command(message, settings, now)
        except CommandError as err:
            text = str(err).replace(topics.COMMAND, topics.REHEARSAL_COMMAND, 1)
            raise CommandError(f"{text}; it is refused") from err
        if not self._thread.ask(self._request(command, now)):
            raise InputError(
                f"{topics.REHEARSAL_COMMAND}: {WAITING} motions wait already; this one is refused"
            )
        node.health.solved(topics.REHEARSAL_COMMAND)
        node.health.count("rehearsal commands")

    def _request(self, command: Command, now: int) -> Request:
        """The request for a motion: from the present state, or from rest before there is one."""
        settings = self._node.settings
        covariance = stated_covariance(settings)
        ahead = (command.stamp - now) / NANOSECONDS
        if ahead > AHEAD:
            raise InputError(
                f"{topics.REHEARSAL_COMMAND} begins {ahead:.0f} s from now; at most {AHEAD:.0f} s "
                "can be simulated until then; leave its stamp zero to begin now"
            )
        stamps = stamps_of(command, command.stamp, settings.simulation.rate)
        fork = self._simulation.rehearsing(command, varied_by(covariance))
        late = 0 if fork is None else fork.late

        def simulated(simulation: RodSimulation) -> Rehearsal:
            found = rehearse(simulation, [stamp + late for stamp in stamps], covariance)
            return replace(found, stamps=tuple(stamps))

        if fork is not None:
            return Request(fork.prepared, simulated)
        return Request(lambda: at_rest(settings, command, covariance, stamps[-1]), simulated)

    def _tick(self) -> None:
        for _ in range(min(BURST, len(self._outgoing))):
            stamp, shape = self._outgoing.popleft()
            frame = self._node.settings.frame_id
            self._publisher.publish(spline_message(ROS_MESSAGES, stamp, frame, shape))
        if self._outgoing:
            return
        answer = self._thread.take()
        if answer is not None:
            self._tell(answer)

    def _tell(self, answer: Answer) -> None:
        """Report the result of a motion, and begin to publish it."""
        health, found = self._node.health, answer.found
        if found is None:
            health.warn("rehearsal", f"rehearsal: {answer.problem}")
            return
        self._outgoing.extend(zip(found.stamps, found.shapes, strict=True))
        health.solved("rehearsal")
        health.count("rehearsals")
        seconds = (found.stamps[-1] - found.stamps[0]) / NANOSECONDS
        limits = self._node.settings.limits
        alarms = found.extremes.alarms(limits) if found.loadings else []
        sentences = found.sentences(replace(limits, tension=0.0, bend_radius=0.0))
        self._node.get_logger().info(
            f"rehearsal of {seconds:.2f} s in {answer.took:.2f} s: {'; '.join(sentences)}"
        )
        for alarm in alarms:
            health.warn("rehearsal", f"rehearsal: {alarm}")
        values = health.values
        values["rehearsal computing time [s]"] = answer.took
        values["rehearsal band [mm]"] = None if found.std is None else 1e3 * float(found.std.max())
        numbers = found.extremes.numbers if found.loadings else {}
        for key, number in numbers.items():
            values[f"rehearsal {key}"] = number
