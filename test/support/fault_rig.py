# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A simulated robot and camera in front of the live simulator and identifier, with faults between.

The rod's true motion is computed once. `Rig.drive` then publishes /clock, the command and the
observed splines as a robot would, and a fault decides what becomes of each message on its way.
"""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from live_graph import Client, Process, to_ros
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.demo.network import free_domain
from dlo_ros.nodes.qos import LATCHED
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import BAG_MESSAGES, command_message, spline_message, topics
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

N = 10
TRUTH = 1.0e7
GUESS = Settings.from_mapping(
    {
        "rod.length": 0.4,
        "rod.diameter": 0.004,
        "rod.young_modulus": 5.0e6,
        "rod.density": 2000.0,
        "rod.control_points": N,
        "simulation.tolerance": 0.001,
    }
)
NOISE = 2e-4
EVERY = 0.04
TICK = 0.01
"""Seconds of simulated time between two /clock messages."""


def swing(stamp: int, seconds: float) -> Command:
    """The start held and turned up and down."""
    times = np.arange(0.0, seconds + 0.01, 0.05)
    angle = 0.45 * np.sin(2.0 * math.pi * 0.9 * times) * np.minimum(1.0, times)
    rotations = np.zeros((len(times), 1, 4))
    rotations[:, 0, 1], rotations[:, 0, 3] = np.sin(angle / 2.0), np.cos(angle / 2.0)
    return Command(
        stamp, ("start",), times, np.zeros((len(times), 1, 3)), rotations,
        np.full((len(times), 1, 3), np.nan), N,
    )  # fmt: skip


def shapes(seconds: float, imposed: Command | None = None) -> list[tuple[float, np.ndarray]]:
    """What a camera sees of the true motion: seconds from its start, control points with noise."""
    truth = GUESS.with_material(TRUTH, GUESS.rod.density)
    simulation = Simulation(truth, Motion([imposed or swing(0, seconds)]))
    straight = np.column_stack([SplineBasis(N, 0.4).greville, np.zeros((N, 3))])
    simulation.start([Observation(0, straight)])
    rng, result = np.random.default_rng(5), []
    for k in range(int(seconds / EVERY)):
        shape = simulation.advance(round(k * EVERY * NANOSECONDS)).control_points.copy()
        shape[1:, [0, 2]] += rng.normal(0.0, NOISE, (N - 1, 2))
        result.append((k * EVERY, shape))
    return result


@dataclass
class Sent:
    """A message on its way: when it is delivered and what it is, both in seconds of the motion."""

    due: float
    stamp: float
    shape: np.ndarray


Fault = Callable[[list[Sent]], Iterable[Sent]]


def untouched(messages: list[Sent]) -> Iterable[Sent]:
    return messages


def lost(messages: list[Sent]) -> Iterable[Sent]:
    rng = random.Random(1)
    return [m for m in messages if m.stamp == 0.0 or rng.random() > 0.3]


def doubled(messages: list[Sent]) -> Iterable[Sent]:
    return [m for m in messages for _ in range(2)]


def delayed(messages: list[Sent]) -> Iterable[Sent]:
    return [Sent(m.due + 0.5, m.stamp, m.shape) for m in messages]


def shuffled(messages: list[Sent]) -> Iterable[Sent]:
    rng = random.Random(2)
    return [Sent(m.due + rng.uniform(0.0, 0.2), m.stamp, m.shape) for m in messages]


def silent(messages: list[Sent]) -> Iterable[Sent]:
    return [m for m in messages if not 2.0 < m.stamp < 12.0]


@dataclass
class Rig:
    """Live simulator and identifier, and the robot and camera that this process plays.

    Args:
        folder: folder for their logs and the parameter file.
        rate: seconds of simulated time a second of wall time.
    """

    folder: Path
    rate: float = 2.0
    base: int = 1_700_000_000 * NANOSECONDS
    nodes: dict[str, Process] = field(default_factory=dict)

    def __post_init__(self) -> None:
        GUESS.dump(self.folder / "params.yaml")
        self.words = ("--ros-args", "--params-file", str(self.folder / "params.yaml"))
        self.domain = free_domain()
        for name in ("simulator", "identifier"):
            self.start(name)
        self.client = Client(self.domain)
        try:
            self.connect()
        except BaseException:
            for process in self.nodes.values():
                process.process.kill()
            raise

    def connect(self) -> None:
        """Wait for the nodes, and offer what they subscribe to."""
        self.statuses = self.client.hear("/diagnostics", kind="diagnostic_msgs/msg/DiagnosticArray")
        self.predicted = self.client.hear(topics.PREDICTED, 1000)
        self.ready()
        node = self.client.node
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        self.clock = node.create_publisher(Clock, "/clock", best_effort)
        self.commands = self.client.publisher(topics.COMMAND, LATCHED, matched=2)
        self.splines = self.client.publisher(topics.OBSERVED, 50, matched=2)
        self.client.until(lambda: self.clock.get_subscription_count() >= 2, 60.0, "clock")
        self.tick(self.base)

    def start(self, name: str) -> None:
        if name in self.nodes:  # what the one before said of itself
            self.client.heard[f"/{name}/ready"].clear()
        self.nodes[name] = Process(
            self.folder, name, *self.words, "-p", "use_sim_time:=true", domain=self.domain
        )

    def ready(self) -> None:
        """Wait until both nodes take data and say something of themselves now."""
        self.client.wait_for_ready(*self.nodes)
        self.statuses.clear()
        self.client.until(lambda: all(map(self.values, self.nodes)), 120.0, "diagnostics")

    def close(self) -> None:
        self.client.close()
        for name, process in self.nodes.items():
            assert process.interrupt(times=2) == 0 and "Traceback" not in process.said, (
                name,
                process.said,
            )

    def tick(self, stamp: int) -> None:
        seconds, rest = divmod(stamp, NANOSECONDS)
        self.clock.publish(Clock(clock=Time(sec=seconds, nanosec=rest)))

    def values(self, name: str) -> dict[str, str]:
        """The node's last diagnostics."""
        for message in reversed(self.statuses):
            for status in message.status:
                if status.name.startswith(f"{name}:"):
                    found = {v.key: v.value for v in status.values}
                    level = status.level
                    return found | {"level": str(level[0]), "message": status.message}
        return {}

    def told(self, name: str) -> list[str]:
        """All that the node's diagnostics have said since the last `fresh`."""
        found = [s for m in self.statuses for s in m.status if s.name.startswith(f"{name}:")]
        return [s.message for s in found]

    def fresh(self) -> None:
        """All as it was at first: the guess, no memory, a new time, later than all before."""
        self.base += 100 * NANOSECONDS
        self.tick(self.base - 2 * NANOSECONDS)
        for name in self.nodes:
            assert self.client.call(Trigger, f"/{name}/reset", Trigger.Request()).success
        self.pause(False)
        guess = {"rod__young_modulus": GUESS.rod.young_modulus, "rod__density": GUESS.rod.density}
        assert self.client.set("/simulator", **guess).successful
        self.client.spin(0.3)
        self.statuses.clear()
        self.predicted.clear()

    def pause(self, paused: bool) -> None:
        """Whether the identifier keeps its estimates to itself."""
        assert self.client.call(SetBool, "/identifier/pause", SetBool.Request(data=paused)).success

    def with_the_truth(self) -> None:
        """The simulator has the true E and keeps it until the next `fresh`."""
        self.pause(True)
        assert self.client.set("/simulator", rod__young_modulus=TRUTH).successful

    def drive(
        self,
        seconds: float,
        fault: Fault = untouched,
        during: Callable[[float], float | None] = lambda now: None,
        measured: list[tuple[float, np.ndarray]] | None = None,
        imposed: Command | None = None,
        overtaken: float = 0.0,
    ) -> None:
        """Play the motion from its start.

        Args:
            seconds: duration of the part that is played [s].
            fault: function that changes the observed splines.
            during: function that is called with the present time of the motion [s] and returns the
                error of the clock [s].
            measured: the true shapes; default those of `shapes`.
            imposed: the motion, its start at 0; default `swing`.
            overtaken: time at which the command is sent [s].
        """
        truth = shapes(seconds) if measured is None else measured
        waiting = sorted(
            fault([Sent(t, t, shape) for t, shape in truth if t < seconds]), key=lambda m: m.due
        )
        motion = imposed or swing(0, seconds)
        message = command_message(BAG_MESSAGES, replace(motion, stamp=self.base))
        self.tick(self.base)
        began, ticked, commanded = time.monotonic(), -1.0, False
        while True:
            now = (time.monotonic() - began) * self.rate
            off = during(now) or 0.0
            if not commanded and now >= overtaken:
                self.commands.publish(to_ros(message))
                commanded = True
            if now - ticked >= TICK:
                ticked = now
                self.tick(self.base + round((now + off) * NANOSECONDS))
            while waiting and waiting[0].due <= now:
                sent = waiting.pop(0)
                stamp = self.base + round(sent.stamp * NANOSECONDS)
                spline = spline_message(BAG_MESSAGES, stamp, "board", sent.shape)
                self.splines.publish(to_ros(spline))
            self.client.executor.spin_once(timeout_sec=0.002)
            if not waiting and now > seconds:
                return

    def estimate(self) -> tuple[float, float]:
        """E/mu and its standard deviation [m^2/s^2], as the identifier says them."""
        values = self.values("identifier")
        return (
            float(values["specific_modulus [m^2/s^2]"]),
            float(values["specific_modulus std [m^2/s^2]"]),
        )

    def recovered(self, seconds: float = 90.0) -> float:
        """Wait until the estimate is right to within its std; returns by how many it is off."""
        wanted = TRUTH / GUESS.rod.density

        def off() -> float:
            try:
                value, std = self.estimate()
            except (KeyError, ValueError):
                return math.inf
            known = self.values("identifier").get("specific_modulus identifiable") == "yes"
            return abs(value - wanted) / std if known else math.inf

        # Which splines arrive is chance, and the std is too small by a half where these are few.
        self.client.until(lambda: off() < 4.0, seconds, f"estimate {self.values('identifier')}")
        return off()

    def lag(self, now: float) -> float:
        """Simulated seconds that the last prediction lies behind the clock."""
        stamp = self.predicted[-1].header.stamp
        return now - (stamp.sec - self.base // NANOSECONDS + stamp.nanosec / 1e9)


def as_bytes(command: Command) -> bytes:
    """A command as it goes over the wire, for storms of them."""
    return bytes(serialize_message(to_ros(command_message(BAG_MESSAGES, command))))
