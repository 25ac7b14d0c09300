# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes as processes: described, checked, refused, those of effects too."""

from __future__ import annotations

import math
import time
from array import array
from dataclasses import replace

import numpy as np
import pytest
import recordings_samples as samples
import yaml

pytest.importorskip("rclpy")

from live_graph import Client, Process, to_ros
from live_system import GUESS, NODES, straight, swing
from ordinary import some_of
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data

from dlo_ros.demo.network import free_domain
from dlo_ros.nodes.message_factory import installed
from dlo_ros.recordings import (
    BAG_MESSAGES,
    command_message,
    spline_message,
    topics,
)

pytestmark = pytest.mark.live


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
        ({"rod__young_modulus": 1e3}, "would hang"),  # as a DLO that its own weight tears
        ({"rod__density": 1900.0, "effects__point_mass__mass": 0.1}, "effects.point_mass.mass; an"),
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


def test_a_camera_in_the_plane_of_the_board_is_refused_where_it_is_set(waiting):
    """Once the intrinsics are known; nothing else that is set meanwhile is refused for it."""
    client = waiting.client
    infos = client.publisher(topics.CAMERA_INFO, qos_profile_sensor_data)
    info = to_ros(samples.camera_info_message(BAG_MESSAGES, samples.START, samples.INFO))

    def refused():
        infos.publish(info)
        return not client.set("/observer", camera__translation=[0.0, 0.0, 0.0]).successful

    client.until(refused, what="a refusal")
    answer = client.set("/observer", camera__translation=[0.1, 0.0, 0.0])
    assert not answer.successful and "camera.translation" in answer.reason, answer
    assert client.set("/observer", camera__translation=[0.1, 0.0, 1.2]).successful
    assert client.get("/observer", "camera.translation")[0].tolist() == [0.1, 0.0, 1.2]


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
