# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The player: schedule without ROS, then real playback to a real subscriber."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import recordings_samples as samples
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from dlo_ros.errors import RecordingError
from dlo_ros.recordings import BAG_MESSAGES, float_message, image_message, topics
from dlo_ros.recordings.bag import open_bag
from dlo_ros.recordings.message_building import transform_message
from dlo_ros.recordings.playback import plan
from dlo_ros.recordings.write import BagWriter

pytestmark = pytest.mark.live

MS = 1_000_000
COMPRESSED = (CompressionMode.STORAGE, CompressionFormat.ZSTD)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("play") / "bag"
    return samples.write_plain(path, samples.messages())


def test_schedule_at_a_rate(bag):
    playlist = plan(bag, rate=0.5)
    assert playlist.start == samples.START - samples.STEP
    due = list(playlist.messages())
    assert len(due) == len(samples.messages())
    for item, (topic, _, stamp) in zip(due, samples.messages(), strict=True):
        assert item.message.topic == topic
        assert item.after == pytest.approx((stamp - playlist.start) / 1e9 / 0.5)
        assert abs(playlist.time_at(item.after) - stamp) <= 1
    assert playlist.duration == pytest.approx(due[-1].after)


def test_a_command_from_before_the_offset_still_holds(bag):
    playlist = plan(bag, start_offset=0.05)
    due = list(playlist.messages())
    assert (due[0].message.topic, due[0].after) == ("/dlo/command", 0.0)
    assert due[0].message.stamp < playlist.start
    rest = [item.message.stamp for item in due[1:]]
    assert rest == [t for _, _, t in samples.messages() if t >= playlist.start]


def test_all_fixed_transforms_from_before_the_offset_still_hold(tmp_path):
    """Each publisher of /tf_static sends its own frames; a later message replaces no other's."""
    at = [samples.START + k * samples.STEP for k in range(4)]
    pose = ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0))
    with BagWriter(tmp_path / "bag") as writer:
        for stamp, frame in zip(at, ("camera", "arm"), strict=False):
            message = transform_message(BAG_MESSAGES, stamp, "board", frame, *pose)
            writer.write(topics.TRANSFORMS, message, stamp)
        spline = samples.messages()[2]
        writer.write(spline[0], spline[1], at[3])
    playlist = plan(tmp_path / "bag", start_offset=2.5 * samples.STEP / 1e9)
    assert playlist.latched == {topics.TRANSFORMS}
    due = [(item.message.topic, item.message.stamp, item.after) for item in playlist.messages()]
    assert due[:2] == [(topics.TRANSFORMS, at[0], 0.0), (topics.TRANSFORMS, at[1], 0.0)]
    assert len(due) == 3
    with open_bag(tmp_path / "bag") as bag:  # `ros2 bag play` offers what is noted here
        noted = {c.topic: c.ext.offered_qos_profiles[0] for c in bag.connections}
    assert noted[topics.TRANSFORMS].durability.name == "TRANSIENT_LOCAL"
    assert noted[topics.TRANSFORMS].depth > 1


def test_selection_and_types_that_are_not_installed(bag, tmp_path):
    assert [t for t, _ in plan(bag, selection=["dlo/observed", "/image_raw"]).topics] == [
        "/dlo/observed",
        "/image_raw",
    ]
    kind = "sensor_msgs/msg/Image"
    playlist = plan(bag, playable=lambda k: k != kind)
    assert "/image_raw" not in dict(playlist.topics) and len(playlist.topics) == 4
    with pytest.raises(RecordingError, match="not installed"):
        plan(bag, selection=["image_raw"], playable=lambda k: k != kind)
    with pytest.raises(RecordingError, match="nothing that can be played"):
        plan(bag, playable=lambda k: False)
    assert all(name.startswith("/dlo/") for name, _ in plan(bag, images=False).topics)


def test_what_tells_the_state_of_now_is_not_played(tmp_path):
    names = ("/clock", "/left/clock", "/observer/ready", "/left/simulator/ready")
    recorded = [(name, float_message(BAG_MESSAGES, 1.0), 5) for name in names]
    path = samples.write_plain(tmp_path / "bag", [*recorded, *samples.messages()])
    expected = {topic for topic, _, _ in samples.messages()}
    assert set(dict(plan(path).topics)) == expected


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"rate": 0.0}, "--rate is 0"),
        ({"rate": -1.0}, "--rate is -1"),
        ({"rate": float("nan")}, "--rate is nan"),
        ({"start_offset": 9.0}, "bag is 0.080 s long"),
        ({"start_offset": -1.0}, "--start-offset is -1"),
        ({"selection": ["nothing"]}, "no topic nothing; it has /camera_info"),
    ],
)
def test_unusable_arguments(bag, arguments, reason):
    with pytest.raises(RecordingError) as caught:
        plan(bag, **arguments)
    assert reason in str(caught.value)


# --- live -----------------------------------------------------------------------------------

pytest.importorskip("rclpy")


@pytest.fixture(scope="module")
def client():
    from live_graph import Client

    client = Client()
    yield client
    client.close()


FRAMES = 12


@pytest.fixture(scope="module")
def players(client, tmp_path_factory):
    """Three players, started together since each waits for its subscribers; and what they sent."""
    from live_graph import Process
    from rclpy.qos import qos_profile_sensor_data

    from dlo_ros.nodes.message_factory import message_class
    from dlo_ros.nodes.qos import CLOCK, LATCHED

    folder = tmp_path_factory.mktemp("players")
    ordered = samples.write_plain(folder / "ordered", samples.messages())
    again = [(f"/again{t}", m, at) for t, m, at in samples.messages(images=False)]
    looped = samples.write_plain(folder / "looped", again)
    picture, large = np.zeros((1080, 1920, 3), np.uint8), []
    for i in range(FRAMES):
        stamp = samples.START + i * 33 * MS
        picture[:] = i
        large.append(("/large/image_raw", image_message(BAG_MESSAGES, stamp, "c", picture), stamp))
    images = samples.write_plain(folder / "large", large, compression=COMPRESSED)
    heard = {
        # The command asks for what is latched, images are best effort, splines reliable.
        "dlo/command": client.hear("dlo/command", LATCHED),
        "image_raw": client.hear("image_raw", qos_profile_sensor_data),
        "dlo/observed": client.hear("dlo/observed"),
        "dlo/observed_points": client.hear("dlo/observed_points"),
        "camera_info": client.hear("camera_info", qos_profile_sensor_data),
        "clock": client.hear("/clock", CLOCK, "rosgraph_msgs/msg/Clock"),
        "again": client.hear("/again/dlo/observed", kind="geometry_msgs/msg/PoseArray"),
        "large": [],
    }
    # The first and the last byte of each: whole messages, without keeping them.
    client.node.create_subscription(
        message_class("sensor_msgs/msg/Image"),
        "/large/image_raw",
        lambda m: heard["large"].append(m.data[0] if m.data[0] == m.data[-1] else -1),
        qos_profile_sensor_data,
    )
    # `--topics T ... BAG` as the interface writes it.
    names = ["dlo/command", "image_raw", "dlo/observed", "dlo/observed_points", "camera_info"]
    processes = {
        "ordered": Process(folder, "play", "--rate", "0.25", "--topics", *names, str(ordered)),
        "looped": Process(folder, "play", str(looped), "--loop", "--no-clock"),
        "large": Process(folder, "play", str(images), "--no-clock"),
    }
    once = (processes["ordered"], processes["large"])
    client.until(lambda: not any(p.alive for p in once), 40.0, "end of playback")
    client.until(lambda: len(heard["again"]) > 12, 20.0, "third pass")
    yield heard, processes
    for process in processes.values():
        process.process.kill()


def test_playback_in_order_with_clock_to_every_kind_of_subscriber(players):
    heard, processes = players
    said = processes["ordered"].said
    assert processes["ordered"].wait() == 0 and "Traceback" not in said, said
    counts = {name: len(heard[name]) for name in heard if "/" in name or "_" in name}
    assert counts == {
        "dlo/command": 1,
        "image_raw": 4,
        "dlo/observed": 4,
        "dlo/observed_points": 2,
        "camera_info": 4,
    }
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in heard["dlo/observed"]]
    assert stamps == [samples.START + i * samples.STEP for i in range(4)]
    assert bytes(heard["image_raw"][2].data) == samples.picture(2).tobytes()
    times = [m.clock.sec * 10**9 + m.clock.nanosec for m in heard["clock"]]
    start, end = samples.START - samples.STEP, samples.START + 3 * samples.STEP
    assert times == sorted(times) and times[0] == start
    # It runs on a little after the last message, so that this is worked off.
    assert end + 150 * MS < times[-1] < end + 300 * MS
    # At a quarter of the speed the clock advances by a quarter of the wall time.
    steps = [b - a for a, b in pairwise(times) if b > a]
    assert np.median(steps) < 10 * MS and len(steps) > 25


def test_large_images_reach_best_effort_subscribers(players):
    """Fast DDS loses most of them with its default shared memory; the player brings its own."""
    heard, processes = players
    said = processes["large"].said
    assert processes["large"].wait() == 0 and "XMLPARSER" not in said, said
    seen = heard["large"]
    assert seen == sorted(seen) and -1 not in seen and len(seen) >= FRAMES - 2, seen


def test_loop_plays_again_until_ctrl_c(players):
    heard, processes = players
    assert processes["looped"].interrupt(times=2) == 0
    assert "Traceback" not in processes["looped"].said
    stamps = [m.header.stamp.nanosec for m in heard["again"][:12]]
    assert stamps == stamps[:4] * 3


class Listening:
    """A node that listens to splines and says on `~/ready` and /diagnostics how far it is."""

    def __init__(self, client, name: str, namespace: str = "/") -> None:
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
        from geometry_msgs.msg import PoseArray
        from rclpy.node import Node
        from std_msgs.msg import Bool

        from dlo_ros.nodes.qos import LATCHED

        self.node = Node(name, namespace=namespace, context=client.context)
        client.executor.add_node(self.node)
        self.ready, self.heard = False, []
        self.node.create_subscription(
            PoseArray, "dlo/observed", lambda _: self.heard.append(self.ready), 10
        )
        self._ready = self.node.create_publisher(Bool, "~/ready", LATCHED)
        self._ready.publish(Bool(data=False))
        status = DiagnosticStatus(
            name=f"{self.node.get_fully_qualified_name().lstrip('/')}: prediction",
            message="compiling, 40 %",
        )
        diagnostics = self.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.node.create_timer(0.1, lambda: diagnostics.publish(DiagnosticArray(status=[status])))

    def become_ready(self) -> None:
        self.ready = True
        self._ready.publish(self._ready.msg_type(data=True))


@pytest.fixture
def alone():
    """A client in a graph in which nobody else is."""
    from live_graph import Client

    from dlo_ros.demo.network import free_domain

    domain = free_domain()
    client = Client(domain)
    yield client, domain
    client.close()


@pytest.fixture
def splines(tmp_path):
    return str(samples.write_plain(tmp_path / "splines", samples.messages(images=False)))


def test_nobody_listens(alone, splines, tmp_path):
    from live_graph import Process

    process = Process(tmp_path, "play", splines, "--wait", "1.5", domain=alone[1])
    assert process.wait() == 2
    *_, last = process.said.splitlines()
    topics = "/dlo/command, /dlo/observed, /dlo/observed_points"
    assert last.startswith(f"dlo_ros play: nobody listens to {topics}; start the nodes"), last
    assert "waiting for a node (nobody listens yet)" in process.said
    # Who does not want to wait does not.
    process = Process(tmp_path, "play", splines, "--wait", "0", domain=alone[1])
    assert process.wait() == 0 and f"nobody listens to {topics} yet" in process.said


def test_more_time_is_advised_only_where_it_helps():
    pytest.importorskip("rclpy")
    from dlo_ros.nodes.player import APPEAR, no_subscriber_message

    assert "--wait SECONDS" in no_subscriber_message(["/dlo/command"], 0.5 * APPEAR)
    assert "--wait" not in no_subscriber_message(["/dlo/command"], 600.0)


@pytest.mark.slow
def test_a_second_clock_in_the_graph_is_told_of(alone, splines, tmp_path):
    from live_graph import Process
    from rosgraph_msgs.msg import Clock

    client, domain = alone
    client.hear("dlo/command")
    for name in ("/clock", "/left/clock"):
        client.node.create_publisher(Clock, name, 10)
    words = ("play", splines, "--wait", "20", "--ros-args", "-r")
    both = {
        c: Process(tmp_path, *words, f"/clock:={c}", domain=domain) for c in ("/clock", "/mine")
    }
    client.until(lambda: not any(p.alive for p in both.values()), 60.0, "the players' ends")
    said = {name: process.said for name, process in both.items()}
    assert "another process publishes /clock, too" in said["/clock"], said
    assert "another process" not in said["/mine"] and both["/mine"].wait() == 0, said


@pytest.mark.slow
def test_a_node_that_never_is_ready(alone, splines, tmp_path):
    from live_graph import Process

    client, domain = alone
    rope = Listening(client, "rope", "/left")
    words = ("play", splines, "--wait", "4", "--ros-args", "-r", "__ns:=/left")
    words += tuple(w for t in ("command", "observed") for w in ("-r", f"/dlo/{t}:=dlo/{t}"))
    process = Process(tmp_path, *words, domain=domain)
    client.until(lambda: not process.alive, 20.0, "the player's end")
    assert process.wait() == 2 and not rope.heard
    *_, last = process.said.splitlines()
    assert last == (
        "dlo_ros play: waited 4 s in vain for left/rope (compiling, 40 %); "
        "--wait SECONDS gives more time"
    )
    assert "waiting for left/rope (compiling, 40 %)" in process.said
    client.executor.remove_node(rope.node)
    rope.node.destroy_node()


@pytest.mark.slow
def test_the_player_waits_until_the_nodes_are_ready(alone, splines, tmp_path):
    """Also for one by name that is not there yet, and not for others that merely listen."""
    from live_graph import Process

    client, domain = alone
    client.hear("dlo/observed")
    rope = Listening(client, "rope")
    process = Process(tmp_path, "play", splines, "--wait-for", "late", domain=domain)
    client.until(lambda: "rope (compiling, 40 %)" in process.said, 15.0, "word of the rope")
    client.until(lambda: "late (not there yet)" in process.said, 5.0, "word of the late one")
    rope.become_ready()
    late = Listening(client, "late")
    client.until(lambda: "late (compiling, 40 %)" in process.said, 15.0, "word of the late one")
    assert not rope.heard
    late.become_ready()
    client.until(lambda: not process.alive, 20.0, "the player's end")
    assert process.wait() == 0, process.said
    assert rope.heard == late.heard == [True] * 4
    for listening in (rope, late):
        client.executor.remove_node(listening.node)
        listening.node.destroy_node()


@pytest.mark.parametrize("wait", ["-1", "nan", "1e9"])
def test_unusable_patience(splines, tmp_path, wait):
    from live_graph import Process

    process = Process(tmp_path, "play", splines, "--wait", wait)
    assert process.wait() == 2
    assert "--wait is" in process.said and "give seconds from 0 to 86400" in process.said


@pytest.mark.slow
def test_damaged_bag_ends_with_status_2(tmp_path):
    from live_graph import Process

    path = samples.write_plain(tmp_path / "bag", samples.messages())
    (stored,) = path.glob("*.mcap")
    stored.write_bytes(stored.read_bytes()[:2000])
    process = Process(tmp_path, "play", str(path))
    assert process.wait() == 2
    assert "damaged or cut short" in process.said and "Traceback" not in process.said
    process = Process(tmp_path, "play", str(tmp_path / "none"))
    assert process.wait() == 2 and "no such bag" in process.said
