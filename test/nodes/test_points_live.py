# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The observer, live, with points of another tracker and the pose of a robot's hand."""

import time

import numpy as np
import pytest
from point_lists import LENGTH, SETTINGS, N, bent, tracked
from scipy.spatial.transform import Rotation

pytest.importorskip("rclpy")

from dataclasses import replace
from unittest.mock import MagicMock

from live_graph import Client, Process

from dlo_ros.command import Motion
from dlo_ros.demo.network import free_domain
from dlo_ros.nodes.message_factory import ROS_MESSAGES, message_class
from dlo_ros.nodes.qos import DEEP
from dlo_ros.nodes.tracker_points import TrackerPointsListener
from dlo_ros.parameters import CommandParameters
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import cloud_message, header
from dlo_ros.recordings.messages import stamp_of
from dlo_ros.spline import SplineBasis

pytestmark = pytest.mark.live

OFFSET = np.array([0.0, 0.0, 0.1])
"""From the hand's frame to the clamp [m]."""


def hand(curve, stamp):
    """The pose of the hand that holds the start, as a message."""
    turn = Rotation.align_vectors([curve.tangents[0]], [[1.0, 0.0, 0.0]])[0]
    kinds = "geometry_msgs/msg/"
    x, y, z = (curve.points[0] - turn.apply(OFFSET)).tolist()
    point = ROS_MESSAGES.make(kinds + "Point", x=x, y=y, z=z)
    x, y, z, w = turn.as_quat().tolist()
    rotation = ROS_MESSAGES.make(kinds + "Quaternion", x=x, y=y, z=z, w=w)
    pose = ROS_MESSAGES.make(kinds + "Pose", position=point, orientation=rotation)
    head = header(ROS_MESSAGES, stamp, "board")
    return ROS_MESSAGES.make(kinds + "PoseStamped", header=head, pose=pose)


def cloud(curve, seed, stamp, frame="board"):
    table = tracked(curve, seed).positions
    return cloud_message(ROS_MESSAGES, stamp, frame, ("x", "y", "z"), table)


def test_points_are_left_out_while_images_show_the_dlo():
    """As the tools do with a bag that has both; two sources on one topic would alternate."""
    node, published, images = MagicMock(settings=SETTINGS, ready=True), [], [True]
    node.is_earlier.return_value = False
    listener = TrackerPointsListener(
        node, Motion(), lambda seen: not published.append(seen), lambda: images[0]
    )
    listener._on_points(cloud(bent(1), 0, 1))
    (_, told) = node.health.warn.call_args.args
    assert not published and "-r image_raw:=unused" in told
    images[0] = False
    listener._on_points(cloud(bent(1), 0, 2))
    assert [o.stamp for o in published] == [2]


def test_points_and_poses_live(tmp_path):
    curve = bent(1)
    if curve.points[0, 0] < curve.points[-1, 0]:  # held where it would not begin by itself
        curve = replace(
            curve, points=curve.points * [-1, 1, 1], tangents=curve.tangents * [-1, 1, 1]
        )
    own = CommandParameters("pose", start_offset=(*OFFSET.tolist(), 0.0, 0.0, 0.0, 1.0))
    replace(SETTINGS, command=own).dump(tmp_path / "params.yaml")
    domain = free_domain()
    params = ("--ros-args", "--params-file", str(tmp_path / "params.yaml"))
    client = Client(domain)
    observer = Process(tmp_path, "observer", *params, domain=domain)
    try:
        seen = client.hear(topics.OBSERVED, DEEP)
        clouds = client.hear(topics.OBSERVED_POINTS, DEEP)
        told = client.hear("/diagnostics", DEEP, "diagnostic_msgs/msg/DiagnosticArray")
        makers = {
            topic: client.node.create_publisher(message_class(topics.TYPES[topic]), topic, 10)
            for topic in (topics.POINTS, topics.START_POSE)
        }
        client.wait_for_ready("observer")
        sent = 0

        def send(frame="board"):
            nonlocal sent
            stamp = time.time_ns()
            makers[topics.START_POSE].publish(hand(curve, stamp))
            makers[topics.POINTS].publish(cloud(curve, sent, stamp, frame))
            sent += 1
            client.spin(0.1)

        def begins_in_the_hand():
            send()
            first = [m.poses[0].position for m in seen[-3:]]
            near = [np.linalg.norm([p.x, p.y, p.z] - curve.points[0]) < 0.02 for p in first]
            return len(near) == 3 and all(near)

        client.until(begins_in_the_hand, what="splines that begin in the hand")
        last = seen[-1]
        shape = np.array([[p.position.x, p.position.y, p.position.z] for p in last.poses])
        u = np.linspace(0.0, LENGTH, 100)
        gap = SplineBasis(N, LENGTH).evaluate(shape, u) - curve.at(u)
        assert np.sqrt(np.mean(np.sum(gap**2, axis=1))) < 0.005
        client.until(
            lambda: stamp_of(last) in {stamp_of(m) for m in clouds}, what="the points of the spline"
        )

        def named():
            send("nowhere")
            return any("'nowhere'" in s.message + str(s.values) for m in told for s in m.status)

        client.until(named, what="a warning that names the frame")
        assert observer.alive
    finally:
        observer.interrupt()
        client.close()
