# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`doctor` beside a real node and two publishers that do what they should not."""

import pytest

pytest.importorskip("rclpy")

from live_graph import Client, Process
from rclpy.node import Node

from dlo_ros.cli.doctor import judge
from dlo_ros.demo.network import free_domain
from dlo_ros.nodes import qos
from dlo_ros.nodes.graph_watch import NAME, GraphWatch
from dlo_ros.nodes.message_factory import message_class
from dlo_ros.recordings import topics

pytestmark = [pytest.mark.live, pytest.mark.slow]

OTHER = "/camera/image_raw"
ROD = {"length": 0.4, "diameter": 0.004}


def test_what_is_wrong_in_a_live_graph_is_found(tmp_path):
    domain = free_domain()
    arguments = [word for k, v in ROD.items() for word in ("-p", f"rod.{k}:={v}")]
    observer = Process(
        tmp_path, "observer", "--ros-args", "-p", "use_sim_time:=true", *arguments, domain=domain
    )
    robot = Client(domain)
    doctor = Node(NAME, context=robot.context)
    robot.executor.add_node(doctor)
    try:
        robot.node.create_publisher(
            message_class(topics.TYPES[topics.PREDICTED]), f"/{topics.PREDICTED}", qos.SENSOR
        )
        robot.node.create_publisher(message_class(topics.TYPES[topics.IMAGE]), OTHER, 10)
        view = GraphWatch(doctor)

        def told():
            """What is found now; each look asks for all endpoints and costs some time."""
            robot.spin(0.5)
            view.look()
            sections = judge(view.graph("rmw", 1.0), None)
            return " ".join(f"{f.text} {f.remedy}" for s in sections.values() for f in s)

        for word in (
            "/dlo/predicted: /observer receives nothing from /client: the publisher is best effort",
            f"/observer listens to /image_raw, which nobody publishes; there is {OTHER}",
            "/observer with use_sim_time, but no clock is received",
            "/observer: waiting for",
        ):
            robot.until(lambda word=word: word in told(), 120.0, word)
        assert NAME not in told()
    finally:
        robot.executor.remove_node(doctor)
        doctor.destroy_node()
        robot.close()
        observer.interrupt()
