# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What nodes as processes make of messages: hostile ones, early commands, images, a photograph."""

from __future__ import annotations

import math
import signal
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import recordings_samples as samples

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticStatus
from live_graph import to_ros
from live_system import NODES, START, System, stamp_of, straight, swing
from rclpy.qos import qos_profile_sensor_data
from vision_scenes import Scene, bow, clamps, render
from vision_scenes import settings as vision_settings

from dlo_ros.command import Command
from dlo_ros.nodes.message_factory import message_class
from dlo_ros.nodes.qos import LATCHED
from dlo_ros.parameters import Settings
from dlo_ros.recordings import (
    BAG_MESSAGES,
    CameraInfo,
    camera_info_message,
    command_message,
    compressed_message,
    iterate_images,
    read_image,
    spline_message,
    topics,
)

pytestmark = pytest.mark.live


def hostile_splines() -> list:
    shape = straight()
    good = spline_message(BAG_MESSAGES, START, "board", shape)

    def changed(change) -> object:
        message = to_ros(good)
        change(message)
        return message

    def nan(m):
        m.poses[3].position.x = math.nan

    def frame(m):
        m.header.frame_id = "map"

    def none(m):
        m.poses = []

    def many(m):
        m.poses = m.poses * 400

    def zero(m):
        m.poses[2].orientation.w = 0.0

    def far(m):
        m.poses[2].position.z = 1e300

    return [changed(c) for c in (nan, frame, none, many, zero, far)]


def test_hostile_messages_are_warnings(waiting):
    """Whatever arrives, the nodes live, say so, and do their work afterwards."""
    client = waiting.client
    predicted, err = client.hear(topics.PREDICTED, 50), client.hear(topics.ERR, 50)
    commands = client.publisher(topics.COMMAND, matched=3)  # volatile, as robots publish
    splines = client.publisher(topics.OBSERVED, matched=2)
    images = client.publisher(topics.IMAGE, qos_profile_sensor_data)
    infos = client.publisher(topics.CAMERA_INFO, qos_profile_sensor_data)
    for message in hostile_splines():
        splines.publish(message)
    command = swing(START)
    bad = to_ros(command_message(BAG_MESSAGES, command))
    bad.joint_names = ["gripper"]
    commands.publish(bad)
    bad = to_ros(command_message(BAG_MESSAGES, command))
    bad.points[3].transforms[0].translation.y = math.nan
    commands.publish(bad)
    info = to_ros(samples.camera_info_message(BAG_MESSAGES, START, samples.INFO))
    info.k = [0.0] * 9
    image = to_ros(samples.image_message(BAG_MESSAGES, START, "c", samples.picture()))
    image.step = 7
    images.publish(image)
    client.until(
        lambda: all(waiting.values(name).get("problems: dlo/command") for name in NODES),
        what="warnings about the command",
    )
    assert waiting.status("simulator").level == DiagnosticStatus.WARN
    for name in ("simulator", "identifier"):  # which say so once a second
        client.until(
            lambda name=name: waiting.values(name).get("problems: dlo/observed") == "6",
            what=f"warnings of the {name} about each spline",
        )

    def told_of_the_camera():
        infos.publish(info)  # again and again, as cameras do: a single one may be lost
        return "problems: camera_info" in waiting.values("observer")

    client.until(told_of_the_camera, what="camera_info")
    info = to_ros(samples.camera_info_message(BAG_MESSAGES, START, samples.INFO))

    def told_of(problem, image):
        infos.publish(info)  # sensor data, of which single messages may be lost
        images.publish(image)
        return f"problems: {problem}" in waiting.values("observer")

    client.until(lambda: told_of("image_raw", image), what="lying step")
    empty = to_ros(samples.image_message(BAG_MESSAGES, START, "c", samples.picture()))
    client.until(lambda: told_of("image", empty), what="no DLO")
    waiting.all_alive()
    assert predicted == [] and err == []
    # A stamp from the future must not make all that follows look old.
    future = client.node.get_clock().now().nanoseconds + 3600 * 10**9
    splines.publish(to_ros(spline_message(BAG_MESSAGES, future, "board", straight())))
    # A good command without a stamp, and a shape of now: prediction begins.
    now = client.node.get_clock().now().nanoseconds
    message = to_ros(command_message(BAG_MESSAGES, replace(swing(0), stamp=0)))
    commands.publish(message)
    splines.publish(to_ros(spline_message(BAG_MESSAGES, now, "board", straight())))
    client.until(lambda: len(predicted) > 20, what="prediction after good input")
    # A malformed command does not end the motion of the last good one.
    commands.publish(bad)
    predicted.clear()
    client.until(lambda: len(predicted) > 20, what="prediction after another bad command")
    for message in predicted:
        values = [c for p in message.poses for c in (p.position.x, p.position.y, p.position.z)]
        assert np.all(np.isfinite(values))
    waiting.all_alive()


@pytest.mark.slow
def test_a_command_sent_before_a_node_started_is_not_lost(waiting):
    client = waiting.client
    latched = client.node.create_publisher(
        type(to_ros(command_message(BAG_MESSAGES, swing(0)))), "/early/dlo/command", LATCHED
    )
    latched.publish(to_ros(command_message(BAG_MESSAGES, swing(START))))
    node = waiting.start("simulator", *waiting.arguments, "-r", "__ns:=/early")
    client.until(
        lambda: waiting.values("early/simulator").get("commands") == "1", what="the early command"
    )
    client.until(
        lambda: "dlo/observed" in waiting.status("early/simulator").message, what="what is missing"
    )
    assert node.interrupt(times=1, number=signal.SIGTERM) == 0 and "Traceback" not in node.said


@pytest.mark.slow
def test_simulated_time_that_does_not_begin_is_told(waiting):
    """All else is there, and nothing is predicted: the status says what for."""
    client, space = waiting.client, "/timeless"
    words = (*waiting.arguments, "-r", f"__ns:={space}", "-p", "use_sim_time:=true")
    node = waiting.start("simulator", *words)

    def publisher(message, topic: str):
        made = client.node.create_publisher(type(message), f"{space}/{topic}", LATCHED)
        made.publish(message)
        return made

    spline = to_ros(spline_message(BAG_MESSAGES, START, "board", straight()))
    commands = publisher(to_ros(command_message(BAG_MESSAGES, swing(START))), topics.COMMAND)
    shapes = publisher(spline, topics.OBSERVED)
    client.until(shapes.get_subscription_count, what="the simulator")
    client.wait_for_ready(f"{space[1:]}/simulator")
    shapes.publish(spline)

    def said() -> str:
        return getattr(waiting.status(f"{space[1:]}/simulator"), "message", "")

    client.until(lambda: said() == "waiting for /clock (use_sim_time is set)", what=said())
    assert node.interrupt() == 0
    for each in (commands, shapes):
        client.node.destroy_publisher(each)


@pytest.mark.slow
def test_a_shape_seen_before_the_command_may_have_its_ends_swapped(waiting):
    """The observer cannot know which end is the start; the simulation must not begin there."""
    client, space = waiting.client, "/swapped"
    node = waiting.start("simulator", *waiting.arguments, "-r", f"__ns:={space}")
    spline = message_class(topics.TYPES[topics.OBSERVED])
    observed = client.node.create_publisher(spline, f"{space}/{topics.OBSERVED}", LATCHED)
    predicted: list = []
    client.node.create_subscription(spline, f"{space}/{topics.PREDICTED}", predicted.append, 10)
    client.until(observed.get_subscription_count, what="the simulator")
    now = client.node.get_clock().now().nanoseconds
    observed.publish(to_ros(spline_message(BAG_MESSAGES, now, "board", straight()[::-1])))
    client.until(
        lambda: "dlo/command" in getattr(waiting.status("swapped/simulator"), "message", ""),
        what="waiting for a command",
    )
    message = to_ros(command_message(BAG_MESSAGES, swing(0)))
    commands = client.node.create_publisher(type(message), f"{space}/dlo/command", LATCHED)
    commands.publish(message)
    client.until(lambda: predicted, what="the prediction")
    ends = [predicted[0].poses[k].position for k in (0, -1)]
    assert abs(ends[0].x) < 1e-9 and abs(ends[0].z) < 1e-9
    assert ends[1].z < -0.2
    assert node.interrupt() == 0


@pytest.mark.slow
def test_the_first_images_wait_for_a_command_that_is_on_its_way(waiting, tmp_path):
    """It says which end is the start, here the right one; an announced robot may stay silent."""
    scene, xz = Scene(), bow()[::-1]
    vision_settings(scene).dump(tmp_path / "params.yaml")
    camera = scene.camera()
    matrix = tuple(float(v) for v in camera.matrix.ravel())
    info = CameraInfo(camera.width, camera.height, "plumb_bob", tuple(camera.distortion), matrix)
    client = waiting.client
    picture = cv2.imencode(".jpg", render(xz, scene))[1].tobytes()
    words = ("--ros-args", "--params-file", str(tmp_path / "params.yaml"))

    def first_end(space: str, command: Command | None) -> float:
        """x of the start that the observer names in one image."""
        node = waiting.start("observer", *words, "-r", f"__ns:={space}")
        found: list = []

        def publisher(topic: str, qos=10):
            kind = message_class(topics.TYPES[topic])
            made = client.node.create_publisher(kind, f"{space}/{topic}", qos)
            client.until(made.get_subscription_count, what=topic)
            return made

        kind = message_class(topics.TYPES[topics.OBSERVED])
        client.node.create_subscription(kind, f"{space}/{topics.OBSERVED}", found.append, 10)
        commands = publisher(topics.COMMAND, LATCHED)
        infos, images = publisher(topics.CAMERA_INFO), publisher(topics.COMPRESSED)
        client.wait_for_ready(f"{space[1:]}/observer")
        for _ in range(5):
            infos.publish(to_ros(camera_info_message(BAG_MESSAGES, 1, info)))
            client.spin(0.1)
        image = compressed_message(BAG_MESSAGES, START, "camera", picture)
        images.publish(to_ros(image))
        client.spin(0.1)
        if command is not None:
            assert not found
            commands.publish(to_ros(command_message(BAG_MESSAGES, command)))
        client.until(lambda: found, what="observed")
        assert node.interrupt() == 0
        return float(found[0].poses[0].position.x)

    assert first_end("/told", clamps(xz).commands[0]) == pytest.approx(xz[0, 0], abs=2e-3)
    assert first_end("/silent", None) == pytest.approx(xz[-1, 0], abs=2e-3)


@pytest.fixture(scope="module")
def photograph(tmp_path_factory: pytest.TempPathFactory, shared_data: Path):
    """Nodes for the photographed black wire."""
    folder = shared_data / "hanging_loop" / "black"
    settings = Settings.load(folder / "params.yaml")
    logs = tmp_path_factory.mktemp("photograph")
    with System(logs, settings, "-p", "use_sim_time:=true") as system:
        system.ready()
        yield system, folder / "photo0"


@pytest.mark.slow
def test_nodes_run_on_the_photograph(photograph):
    """12 Mpx images and the command of a real bag: observed, simulated, compared, drawn."""
    system, bag = photograph
    client = system.client
    names = (topics.OBSERVED, topics.OBSERVED_POINTS, topics.PREDICTED, topics.ERR)
    heard = {name: client.hear(name, 50) for name in (*names, topics.MARKERS)}
    overlays = client.hear(topics.OVERLAY, 5)
    player = system.start("play", str(bag))
    client.until(lambda: not player.alive, 120.0, "end of playback")
    try:
        client.until(lambda: len(heard[topics.ERR]) >= 2, 20.0, "ERR")
    except AssertionError as err:
        counts = {name: len(messages) for name, messages in heard.items()}
        states = {name: system.values(name) for name in NODES}
        said = [process.said for process in system.started]
        raise AssertionError(f"{err}; heard {counts}; {states}; {said}") from None
    client.until(lambda: overlays, what="overlay")
    system.all_alive()

    def stamps(topic: str) -> set[int]:
        return {stamp_of(m) for m in heard[topic]}

    client.until(
        lambda: stamps(topics.OBSERVED) == stamps(topics.OBSERVED_POINTS), what="points and splines"
    )
    assert all(0.0 < m.data < 0.3 for m in heard[topics.ERR])
    # 1.5 m of wire in the board's plane, from the right clamp at the origin to the left one.
    points = np.array([[p.position.x, p.position.z] for p in heard[topics.OBSERVED][0].poses])
    assert np.allclose(points[0], 0.0, atol=2e-3)
    assert np.allclose(points[-1], [-0.1255, 0.0026], atol=2e-3)
    assert {m.ns for a in heard[topics.MARKERS] for m in a.markers} >= {"observed", "predicted"}
    picture = read_image(overlays[-1])
    (image, *_rest) = [image for _, image, _ in iterate_images(bag)]
    changed = np.mean(np.any(picture != image, axis=-1))
    assert 1e-4 < changed < 0.05


@pytest.mark.slow
def test_the_observer_takes_whichever_transport_a_remapped_camera_publishes(waiting):
    client, camera = waiting.client, "/camera/image_raw"
    remapped = ["image_raw", "image_raw/compressed"]
    words = [w for t in remapped for w in ("-r", f"{t}:=/camera/{t}")]
    node = waiting.start("observer", *waiting.arguments, "-r", "__ns:=/remapped", *words)

    def transport() -> str | None:
        return waiting.values("remapped/observer").get("image transport")

    raw = client.node.create_publisher(message_class(topics.TYPES[topics.IMAGE]), camera, 10)
    client.until(lambda: transport() == "raw" and raw.get_subscription_count(), what="raw")
    client.wait_for_ready("remapped/observer")  # images before that are only counted
    kind = message_class(topics.TYPES[topics.COMPRESSED])
    compressed = client.node.create_publisher(kind, f"{camera}/compressed", 10)
    client.until(
        lambda: transport() == "compressed" and compressed.get_subscription_count(),
        what="compressed images preferred",
    )
    compressed.publish(to_ros(samples.compressed()))
    client.until(
        lambda: waiting.values("remapped/observer").get("images") == "1", what="an image received"
    )
    assert node.interrupt() == 0
