# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Messages of dlo/metrics and /tf_static, in the types that rosbags has from ROS's definitions."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import recordings_samples as samples
from scipy.spatial.transform import Rotation

pytest.importorskip("rclpy")

from rclpy.qos import DurabilityPolicy

from dlo_ros.errors import InputError
from dlo_ros.identification.estimate import Estimate
from dlo_ros.inference.err import Deviation
from dlo_ros.nodes import metrics, node_base, transform_broadcaster
from dlo_ros.nodes.message_factory import ROS_MESSAGES, installed
from dlo_ros.nodes.qos import RELIABLE
from dlo_ros.parameters import CameraPose
from dlo_ros.recordings import BAG_MESSAGES, topics
from dlo_ros.recordings.bag import TYPESTORE
from dlo_ros.recordings.message_building import metric_message, transform_message
from dlo_ros.recordings.transforms import Transforms
from dlo_ros.vision.camera.pinhole import Camera

STAMP = samples.START + 123
KINDS = TYPESTORE.types["statistics_msgs/msg/StatisticDataType"]
AVERAGE = KINDS.STATISTICS_DATA_TYPE_AVERAGE
STD = KINDS.STATISTICS_DATA_TYPE_STDDEV
MAXIMUM = KINDS.STATISTICS_DATA_TYPE_MAXIMUM
POSE = CameraPose((0.1, -0.2, 1.5), (0.7, 0.05, -0.02, 0.71))


class Node:
    """A node as far as it publishes: the messages go through ROS's serialisation into lists."""

    def __init__(self, settings=samples.SETTINGS, missing=False) -> None:
        self.settings, self.missing = settings, missing
        self.published: dict[str, list] = {}
        self.profiles: dict[str, object] = {}
        self.warnings: list[str] = []
        self.health = SimpleNamespace(warn=lambda kind, text: self.warnings.append(text))

    def optional_publisher(self, topic, qos, kind=""):
        if self.missing:
            return None
        kind = kind or topics.TYPES[topic]
        heard = self.published.setdefault(topic, [])
        self.profiles[topic] = qos

        def publish(message):
            data = TYPESTORE.serialize_cdr(message, kind)
            heard.append(TYPESTORE.deserialize_cdr(data, kind))

        return SimpleNamespace(publish=publish)

    def get_fully_qualified_name(self) -> str:
        return "/left/identifier"

    def now(self) -> int:
        return STAMP


@pytest.fixture(autouse=True)
def definitions(monkeypatch):
    """Messages of the same fields as ROS's own, which need not be installed."""
    for module in (metrics, transform_broadcaster):
        monkeypatch.setattr(module, "ROS_MESSAGES", BAG_MESSAGES)


def stamp_of(time) -> int:
    return time.sec * 10**9 + time.nanosec


def numbers(message) -> dict[int, float]:
    assert len({p.data_type for p in message.statistics}) == len(message.statistics)
    return {p.data_type: p.data for p in message.statistics}


def estimate(**changed) -> Estimate:
    whole = Estimate(
        samples.SETTINGS, 2e6, 1500.0, 2e6 / 1500.0, 1e5, None, 40.0,
        {"young_modulus": True}, np.zeros((4, 4)),
    )  # fmt: skip
    return replace(whole, **changed)


def test_an_err_carries_its_stamp_and_its_spread_along_the_dlo():
    node = Node()
    metrics.Metrics(node).err(STAMP, Deviation(0.002, 0.0005, 0.004))
    (message,) = node.published[topics.METRICS]
    assert (message.metrics_source, message.unit) == ("err", "m")
    assert message.measurement_source_name == "left/identifier"
    assert stamp_of(message.window_start) == stamp_of(message.window_stop) == STAMP
    assert numbers(message) == {AVERAGE: 0.002, STD: 0.0005, MAXIMUM: 0.004}


def test_estimates_carry_their_standard_deviation_where_it_is_bounded():
    node = Node()
    metrics.Metrics(node).estimate(STAMP, estimate())
    messages = {m.metrics_source: m for m in node.published[topics.METRICS]}
    assert {name: m.unit for name, m in messages.items()} == {
        "young_modulus": "Pa", "density": "kg/m^3", "specific_modulus": "m^2/s^2",
    }  # fmt: skip
    assert {stamp_of(m.window_stop) for m in messages.values()} == {STAMP}
    assert numbers(messages["young_modulus"]) == {AVERAGE: 2e6, STD: 1e5}
    assert numbers(messages["density"]) == {AVERAGE: 1500.0}
    assert numbers(messages["specific_modulus"]) == {AVERAGE: 2e6 / 1500.0, STD: 40.0}


def test_what_is_not_finite_is_not_published():
    node = Node()
    metrics.Metrics(node).estimate(STAMP, estimate(young_modulus=np.nan, density_std=np.inf))
    names = [m.metrics_source for m in node.published[topics.METRICS]]
    assert names == ["specific_modulus"] and len(node.warnings) == 2
    assert "young_modulus not published on dlo/metrics: nan is not finite" in node.warnings
    for given in ({"average": np.inf}, {"average": 1.0, "maximum": np.nan}):
        with pytest.raises(InputError, match="is not finite"):
            metric_message(BAG_MESSAGES, "n", "err", "m", STAMP, **given)


def test_without_the_packages_nothing_is_published_and_nothing_fails():
    node = Node(missing=True)
    metrics.Metrics(node).err(STAMP, Deviation(0.002, 0.0005, 0.004))
    metrics.Metrics(node).estimate(STAMP, estimate())
    transform_broadcaster.BoardTransform(node).seen_by("camera")
    assert not node.published and not node.warnings


def test_the_transform_takes_points_of_the_board_into_the_camera():
    node = Node(replace(samples.SETTINGS, camera=POSE))
    transform_broadcaster.BoardTransform(node).seen_by("camera_optical")
    (message,) = node.published[topics.TRANSFORMS]
    (stamped,) = message.transforms
    assert stamped.header.frame_id == "camera_optical" and stamped.child_frame_id == "board"
    assert stamp_of(stamped.header.stamp) == STAMP
    assert node.profiles[topics.TRANSFORMS].durability == DurabilityPolicy.TRANSIENT_LOCAL
    t, q = stamped.transform.translation, stamped.transform.rotation
    turn = np.array([q.x, q.y, q.z, q.w])
    assert np.linalg.norm(turn) == pytest.approx(1.0, abs=1e-12)
    point = np.array([0.1, 0.0, -0.05])
    seen = Rotation.from_quat(turn).apply(point) + np.array([t.x, t.y, t.z])
    k = np.array(samples.INFO.k).reshape(3, 3)
    camera = Camera(k, (), samples.INFO.width, samples.INFO.height, POSE, "")
    expected = camera.project(point[None])[0]
    assert (k @ seen)[:2] / seen[2] == pytest.approx(expected, abs=1e-6)


class Checking:
    """rclpy's own messages, which check their fields, wherever their package is installed."""

    def make(self, kind, /, **fields):
        return (ROS_MESSAGES if installed(kind) else BAG_MESSAGES).make(kind, **fields)


def test_fields_have_the_types_that_rclpy_checks():
    pose = (np.float64(1), 0, 2), (0, 0, np.float64(0.5), 0)
    (stamped,) = transform_message(Checking(), STAMP, "camera", "board", *pose).transforms
    assert type(stamped).__module__.startswith("geometry_msgs")
    assert stamped.transform.rotation.z == 1.0
    message = metric_message(Checking(), "n", "err", "m", STAMP, average=np.float64(1), std=2)
    assert type(message.window_start).__module__.startswith("builtin_interfaces")
    assert all(type(p.data) is float and type(p.data_type) is int for p in message.statistics)


def test_the_transform_is_sent_again_only_where_it_changes():
    node = Node()
    board = transform_broadcaster.BoardTransform(node)
    board.update()  # no camera yet
    assert not node.published[topics.TRANSFORMS]
    for _ in range(3):
        board.seen_by("one")
    node.settings = replace(node.settings, camera=POSE)
    board.update()
    board.seen_by("two")
    parents = [m.transforms[0].header.frame_id for m in node.published[topics.TRANSFORMS]]
    assert parents == ["one", "one", "two"] and not node.warnings


def test_the_board_joins_the_frames_of_several_cameras():
    """The chain of transforms leads from one camera to the other, and through the board."""
    pair = {"left": POSE, "right": CameraPose((0.1, -0.2, 1.5), (0.5, 0.5, 0.5, 0.5))}
    node = Node(replace(samples.SETTINGS, cameras=pair))
    board = transform_broadcaster.BoardTransform(node)
    board.seen_by("right_eye", "right")
    board.seen_by("left_eye", "left")
    first, both = node.published[topics.TRANSFORMS]
    assert [(t.header.frame_id, t.child_frame_id) for t in first.transforms] == [
        ("board", "right_eye")
    ]
    tree = Transforms()
    tree.add(both, fixed=True)
    assert tree.parents == {"board": "left_eye", "right_eye": "board"}
    for name, pose in pair.items():
        turned, origin = tree.lookup("board", f"{name}_eye", [STAMP])
        assert np.allclose(origin[0], pose.translation)
        assert np.allclose(turned[0], Rotation.from_quat(pose.rotation).as_matrix())


def test_cameras_with_one_frame_are_told_of():
    node = Node(replace(samples.SETTINGS, cameras={"left": POSE, "right": POSE}))
    board = transform_broadcaster.BoardTransform(node)
    board.seen_by("eye", "left")
    board.seen_by("eye", "right")
    assert len(node.published[topics.TRANSFORMS]) == 1
    assert node.warnings == [
        "no transform on /tf_static: the cameras left, right have the frames eye, eye; give each "
        "camera_info a frame of its own"
    ]


@pytest.mark.parametrize("frame", ["", "board"])
def test_a_camera_without_a_frame_of_its_own_is_told_of_once(frame):
    node = Node()
    board = transform_broadcaster.BoardTransform(node)
    board.seen_by(frame)
    board.seen_by(frame)
    assert not node.published[topics.TRANSFORMS]
    assert node.warnings == [
        f"no transform on /tf_static: a transform needs two frames; these are '{frame}' and 'board'"
    ]


def test_the_transform_can_be_switched_off():
    node = Node(replace(samples.SETTINGS, publish_tf=False))
    transform_broadcaster.BoardTransform(node).seen_by("camera")
    assert not node.published


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 1.0)])
def test_a_pose_that_is_none_is_refused(rotation):
    with pytest.raises(InputError, match="of board is none"):
        transform_message(BAG_MESSAGES, STAMP, "camera", "board", (0.0, 0.0, 1.0), rotation)


@pytest.mark.parametrize("there", [True, False])
def test_a_missing_package_is_told_in_a_line(there, monkeypatch):
    lines, made = [], []
    logger = SimpleNamespace(info=lines.append)
    node = SimpleNamespace(
        get_logger=lambda: logger, publisher=lambda *arguments: made.append(arguments) or "it"
    )
    monkeypatch.setattr(node_base, "installed", lambda kind: there)
    found = node_base.DloNode.optional_publisher(node, topics.METRICS, RELIABLE)
    assert found == ("it" if there else None) and len(made) == there
    missing = "dlo/metrics is not published, since statistics_msgs is not installed"
    assert lines == ([] if there else [missing])


def test_what_is_installed_is_known():
    assert installed("std_msgs/msg/Float64") and not installed("no_such_msgs/msg/Nothing")
