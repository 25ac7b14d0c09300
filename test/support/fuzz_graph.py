# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The three nodes in this process, fed with messages directly; whatever they publish is looked at.

Messages go to the subscriptions' callbacks, requests to those of the services, so that a hundred
thousand take minutes; what the nodes send is handed to DDS as always. A real graph of processes has
tests of its own (test_nodes, test_faults).
"""

from __future__ import annotations

import re
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from hostile import not_finite
from live_graph import to_ros
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from vision_scenes import Scene, bow, clamps, render
from vision_scenes import settings as vision_settings

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.nodes.identifier import IdentifierNode
from dlo_ros.nodes.observer import ObserverNode
from dlo_ros.nodes.simulator import SimulatorNode
from dlo_ros.observation import CentrelinePoints
from dlo_ros.recordings import (
    BAG_MESSAGES,
    CameraInfo,
    camera_info_message,
    command_message,
    compressed_message,
    image_message,
    points_message,
    spline_message,
    topics,
)
from dlo_ros.spline import SplineBasis

BEGIN = 1_700_000_000 * NANOSECONDS
N = 12
NODES = {"observer": ObserverNode, "simulator": SimulatorNode, "identifier": IdentifierNode}
DEFECT = re.compile(r"\b[A-Z]\w*(Error|Exception|Warning)\b")
"""A Python exception in a message for people."""

SCENE = Scene(width_px=5.0, size=(480, 270), noise=1.0)
SETTINGS = vision_settings(SCENE, control_points=N)


def resident() -> int:
    """Resident memory of this process [bytes]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


class Good:
    """Messages that make the nodes work: a rope between two clamps, seen and simulated."""

    def __init__(self) -> None:
        self.xz = bow()
        camera = SCENE.camera()
        matrix = tuple(float(v) for v in camera.matrix.ravel())
        self.info = CameraInfo(
            camera.width, camera.height, "plumb_bob", tuple(camera.distortion), matrix, "camera"
        )
        self.picture = render(self.xz, SCENE)
        self.jpeg = cv2.imencode(".jpg", self.picture)[1].tobytes()
        self.png = cv2.imencode(".png", self.picture)[1].tobytes()
        self.basis = SplineBasis(N, SETTINGS.rod.length)
        u = np.linspace(0.0, self.basis.length, len(self.xz))
        curve = np.column_stack([self.xz[:, 0], 0.0 * u, self.xz[:, 1]])
        self.shape = self.basis.fit(u, curve)
        (self.clamps,) = clamps(self.xz, N).commands

    def command(self, stamp: int, kind: int = 0) -> Any:
        c = self.clamps
        if kind == 0:
            return self._ros(command_message(BAG_MESSAGES, _at(c, stamp)))
        times = np.linspace(0.0, 1.0, 5)
        positions = np.repeat(c.positions, 5, axis=0)
        positions[:, 1, 2] += 0.02 * np.sin(6.0 * times)
        moving = Command(
            stamp, c.names, times, positions, np.repeat(c.rotations, 5, axis=0),
            np.full((5, 2, 3), np.nan), N,
        )  # fmt: skip
        if kind == 1:
            return self._ros(command_message(BAG_MESSAGES, moving))
        names = ("control_point_1", "control_point_2", "control_point_7")
        places = self.shape[[0, 1, 6]][None]
        pinned = Command(
            stamp, names, np.zeros(1), places, np.tile([0.0, 0.0, 0.0, 1.0], (1, 3, 1)),
            np.full((1, 3, 3), np.nan), N,
        )  # fmt: skip
        return self._ros(command_message(BAG_MESSAGES, pinned))

    def spline(self, stamp: int, off: float = 0.0) -> Any:
        shape = self.shape.copy()
        shape[2:-2, 2] += off
        return self._ros(spline_message(BAG_MESSAGES, stamp, "board", shape))

    def points(self, stamp: int) -> Any:
        u = np.linspace(0.0, self.basis.length, 30)
        positions = self.basis.evaluate(self.shape[:, :3], u)
        cloud = CentrelinePoints(positions, u, np.full(30, 2e-4))
        return self._ros(points_message(BAG_MESSAGES, stamp, "board", cloud))

    def image(self, stamp: int) -> Any:
        return self._ros(image_message(BAG_MESSAGES, stamp, "camera", self.picture))

    def mask(self, stamp: int) -> Any:
        white = np.full(self.picture.shape[:2], 255, np.uint8)
        return self._ros(image_message(BAG_MESSAGES, stamp, "camera", white))

    def compressed(self, stamp: int, kind: str = "jpeg") -> Any:
        data = self.jpeg if kind == "jpeg" else self.png
        return self._ros(compressed_message(BAG_MESSAGES, stamp, "camera", data, kind))

    def camera_info(self, stamp: int) -> Any:
        return self._ros(camera_info_message(BAG_MESSAGES, stamp, self.info))

    @staticmethod
    def _ros(message: Any) -> Any:
        return to_ros(message)


def _at(command: Command, stamp: int) -> Command:
    return Command(
        stamp, command.names, command.times, command.positions, command.rotations,
        command.velocities, command.control_points,
    )  # fmt: skip


class Graph:
    """Three live nodes on simulated time, and what is wrong with what they do.

    Args:
        monkeypatch: sees to it that publishers think that somebody listens.
    """

    def __init__(self, monkeypatch: Any) -> None:
        self.good = Good()
        self.now = BEGIN
        self.delivered: Counter[str] = Counter()
        self.published: Counter[str] = Counter()
        self.problems: list[str] = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        given = [Parameter(k, value=_value(v)) for k, v in SETTINGS.flat().items()]
        given.append(Parameter("use_sim_time", value=True))
        self.nodes = {
            name: kind(parameter_overrides=given, context=self._context)
            for name, kind in NODES.items()
        }
        self.executor = SingleThreadedExecutor(context=self._context)
        for node in self.nodes.values():
            self.executor.add_node(node)
            self._watch(node)
        while not all(node.ready for node in self.nodes.values()):
            self.executor.spin_once(timeout_sec=0.1)
        publish = Publisher.publish
        graph = self

        def observed(publisher: Any, message: Any) -> None:
            graph.look_at(publisher.topic, message)
            publish(publisher, message)

        monkeypatch.setattr(Publisher, "publish", observed)
        monkeypatch.setattr(Publisher, "get_subscription_count", lambda _: 1)
        self.tick(BEGIN)

    def close(self) -> None:
        self.executor.shutdown(timeout_sec=1.0)
        for node in self.nodes.values():
            node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _watch(self, node: Any) -> None:
        """An exception that nobody has foreseen is told as an error; here it counts as a defect."""
        report = node.health.error

        def error(kind: str, message: str) -> None:
            if not kind.startswith("limits."):  # an alarm is no defect
                self.problems.append(f"{node.get_name()}: {kind}: {message}")
            report(kind, message)

        node.health.error = error

    def look_at(self, topic: str, message: Any) -> None:
        """Check a message that a node publishes."""
        self.published[topic] += 1
        where = not_finite(message)
        if where:
            self.problems.append(f"{topic} publishes {where}")
        if topic.endswith("diagnostics"):
            for status in message.status:
                for text in (status.message, *(v.value for v in status.values)):
                    if DEFECT.search(text) or text in ("nan", "inf", "-inf"):
                        self.problems.append(f"{status.name} says {text!r}")

    def subscriptions(self, topic: str) -> list[Any]:
        """The callbacks of a topic, of all nodes."""
        wanted = f"/{topic}" if not topic.startswith("/") else topic
        raw = {f"/{topics.IMAGE}", f"/{topics.COMPRESSED}"}
        return [
            (node, subscription)
            for node in self.nodes.values()
            for subscription in node.subscriptions
            if subscription.topic_name == wanted
            or (wanted in raw and subscription.topic_name in raw)
        ]

    def send(self, topic: str, message: Any) -> None:
        """Deliver a message to all who subscribe to its topic, as DDS would."""
        data = serialize_message(message)
        self.delivered[topic] += 1
        for node, subscription in self.subscriptions(topic):
            copy = deserialize_message(data, type(message))
            words = [copy]
            if topic == topics.COMMAND:
                sent = {"source_timestamp": time.time_ns(), "received_timestamp": time.time_ns()}
                words.append(sent)
            self.guarded(f"{node.get_name()} {topic}", subscription.callback, *words)

    def request(self, service: Any, request: Any) -> Any:
        """Call a service as DDS would; rclpy's own may choke, since `spin` catches that."""
        self.delivered["service"] += 1
        copy = deserialize_message(serialize_message(request), type(request))
        response = service.srv_type.Response()
        answer = self.guarded(f"service {service.srv_name}", service.callback, copy, response)
        if answer is not None:
            serialize_message(answer)
        return answer

    def guarded(self, what: str, callback: Any, *words: Any) -> Any:
        """Run a callback; an exception that passes through this package is a defect."""
        try:
            return callback(*words)
        except Exception as err:
            frames = traceback.extract_tb(err.__traceback__)
            if any("/dlo_ros/" in frame.filename for frame in frames):
                at = frames[-1]
                self.problems.append(
                    f"{what}: {type(err).__name__}: {err} ({at.filename}:{at.lineno})"
                )
            return None

    def tick(self, stamp: int) -> None:
        """Set simulated time [ns]."""
        seconds, rest = divmod(stamp, NANOSECONDS)
        self.clock(Clock(clock=Time(sec=seconds, nanosec=rest)))
        self.now = stamp

    def clock(self, message: Any) -> None:
        """Deliver a /clock message; rclpy refuses some of them by itself."""
        self.delivered["/clock"] += 1
        data = serialize_message(message)
        for node in self.nodes.values():
            copy = deserialize_message(data, Clock)
            self.guarded(f"{node.get_name()} /clock", node._time_source.clock_callback, copy)

    def spin(self, times: int = 6) -> None:
        """Let timers and guard conditions have their turn."""
        for _ in range(times):
            try:
                self.executor.spin_once(timeout_sec=0.0)
            except Exception as err:
                frames = traceback.extract_tb(err.__traceback__)
                if any("/dlo_ros/" in frame.filename for frame in frames):
                    self.problems.append(f"timer: {type(err).__name__}: {err} ({frames[-1]})")

    def defects(self) -> list[str]:
        """What was wrong since the last call, each kind once, numbers aside."""
        problems, self.problems = self.problems, []
        kinds = {re.sub(r"[\d.e+-]+", "#", problem)[:120]: problem for problem in problems}
        return list(kinds.values())

    def works(self, seconds: float = 30.0) -> None:
        """Whether all three do their work on good input; time has begun anew."""
        for node in self.nodes.values():
            node.set_parameters(
                [Parameter(k, value=_value(v)) for k, v in SETTINGS.flat().items()
                 if node.has_parameter(k) and not node.describe_parameter(k).read_only]
                + [Parameter("use_sim_time", value=True)]
            )  # fmt: skip
        start = BEGIN + 1000 * NANOSECONDS
        self.tick(start)
        for service in [s for n in self.nodes.values() for s in n.services]:
            if service.srv_name.endswith(("/reset", "/pause")):
                self.request(service, service.srv_type.Request())
        self.published.clear()
        deadline, stamp = time.monotonic() + seconds, start
        wanted = {topics.OBSERVED, topics.PREDICTED, topics.ERR, topics.YOUNG_MODULUS}
        while not wanted <= {t.lstrip("/") for t, n in self.published.items() if n > 3}:
            states = {name: node.health.state for name, node in self.nodes.items()}
            done = f"only {dict(self.published)} after good input; {states}"
            assert time.monotonic() < deadline, done
            self.tick(stamp)
            self.send(topics.CAMERA_INFO, self.good.camera_info(stamp))
            if stamp == start:
                self.send(topics.COMMAND, self.good.command(stamp))
            self.send(topics.IMAGE, self.good.image(stamp))
            self.send(topics.OBSERVED, self.good.spline(stamp))
            self.spin(20)
            stamp += 40_000_000
        found = self.defects()
        assert not found, "\n".join(found)


def _value(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
