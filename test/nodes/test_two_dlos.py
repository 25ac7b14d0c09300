# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Six live nodes: two DLOs in two namespaces, as two launches start them; and what each node is."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import recordings_samples as samples
from fake_launch import ROOT, evaluate

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticStatus
from live_graph import Client, Process
from policies import read_policy
from rcl_interfaces.srv import DescribeParameters, ListParameters

from dlo_ros.command import Command, Motion
from dlo_ros.demo.network import free_domain
from dlo_ros.nodes.declared_parameters import parameter_type
from dlo_ros.nodes.message_factory import installed
from dlo_ros.nodes.qos import LATCHED
from dlo_ros.observation import Observation
from dlo_ros.parameter_table import PARAMETERS
from dlo_ros.parameters import Settings
from dlo_ros.recordings import BAG_MESSAGES, BagWriter, command_message, spline_message, topics
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

pytestmark = [pytest.mark.live, pytest.mark.slow]

NODES = ("observer", "simulator", "identifier")
SIDES = {"left": 1.0e7, "right": 3.0e7}
"""Young's modulus [Pa] of the two DLOs; both are guessed to have 5e6."""
GUESS = Settings.from_mapping(
    {
        "rod.length": 0.4,
        "rod.diameter": 0.004,
        "rod.young_modulus": 5.0e6,
        "rod.density": 2000.0,
        "simulation.tolerance": 0.001,
    }
)
START, EVERY, SHAPES = samples.START, 40_000_000, 50


def recorded(folder: Path) -> Path:
    """One recording of both DLOs, each waved at its start."""
    times = np.linspace(0.0, 2.0, 41)
    angle = 0.5 * np.sin(2 * math.pi * times)
    rotations = np.zeros((41, 1, 4))
    rotations[:, 0, 1], rotations[:, 0, 3] = np.sin(angle / 2), np.cos(angle / 2)
    n = GUESS.rod.control_points
    nothing = np.full((41, 1, 3), np.nan)
    command = Command(START, ("start",), times, np.zeros((41, 1, 3)), rotations, nothing, n)
    straight = np.zeros((n, 4))
    straight[:, 0] = SplineBasis(n, GUESS.rod.length).greville
    simulations = {}
    for side, modulus in SIDES.items():
        simulation = Simulation(GUESS.with_material(modulus, 2000.0), Motion([command]))
        simulation.start([Observation(START, straight)])
        simulations[side] = simulation
    rng = np.random.default_rng(2)
    with BagWriter(folder / "both") as writer:
        for side in SIDES:
            message = command_message(BAG_MESSAGES, command)
            writer.write(f"/{side}/{topics.COMMAND}", message, START - 10_000_000)
        for i in range(SHAPES):
            stamp = START + i * EVERY
            for side, simulation in simulations.items():
                shape = simulation.advance(stamp).control_points.copy()
                shape[1:, [0, 2]] += rng.normal(0.0, 2e-4, (n - 1, 2))
                message = spline_message(BAG_MESSAGES, stamp, "board", shape)
                writer.write(f"/{side}/{topics.OBSERVED}", message, stamp)
    return folder / "both"


@dataclass
class Two:
    """The six processes and a client."""

    client: Client
    processes: dict[str, Process]

    def status(self, node: str) -> DiagnosticStatus | None:
        heard = self.client.hear("/diagnostics", kind="diagnostic_msgs/msg/DiagnosticArray")
        found = [s for m in heard for s in m.status if s.name.startswith(f"{node}: ")]
        return found[-1] if found else None


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("two")
    bag = recorded(folder)
    GUESS.dump(folder / "params.yaml")
    domain, processes = free_domain(), {}
    for side in SIDES:
        launched = evaluate(
            ROOT / "launch" / "dlo.launch.py",
            params_file=str(folder / "params.yaml"),
            namespace=side,
            use_sim_time="true",
        )
        for process in launched.processes:
            words = (process.executable, *process.words)
            processes[f"{side}/{process.executable}"] = Process(folder, *words, domain=domain)
    running = Two(Client(domain), processes)
    client = running.client
    player = None
    try:
        client.wait_for_ready(*processes)
        client.until(lambda: all(map(running.status, processes)), 10.0, "all six")
        for side in SIDES:
            for topic in (topics.YOUNG_MODULUS, topics.DENSITY):
                client.hear(f"/{side}/{topic}", LATCHED, topics.TYPES[topic])
        player = Process(folder, "play", str(bag), domain=domain)
        client.until(lambda: not player.alive, 40.0, "end of the recording")
        assert player.wait() == 0, player.said
        yield running
    finally:
        client.close()
        ends = {name: process.interrupt() for name, process in processes.items()}
        if player is not None and player.alive:
            player.process.kill()
    said = "".join(process.said for process in processes.values())
    assert set(ends.values()) == {0} and "Traceback" not in said, said


def test_each_identifier_finds_its_own_dlo_and_keeps_its_own_simulator_in_step(two):
    client = two.client
    for side, modulus in SIDES.items():
        specific = modulus / GUESS.rod.density

        def in_step(side=side, specific=specific) -> bool:
            young, density = client.get(f"/{side}/simulator", "rod.young_modulus", "rod.density")
            return young / density == pytest.approx(specific, rel=0.1)

        client.until(in_step, 20.0, f"the simulator of {side}")
        young, density = (
            client.hear(f"/{side}/{topic}")[-1].data
            for topic in (topics.YOUNG_MODULUS, topics.DENSITY)
        )
        assert young / density == pytest.approx(specific, rel=0.1)


def test_nothing_of_a_dlo_lies_outside_its_namespace(two):
    names = {name for name, _ in two.client.node.get_topic_names_and_types()}
    assert not [name for name in names if name.startswith("/dlo/")]
    assert {f"/{side}/{topics.PREDICTED}" for side in SIDES} < names


def test_diagnostics_say_whose_they_are_and_that_nothing_comes_any_more(two):
    def stale(node: str) -> bool:
        return two.status(node).level == DiagnosticStatus.STALE

    working = [f"{side}/{node}" for side in SIDES for node in ("simulator", "identifier")]
    two.client.until(lambda: all(map(stale, working)), 15.0, "stale")
    for side in SIDES:
        simulator, identifier = (two.status(f"{side}/{n}") for n in ("simulator", "identifier"))
        assert simulator.name == f"{side}/simulator: prediction"
        assert simulator.hardware_id == identifier.hardware_id == side
        assert simulator.message.startswith("no predictions for ")
        assert identifier.message.startswith("no observed splines for ")
        observer = two.status(f"{side}/observer")
        assert observer.level == DiagnosticStatus.WARN
        assert observer.message == "waiting for image_raw and camera_info, or dlo/points"
        values = {v.key: v.value for v in simulator.values}
        assert float(values["computing time [ms]"]) < 1000.0 and "predictions [Hz]" in values
        assert "latency [ms]" in {v.key for v in identifier.values}


@pytest.mark.parametrize("node", NODES)
def test_a_node_needs_all_that_its_policy_allows_and_nothing_else(two, node):
    policy, graph = read_policy(node, "/left"), two.client.node
    assert policy.node == node and policy.enclave == f"/dlo/{node}"

    def names(query) -> set[str]:
        return {name for name, _ in query(node, "/left")}

    kinds = {f"/left/{topics.METRICS}": topics.TYPES[topics.METRICS]}
    kinds[topics.TRANSFORMS] = topics.TRANSFORMS_TYPE
    missing = {name for name, kind in kinds.items() if not installed(kind)}
    assert names(graph.get_publisher_names_and_types_by_node) == policy.publish - missing
    # Of the two transports of images one at a time is subscribed.
    other = {"/left/image_raw/compressed"} if node == "observer" else set()
    # Where points or commands come in other frames.
    on_demand = {"/tf", "/tf_static", "/left/dlo/start_pose", "/left/dlo/end_pose"}
    other |= on_demand & policy.subscribe
    assert names(graph.get_subscriber_names_and_types_by_node) == policy.subscribe - other
    assert other <= policy.subscribe
    assert names(graph.get_service_names_and_types_by_node) == policy.reply
    assert names(graph.get_client_names_and_types_by_node) == policy.request
    enclaves = {
        n: e for n, ns, e in graph.get_node_names_and_namespaces_with_enclaves() if ns == "/left"
    }
    assert enclaves[node] == policy.enclave


@pytest.mark.parametrize("node", NODES)
def test_a_node_declares_what_the_table_says_and_nothing_else(two, node):
    client, full = two.client, f"/right/{node}"
    mine = {p.name: p for p in PARAMETERS if node in p.nodes}
    listed = client.call(ListParameters, f"{full}/list_parameters", ListParameters.Request())
    rclpys_own = ("use_sim_time", "qos_overrides.", "start_type_description_service")
    assert {n for n in listed.result.names if not n.startswith(rclpys_own)} == set(mine)
    request = DescribeParameters.Request(names=list(mine))
    described = client.call(DescribeParameters, f"{full}/describe_parameters", request).descriptors
    for shown, parameter in zip(described, mine.values(), strict=True):
        assert shown.type == parameter_type(parameter) and shown.read_only == parameter.read_only
        unit = f" [{parameter.unit}]" if parameter.unit else ""
        assert shown.description == parameter.description + unit
        ranged = shown.floating_point_range or shown.integer_range or shown.additional_constraints
        assert ranged or parameter.kind in ("string", "bool"), parameter.name


@pytest.mark.parametrize("node", NODES)
def test_every_parameter_can_be_set_live_or_says_that_it_cannot(two, node):
    client, full = two.client, f"/right/{node}"
    for parameter in (p for p in PARAMETERS if node in p.nodes):
        key = parameter.name.replace(".", "__")
        (value,) = client.get(full, parameter.name)
        value = value if isinstance(value, (str, int, float)) else list(value)
        answer = client.set(full, **{key: value})
        assert answer.successful != parameter.read_only, (parameter.name, answer.reason)
        assert answer.successful or "read-only" in answer.reason
        if parameter.read_only:
            continue
        for wrong in ([], [math.nan] * max(parameter.size, 1), parameter.upper * 2 + 1, True):
            answer = client.set(full, **{key: wrong})
            assert not answer.successful and parameter.name in answer.reason, (wrong, answer)
    assert two.processes[f"right/{node}"].alive


def test_a_node_takes_another_name_and_other_topics(two, tmp_path):
    """Any executable takes --ros-args; the identifier follows a simulator of another name."""
    client = two.client
    GUESS.dump(tmp_path / "params.yaml")
    common = ("--ros-args", "--params-file", str(tmp_path / "params.yaml"))
    domain = int(client.context.get_domain_id())
    own = Process(
        tmp_path, "identifier", *common, "-r", "__node:=judge", "-r", "__ns:=/lab",
        "-r", "dlo/observed:=/camera/shape", "-p", "simulator_node:=/right/simulator",
        "-p", "use_sim_time:=true", domain=domain,
    )  # fmt: skip
    try:
        client.until(lambda: two.status("lab/judge"), 60.0, "the renamed node")
        graph = client.node
        heard = {n for n, _ in graph.get_subscriber_names_and_types_by_node("judge", "/lab")}
        assert "/camera/shape" in heard and "/lab/dlo/observed" not in heard and "/clock" in heard
        asked = {n for n, _ in graph.get_client_names_and_types_by_node("judge", "/lab")}
        assert asked == {"/right/simulator/set_parameters_atomically"}
    finally:
        time.sleep(0.1)
        assert own.interrupt() == 0, own.said


def test_a_recording_plays_into_a_namespace_and_beside_what_is_made_anew(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        for k in range(3):
            stamp = START + k * EVERY
            shape = spline_message(BAG_MESSAGES, stamp, "board", np.zeros((10, 4)))
            writer.write(topics.OBSERVED, shape, stamp)
            writer.write(topics.PREDICTED, shape, stamp)
            writer.write(topics.COMMAND, command_message(BAG_MESSAGES, samples.command()), stamp)
    launched = evaluate(
        ROOT / "launch" / "dlo.launch.py", bag=str(tmp_path / "bag"), namespace="third", wait="0"
    )
    (player,) = (p for p in launched.processes if p.executable == "play")
    domain = free_domain()
    client = Client(domain)
    commands = client.hear(f"/third/{topics.COMMAND}", 10, topics.TYPES[topics.COMMAND])
    process = Process(tmp_path, "play", "--loop", *player.words, domain=domain)
    try:
        # Without images the recorded splines are played; predictions are made anew.
        here = {f"/third/{t}" for t in (topics.COMMAND, topics.OBSERVED)}
        expected = {*here, f"/third/recorded/{topics.PREDICTED}"}

        def there() -> set[str]:
            return {n for n, _ in client.node.get_topic_names_and_types() if "dlo/" in n}

        client.until(lambda: there() == expected or not process.alive, 90.0, "the topics")
        assert there() == expected, (there(), process.said)
        client.until(lambda: commands, 60.0, "a command in the namespace")
        clocks = {n for n, _ in client.node.get_topic_names_and_types() if n.endswith("clock")}
        assert clocks == {"/third/clock"}
    finally:
        client.close()
        process.interrupt()
