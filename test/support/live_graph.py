# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Real processes of this package in a ROS graph of their own, and a client to talk to them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import rclpy
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParametersAtomically,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message

from dlo_ros.demo.network import free_domain
from dlo_ros.nodes.message_factory import message_class
from dlo_ros.nodes.qos import DEEP, LATCHED
from dlo_ros.recordings import topics

DOMAIN = free_domain()
ROOT = Path(__file__).resolve().parents[2]


class Process:
    """`dlo_ros NAME ...` as the user runs it; what it prints goes to a file."""

    def __init__(self, folder: Path, *words: str, domain: int = DOMAIN) -> None:
        self.log = folder / f"{words[0]}-{time.monotonic_ns()}.log"
        environment = dict(
            os.environ,
            ROS_DOMAIN_ID=str(domain),
            ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            ROS_PYTHON_CHECK_FIELDS="1",
            ROS_LOG_DIR=str(folder),
            OMP_NUM_THREADS="1",
            PYTHONPATH=os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        )
        with self.log.open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "dlo_ros", *words],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
                cwd=folder,
            )

    @property
    def said(self) -> str:
        return self.log.read_text()

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    def wait(self, seconds: float = 60.0) -> int:
        try:
            return self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise AssertionError(f"does not end; it said: {self.said}") from None

    def interrupt(self, times: int = 1, number: int = signal.SIGINT) -> int:
        for _ in range(times):
            if self.alive:
                self.process.send_signal(number)
                time.sleep(0.01)
        return self.wait()


class Client:
    """A node in the test's own process."""

    def __init__(self, domain: int = DOMAIN) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("client", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.heard: dict[str, list] = {}

    def close(self) -> None:
        self.executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def until(self, condition: Callable[[], object], seconds: float = 45.0, what: str = "") -> None:
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f"waited {seconds} s in vain: {what}"
            self.executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        self.until(lambda: time.monotonic() >= deadline, seconds + 5.0)

    def hear(self, topic: str, qos=DEEP, kind: str = "") -> list:
        """Subscribe; returns the growing list of messages.

        Deep, since this process also unpacks images: at a depth of 10 it loses splines meanwhile.
        """
        name = topic if topic.startswith("/") else f"/{topic}"
        if name not in self.heard:
            messages: list = []
            cls = message_class(kind or topics.TYPES[topic])
            self.node.create_subscription(cls, name, messages.append, qos)
            self.heard[name] = messages
        return self.heard[name]

    def wait_for_ready(self, *nodes: str, seconds: float = 120.0) -> None:
        """Wait until nodes take data, their full names without the first slash."""
        said = {n: self.hear(f"/{n}/ready", LATCHED, "std_msgs/msg/Bool") for n in nodes}
        self.until(
            lambda: all(heard and heard[-1].data for heard in said.values()), seconds, "ready nodes"
        )

    def publisher(self, topic: str, qos=10, matched: int = 1):
        publisher = self.node.create_publisher(message_class(topics.TYPES[topic]), topic, qos)
        self.until(lambda: publisher.get_subscription_count() >= matched, what=f"{topic} matched")
        return publisher

    def call(self, kind, name: str, request):
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, what=name)
        future = client.call_async(request)
        self.until(future.done, what=f"answer of {name}")
        self.node.destroy_client(client)
        return future.result()

    def set(self, node: str, **values):
        parameters = [Parameter(k.replace("__", "."), value=v) for k, v in values.items()]
        request = SetParametersAtomically.Request(
            parameters=[p.to_parameter_msg() for p in parameters]
        )
        return self.call(
            SetParametersAtomically, f"{node}/set_parameters_atomically", request
        ).result

    def get(self, node: str, *names: str) -> list:
        request = GetParameters.Request(names=list(names))
        values = self.call(GetParameters, f"{node}/get_parameters", request).values
        return [Parameter.from_parameter_msg(_named(v)).value for v in values]

    def names(self, node: str) -> tuple[str, ...]:
        answer = self.call(ListParameters, f"{node}/list_parameters", ListParameters.Request())
        return tuple(answer.result.names)

    def describe(self, node: str, name: str):
        request = DescribeParameters.Request(names=[name])
        return self.call(DescribeParameters, f"{node}/describe_parameters", request).descriptors[0]


def _named(value):
    from rcl_interfaces.msg import Parameter as Message

    return Message(name="x", value=value)


def to_ros(message):
    """A message of rosbags' types as rclpy's."""
    from dlo_ros.recordings.bag import TYPESTORE

    kind = message.__msgtype__
    data = bytes(TYPESTORE.serialize_cdr(message, kind))
    return deserialize_message(data, message_class(kind))
