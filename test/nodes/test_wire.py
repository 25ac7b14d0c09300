# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Payloads over real DDS that no ROS program would send: cut short, flipped, of another type.

Deserialising happens in the middleware, beneath all that the package checks: its exceptions come
up in the executor, and a length that lies could take all memory or the process with it.
"""

from __future__ import annotations

import os
import random
import struct
from collections import Counter
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Time
from fuzz_graph import BEGIN, SETTINGS, Good
from hostile import not_finite
from live_graph import Client, Process
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

from dlo_ros.demo.network import free_domain
from dlo_ros.nodes.qos import LATCHED
from dlo_ros.recordings import topics

pytestmark = [pytest.mark.live, pytest.mark.slow]

PAYLOADS = int(os.environ.get("DLO_WIRE_PAYLOADS", "150"))
SEED = int(os.environ.get("DLO_FUZZ_SEED", "1"))
GROWTH = 250e6
"""Bytes that a node may grow by; compiled code that the estimator loads as it begins is 100 MB."""

LENGTHS = (0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 0x40000000, 0x10000000, 0x01000000, 65_536, 0)
NODES = ("observer", "simulator", "identifier")


def garbage(rng: random.Random, good: bytes, others: list[bytes]) -> bytes:
    """A serialised message, damaged; the first four bytes say how it is encoded."""
    change = rng.choice(
        ("cut", "cut", "flip", "flip", "length", "length", "random", "other", "long")
    )
    if change == "cut":
        return good[: rng.choice((rng.randrange(len(good)), rng.randrange(min(len(good), 64))))]
    if change == "other":
        return rng.choice(others)
    if change == "long":
        return good + bytes(rng.randrange(1, 5000))
    if change == "random":
        return rng.choice((good[:4], rng.randbytes(4))) + rng.randbytes(rng.randrange(2000))
    data = bytearray(good)
    most = rng.choice((len(data), min(len(data), 200)))
    if change == "flip":
        for _ in range(rng.choice((1, 1, 3, 20))):
            data[rng.randrange(most)] ^= 1 << rng.randrange(8)
    else:  # where a length may stand
        at = 4 + 4 * rng.randrange(max((most - 4) // 4, 1))
        data[at : at + 4] = struct.pack("<I", rng.choice(LENGTHS))
    return bytes(data)


def resident(process: Process) -> int:
    """Resident memory of a process [bytes]."""
    statm = Path(f"/proc/{process.process.pid}/statm").read_text()
    return int(statm.split()[1]) * 4096


class Wire:
    """The three live nodes on simulated time, and publishers that send bytes as they are.

    Args:
        folder: folder for logs and the parameter file.
        images: the topic of the camera; the observer takes only one of the two.
    """

    def __init__(self, folder: Path, images: str) -> None:
        self.images = images
        SETTINGS.dump(folder / "params.yaml")
        words = ("--ros-args", "--params-file", str(folder / "params.yaml"))
        words += ("-p", "use_sim_time:=true")
        domain = free_domain()
        self.nodes = {name: Process(folder, name, *words, domain=domain) for name in NODES}
        self.client, self.good, self.now = Client(domain), Good(), BEGIN
        self.heard = {t: self.client.hear(t, 50) for t in (topics.OBSERVED, topics.PREDICTED)}
        self.errors = self.client.hear(topics.ERR, 50)
        self.clock = self.client.node.create_publisher(Clock, "/clock", QoSProfile(depth=10))
        self.client.until(lambda: self.clock.get_subscription_count() >= 3, 120.0, "nodes start")
        self.client.wait_for_ready(*NODES)
        self.publishers = {
            topic: self.client.publisher(topic, LATCHED if topic in topics.LATCHED else 50)
            for topic in self.messages()
        }

    def close(self) -> None:
        self.client.close()
        for process in self.nodes.values():
            process.process.kill()
            process.wait()

    def messages(self) -> dict[str, object]:
        """A good message for each topic that a node subscribes to."""
        good, now = self.good, self.now
        picture = good.image if self.images == topics.IMAGE else good.compressed
        return {
            topics.COMMAND: good.command(now),
            topics.OBSERVED: good.spline(now),
            topics.OBSERVED_POINTS: good.points(now),
            topics.PREDICTED: good.spline(now),
            topics.CAMERA_INFO: good.camera_info(now),
            topics.MASK: good.mask(now),
            self.images: picture(now),
        }

    def tick(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)
        second, rest = divmod(self.now, 10**9)
        self.clock.publish(Clock(clock=Time(sec=second, nanosec=rest)))

    def works(self) -> None:
        """Observer, simulator and identifier do their work on good input, of a new time."""
        self.now += 100 * 10**9
        self.tick(0.0)
        self.client.spin(0.5)
        for messages in (*self.heard.values(), self.errors):
            messages.clear()
        self.publishers[topics.COMMAND].publish(self.good.command(self.now))

        def done() -> bool:
            self.tick(0.04)
            for topic in (topics.CAMERA_INFO, self.images):
                self.publishers[topic].publish(self.messages()[topic])
            self.client.spin(0.1)
            return all(len(m) > 3 for m in (*self.heard.values(), self.errors))

        self.client.until(done, 120.0, "good input; " + "\n".join(self.said()))
        for messages in (*self.heard.values(), self.errors):
            assert not any(map(not_finite, messages))

    def refused(self, topic: str) -> bool:
        """Whether a node has said why it does not take a message of a topic."""
        return any(f"]: {topic}" in process.said for process in self.nodes.values())

    def said(self) -> list[str]:
        return [f"{name}: {process.said[-2000:]}" for name, process in self.nodes.items()]


@pytest.fixture(params=[topics.IMAGE, topics.COMPRESSED])
def wire(tmp_path, request):
    made = Wire(tmp_path, request.param)
    yield made
    made.close()


def test_nodes_live_through_bytes_that_are_no_messages(wire):
    wire.works()
    rng, sent = random.Random(SEED), Counter()
    before = {name: resident(process) for name, process in wire.nodes.items()}
    good = {topic: bytes(serialize_message(m)) for topic, m in wire.messages().items()}
    good["/clock"] = bytes(serialize_message(Clock()))
    publishers = wire.publishers | {"/clock": wire.clock}
    for k in range(PAYLOADS):
        topic = rng.choice(sorted(good))
        try:
            publishers[topic].publish(garbage(rng, good[topic], list(good.values())))
            sent[topic] += 1
        except RuntimeError:  # the middleware sends no more bytes than the longest message has
            sent["refused by the sender"] += 1
        wire.client.spin(0.01)
        dead = [name for name, process in wire.nodes.items() if not process.alive]
        assert not dead, (k, topic, wire.said())
    # Some can be read and make no sense: what the nodes say shows that bytes arrive as they are.
    # Their logs tell every kind of it, the diagnostics only the latest.
    for topic in (topics.COMMAND, topics.OBSERVED, topics.CAMERA_INFO):
        wire.client.until(lambda t=topic: wire.refused(t), 30.0, "\n".join((topic, *wire.said())))
    wire.works()
    grown = {name: resident(process) - before[name] for name, process in wire.nodes.items()}
    print(
        f"\n{sum(sent.values())} payloads {dict(sent)}; resident memory grew by "
        + ", ".join(f"{name} {value / 1e6:.0f} MB" for name, value in grown.items())
    )
    assert max(grown.values()) < GROWTH, grown
    for process in wire.nodes.values():
        assert process.interrupt(times=2) == 0
        assert "Traceback" not in process.said, process.said
