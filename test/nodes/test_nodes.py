# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The three nodes as real processes: the loop, services, parameters, hostile input, the end."""

from __future__ import annotations

import math
import signal
import time
from array import array
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import recordings_samples as samples
import yaml

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticStatus
from live_graph import Client, Process, to_ros
from ordinary import some_of
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data
from std_srvs.srv import SetBool, Trigger
from vision_scenes import Scene, bow, clamps, render
from vision_scenes import settings as vision_settings

from dlo_ros.command import Command, Motion
from dlo_ros.demo.network import free_domain
from dlo_ros.nodes.message_factory import installed, message_class
from dlo_ros.nodes.qos import LATCHED
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import (
    BAG_MESSAGES,
    BagWriter,
    CameraInfo,
    camera_info_message,
    command_message,
    compressed_message,
    iterate_images,
    read_image,
    spline_message,
    topics,
)
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

pytestmark = pytest.mark.live

N = 10
START = samples.START
TRUE_MODULUS = 1.0e7
GUESS = Settings.from_mapping(
    {
        "rod.length": 0.4,
        "rod.diameter": 0.004,
        "rod.young_modulus": 4.0e6,
        "rod.density": 2000.0,
        "rod.control_points": N,
        "simulation.tolerance": 0.001,
    }
)
SHAPES = 75
EVERY = 40_000_000
NODES = ("observer", "simulator", "identifier")


def swing(stamp: int) -> Command:
    """One end clamped, pointing to the right; turned up and down, then held."""
    times = np.linspace(0.0, 2.0, 41)
    angle = 0.5 * np.sin(2 * math.pi * times) * np.minimum(1.0, 2.0 - times)
    rotations = np.zeros((len(times), 1, 4))
    rotations[:, 0, 1], rotations[:, 0, 3] = np.sin(angle / 2), np.cos(angle / 2)
    return Command(
        stamp=stamp,
        names=("start",),
        times=times,
        positions=np.zeros((len(times), 1, 3)),
        rotations=rotations,
        velocities=np.full((len(times), 1, 3), np.nan),
        control_points=N,
    )


def straight() -> np.ndarray:
    basis = SplineBasis(N, GUESS.rod.length)
    return np.column_stack([basis.greville, np.zeros((N, 3))])


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Splines of a rod with another E than the guess, with noise, and the command."""
    truth = GUESS.with_material(TRUE_MODULUS, GUESS.rod.density)
    command = swing(START)
    simulation = Simulation(truth, Motion([command]))
    simulation.start([Observation(START, straight())])
    rng = np.random.default_rng(1)
    path = tmp_path_factory.mktemp("swing") / "swing"
    with BagWriter(path) as writer:
        writer.write(topics.COMMAND, command_message(BAG_MESSAGES, command), START - 10_000_000)
        for i in range(SHAPES):
            stamp = START + i * EVERY
            shape = simulation.advance(stamp).control_points.copy()
            shape[1:, [0, 2]] += rng.normal(0.0, 2e-4, (N - 1, 2))
            message = spline_message(BAG_MESSAGES, stamp, "board", shape)
            writer.write(topics.OBSERVED, message, stamp + 1_000_000)
    return path


class System:
    """The three nodes, and a client."""

    def __init__(self, folder: Path, settings: Settings, *words: str) -> None:
        params = folder / "params.yaml"
        settings.dump(params)
        self.folder = folder
        self.arguments = ("--ros-args", "--params-file", str(params), *words)
        self.domain = free_domain()
        self.started: list[Process] = []
        self.nodes = {name: self.start(name, *self.arguments) for name in NODES}
        self.client = Client(self.domain)
        self.diagnostics: dict[str, DiagnosticStatus] = {}
        self._statuses = self.client.hear(
            "/diagnostics", kind="diagnostic_msgs/msg/DiagnosticArray"
        )

    def start(self, *words: str) -> Process:
        self.started.append(Process(self.folder, *words, domain=self.domain))
        return self.started[-1]

    def status(self, name: str) -> DiagnosticStatus | None:
        found = [s for m in self._statuses for s in m.status if s.name.startswith(f"{name}:")]
        return found[-1] if found else None

    def values(self, name: str) -> dict[str, str]:
        status = self.status(name)
        return {v.key: v.value for v in status.values} if status else {}

    def ready(self) -> None:
        self.client.wait_for_ready(*NODES)
        self._statuses.clear()  # of what came before
        self.client.until(
            lambda: all(self.status(name) for name in NODES), 10.0, "diagnostics of all nodes"
        )

    def all_alive(self) -> None:
        for name, process in self.nodes.items():
            assert process.alive, f"{name} died: {process.said}"

    def __enter__(self) -> System:
        return self

    def __exit__(self, *error: object) -> None:
        self.client.close()
        try:
            ends = {name: p.interrupt(times=2) for name, p in self.nodes.items()}
        finally:
            for process in self.started:
                process.process.kill()
        for name, process in self.nodes.items():
            assert ends[name] == 0 and "Traceback" not in process.said, f"{name}: {process.said}"


@pytest.fixture(scope="module")
def playing(tmp_path_factory: pytest.TempPathFactory, bag: Path):
    """Nodes on simulated time that have just seen the recording."""
    folder = tmp_path_factory.mktemp("playing")
    with System(folder, GUESS, "-p", "use_sim_time:=true") as system:
        system.ready()
        client = system.client
        for topic in (topics.PREDICTED, topics.ERR, topics.YOUNG_MODULUS, topics.DENSITY):
            # Deep: on a busy machine this process may not be running for a second.
            client.hear(topic, LATCHED if topic in topics.LATCHED else 1000)
        # Slowly, so that a busy machine has its estimate before the end.
        player = system.start("play", str(bag), "--rate", "0.25")
        client.until(lambda: not player.alive, 120.0, "end of playback")
        assert player.wait() == 0, player.said
        err = client.hear(topics.ERR)
        client.until(lambda: len(err) >= SHAPES, 120.0, "ERR of all splines")
        client.until(
            lambda: system.values("identifier").get("estimates") == str(SHAPES),
            120.0,
            "all estimates",
        )
        system.all_alive()
        yield system


@pytest.fixture(scope="module")
def waiting(tmp_path_factory: pytest.TempPathFactory):
    """Nodes on wall time that nothing was sent to yet."""
    with System(tmp_path_factory.mktemp("waiting"), GUESS) as system:
        system.ready()
        yield system


def stamp_of(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def test_the_loop_closes(playing):
    """The identifier finds E from the splines and moves the simulator, whose ERR falls."""
    client = playing.client
    predicted = client.hear(topics.PREDICTED)
    stamps = [stamp_of(m) for m in predicted]
    # Instants of a grid from the first observed stamp on, each once; few are left out if any.
    period = 20_000_000
    assert stamps[0] == START
    steps = np.diff(stamps)
    assert np.all(steps > 0) and np.all(steps % period == 0) and np.mean(steps) < 1.5 * period
    assert stamps[-1] >= START + (SHAPES - 1) * EVERY
    err = [m.data for m in client.hear(topics.ERR)]
    assert len(err) == SHAPES
    early, late = np.mean(err[5:15]), np.mean(err[-15:])
    # Where the identifier is quick, the wrong guess is gone before the first of these.
    assert late < max(0.3 * early, 5e-4), (early, late)
    young = client.hear(topics.YOUNG_MODULUS)[-1].data
    density = client.hear(topics.DENSITY)[-1].data
    ratio = young / density
    assert ratio == pytest.approx(TRUE_MODULUS / GUESS.rod.density, rel=0.1)
    simulated = client.get("/simulator", "rod.young_modulus", "rod.density")
    assert simulated[0] / simulated[1] == pytest.approx(ratio, rel=0.05)


def test_estimates_are_latched(playing):
    """Who comes after the fact still gets them."""
    late: list = []
    kind = type(playing.client.hear(topics.DENSITY)[-1])
    playing.client.node.create_subscription(kind, "/dlo/density", late.append, LATCHED)
    playing.client.until(lambda: late, what="latched estimate")
    assert late[0].data == playing.client.hear(topics.DENSITY)[-1].data


def test_diagnostics_say_what_the_data_determine(playing):
    values = playing.values("identifier")
    assert values["compared splines"] == str(SHAPES) and values["observed splines"] == str(SHAPES)
    assert float(values["specific_modulus [m^2/s^2]"]) > 0
    assert float(values["specific_modulus std [m^2/s^2]"]) > 0
    assert values["specific_modulus identifiable"] == "yes"
    assert int(playing.values("simulator")["predictions"]) >= 100


@pytest.mark.slow
def test_a_second_run_of_the_recording_starts_afresh(playing, bag):
    client = playing.client
    predicted, err = client.hear(topics.PREDICTED), client.hear(topics.ERR)
    predicted.clear()
    err.clear()
    player = playing.start("play", str(bag), "--rate", "2")
    client.until(lambda: not player.alive, 120.0, "end of playback")
    last = START + (SHAPES - 1) * EVERY
    client.until(lambda: predicted and stamp_of(predicted[-1]) >= last, 20.0, "the last prediction")
    client.until(lambda: len(err) > 60, 20.0, "ERR")
    playing.all_alive()
    stamps = [stamp_of(m) for m in predicted]
    assert START in stamps, (stamps[:5], playing.nodes["simulator"].said)
    # The simulator kept what was found, so it is right from the start.
    assert np.mean([m.data for m in err[:10]]) < 0.004


@pytest.mark.slow
def test_a_simulator_that_is_started_again_gets_the_estimate_again(playing):
    client = playing.client
    before = client.get("/simulator", "rod.young_modulus", "rod.density")
    assert before[0] != GUESS.rod.young_modulus
    assert playing.nodes["simulator"].interrupt() == 0
    playing.nodes["simulator"] = playing.start("simulator", *playing.arguments)

    def parameters() -> list:
        return client.get("/simulator", "rod.young_modulus", "rod.density")

    client.until(lambda: parameters() == pytest.approx(before, rel=0.02), what="parameters again")


def test_pause_and_reset(playing):
    client = playing.client
    answer = client.call(SetBool, "/identifier/pause", SetBool.Request(data=True))
    assert answer.success and answer.message == "paused"
    answer = client.call(SetBool, "/identifier/pause", SetBool.Request(data=False))
    assert answer.success and answer.message == "running"
    for name in NODES:
        assert client.call(Trigger, f"/{name}/reset", Trigger.Request()).success


def test_parameters_are_described_and_checked_as_a_set(waiting):
    client = waiting.client
    descriptor = client.describe("/simulator", "rod.young_modulus")
    assert "[Pa]" in descriptor.description and not descriptor.read_only
    assert descriptor.floating_point_range[0].from_value == 1e3
    assert client.describe("/observer", "rod.length").read_only
    assert "auto" in client.describe("/observer", "image_transport").additional_constraints
    assert client.set("/simulator", rod__young_modulus=5_000_000).successful  # a whole number
    before = client.get("/simulator", "rod.young_modulus", "rod.density")
    assert before == [5e6, 2000.0] and type(before[0]) is float
    refused = client.set("/simulator", rod__young_modulus=6.0e6, rod__density=-1.0)
    assert not refused.successful and "rod.density" in refused.reason
    assert client.get("/simulator", "rod.young_modulus", "rod.density") == before
    for values, reason in (
        ({"rod__young_modulus": math.nan}, "rod.young_modulus"),
        ({"rod__young_modulus": "stiff"}, "must be a number"),
        ({"gravity": [0.0, 0.0]}, "must have 3"),
        ({"simulation__start": "anyhow"}, "equilibrium | observed | moving"),
        ({"rod__length": 0.5}, "read-only"),
    ):
        refused = client.set("/simulator", **values)
        assert not refused.successful and reason in refused.reason, refused
    assert client.set("/simulator", rod__young_modulus=4.0e6).successful


def test_an_image_file_that_is_none_is_refused_and_nothing_changed(waiting):
    refused = waiting.client.set("/observer", vision__mask="/nofile.png")
    assert not refused.successful
    assert (
        refused.reason == "vision.mask is '/nofile.png'; it must be an image file that can be read"
    )
    assert waiting.client.get("/observer", "vision.mask") == [""]


@pytest.mark.slow
@pytest.mark.parametrize("name", NODES)
def test_a_node_starts_from_the_parameters_that_it_lists(name, waiting, tmp_path):
    """As `ros2 param dump` writes them, with an override of a profile beside them."""
    listed = waiting.client.names(f"/{name}")
    values = dict(zip(listed, waiting.client.get(f"/{name}", *listed), strict=True))
    assert ("rod.density" in values) == (name != "observer")
    plain = {k: list(v) if isinstance(v, array) else v for k, v in values.items()}
    dumped = tmp_path / "dumped.yaml"
    dumped.write_text(yaml.safe_dump({f"/{name}": {"ros__parameters": plain}}))
    override = "qos_overrides./dlo/markers.publisher.durability"
    domain = free_domain()
    words = ("--ros-args", "--params-file", str(dumped), "-p", f"{override}:=transient_local")
    process, client = Process(tmp_path, name, *words, domain=domain), Client(domain)
    try:
        values[override] = "transient_local"
        again = client.names(f"/{name}")
        assert dict(zip(again, client.get(f"/{name}", *again), strict=True)) == values
        topic = topics.ERR if name == "identifier" else topics.PREDICTED
        topic = topics.OBSERVED if name == "observer" else topic
        (marked,) = client.node.get_publishers_info_by_topic(topics.MARKERS)
        (other,) = client.node.get_publishers_info_by_topic(topic)
        optional = {"observer": topics.TRANSFORMS_TYPE, "identifier": topics.TYPES[topics.METRICS]}
        told = name in optional and not installed(optional[name])
        assert process.said.count("is not published, since") == told
        assert marked.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        assert other.qos_profile.durability == DurabilityPolicy.VOLATILE
    finally:
        client.close()
        process.interrupt(times=2)
        process.process.kill()


@pytest.mark.slow
def test_effects_are_parameters_of_the_simulator(tmp_path):
    """Declared as the file gives them, described, changed while it runs, refused when wrong."""
    settings = GUESS.with_material(5.0e7, 2000.0).with_effects(
        {"point_mass": {"mass": 0.001, "position": 0.4},
         "intrinsic_curvature": {"curvature": (1.0, -2.0, 0.5)}}
    )  # fmt: skip
    settings.dump(tmp_path / "params.yaml")
    domain = free_domain()
    words = ("simulator", "--ros-args", "--params-file", str(tmp_path / "params.yaml"))
    process, client = Process(tmp_path, *words, domain=domain), Client(domain)
    try:
        client.wait_for_ready("simulator")
        descriptor = client.describe("/simulator", "effects.point_mass.mass")
        assert descriptor.description == "the mass [kg]"
        assert "from 0 to" in descriptor.additional_constraints
        names = ("effects.point_mass.mass", "effects.intrinsic_curvature.curvature")
        mass, curvature = client.get("/simulator", *names)
        assert mass == 0.001 and list(curvature) == [1.0, -2.0, 0.5]
        predicted = client.hear(topics.PREDICTED, 50)
        commands = client.publisher(topics.COMMAND)
        splines = client.publisher(topics.OBSERVED)
        still = replace(swing(0), rotations=np.tile([0.0, 0.0, 0.0, 1.0], (41, 1, 1)))
        commands.publish(to_ros(command_message(BAG_MESSAGES, still)))
        now = client.node.get_clock().now().nanoseconds
        splines.publish(to_ros(spline_message(BAG_MESSAGES, now, "board", straight())))
        client.until(lambda: len(predicted) > 5, 30.0, "prediction")
        assert client.set("/simulator", effects__point_mass__mass=0.002).successful
        client.spin(0.2)
        before = predicted[-1].poses[-1].position
        curled = {"effects__intrinsic_curvature__curvature": [-15.0, -15.0, -15.0]}
        assert client.set("/simulator", **curled).successful
        client.until(
            lambda: abs(predicted[-1].poses[-1].position.z - before.z) > 0.03, 20.0, "curls up"
        )
        for values, reason in (
            ({"effects__point_mass__mass": -1.0}, "it must be a number from 0 to"),
            ({"effects__point_mass__mass": "heavy"}, "effects.point_mass.mass is heavy"),
            ({"effects__point_mass__position": 0.5}, "it must lie on the DLO, 0 to 0.4 m"),
        ):
            refused = client.set("/simulator", **values)
            assert not refused.successful and reason in refused.reason, refused
        assert client.get("/simulator", "effects.point_mass.mass") == [0.002]
        assert process.alive and "Traceback" not in process.said, process.said
    finally:
        client.close()
        process.interrupt(times=2)
        process.process.kill()


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
    infos.publish(info)
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
    client.until(lambda: "problems: camera_info" in waiting.values("observer"), what="camera_info")
    info = to_ros(samples.camera_info_message(BAG_MESSAGES, START, samples.INFO))
    infos.publish(info)
    client.spin(0.2)
    for _ in range(3):
        images.publish(image)
    client.until(lambda: "problems: image_raw" in waiting.values("observer"), what="lying step")
    image = to_ros(samples.image_message(BAG_MESSAGES, START, "c", samples.picture()))
    images.publish(image)  # nothing to be seen in it
    client.until(lambda: "problems: image" in waiting.values("observer"), what="no DLO")
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


@pytest.mark.slow
def test_an_override_of_no_known_policy_ends_with_status_2(tmp_path):
    override = "qos_overrides./dlo/markers.publisher.durability:=forever"
    complete = ("-p", "rod.length:=0.4", "-p", "rod.diameter:=0.004")
    unknown = Process(tmp_path, "observer", "--ros-args", *complete, "-p", override)
    assert unknown.wait() == 2
    line = unknown.said.splitlines()[-1]
    assert (
        "Traceback" not in unknown.said
        and "dlo_ros observer: qos_overrides./dlo/markers: " in line
        and "forever" in line
    )


@pytest.mark.parametrize("name", some_of(NODES, ["simulator"]))
def test_parameters_that_are_missing_or_unusable_end_with_status_2(tmp_path, name):
    bad = tmp_path / "bad.yaml"
    bad.write_text("/**:\n  ros__parameters:\n    rod: {length: [1, 2\n")
    incomplete = Process(tmp_path, name, "--ros-args", "-p", "rod.length:=0.4")
    broken = Process(tmp_path, name, "--ros-args", "--params-file", str(bad))
    assert incomplete.wait() == 2 and broken.wait() == 2
    assert f"dlo_ros {name}: rod.diameter is missing" in incomplete.said
    (line,) = broken.said.splitlines()
    assert line.startswith(f"dlo_ros {name}: {bad}: is no valid YAML (line 4: ")
    assert "Traceback" not in incomplete.said + broken.said


@pytest.mark.slow
@pytest.mark.parametrize("after", some_of([0.5, 1.1, 1.8], [1.1]))
def test_ctrl_c_ends_quietly_while_a_node_starts(after, tmp_path, monkeypatch):
    """Twice, as `ros2 launch` does; every other test here ends nodes that run in the same way."""
    # `make coverage` would have Python itself load long, where an interrupt is not ours to catch.
    monkeypatch.delenv("COVERAGE_PROCESS_CONFIG", raising=False)
    GUESS.dump(tmp_path / "params.yaml")
    params = str(tmp_path / "params.yaml")
    words = ("--ros-args", "--params-file", params)
    processes = [Process(tmp_path, name, *words) for name in NODES]
    time.sleep(after)
    try:
        for process in processes:
            assert process.interrupt(times=2) == 0, process.said
            assert "Traceback" not in process.said, process.said
    finally:
        for process in processes:
            process.process.kill()
