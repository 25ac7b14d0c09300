# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The three nodes as real processes on a recording: the loop, estimates, pause and reset."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from live_system import (
    EVERY,
    GUESS,
    NODES,
    SHAPES,
    START,
    TRUE_MODULUS,
    N,
    System,
    stamp_of,
    straight,
    swing,
)
from std_srvs.srv import SetBool, Trigger

from dlo_ros.command import Motion
from dlo_ros.nodes.qos import LATCHED
from dlo_ros.observation import Observation
from dlo_ros.parameters import tolerance
from dlo_ros.recordings import (
    BAG_MESSAGES,
    BagWriter,
    command_message,
    spline_message,
    topics,
)
from dlo_ros.rod.simulation import Simulation

pytestmark = pytest.mark.live


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
        player = system.start("play", str(bag), "--rate", "0.5")
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


def test_diagnostics_tell_that_the_clocks_are_one(playing):
    def delay():
        values = playing.values("identifier")
        return [values[f"command delay {what}[s]"] for what in ("", "std ")]

    playing.client.until(lambda: "unknown" not in delay(), 120.0, "the delay")
    value, std = map(float, delay())
    assert abs(value) < 3.0 * std
    assert std < tolerance(GUESS, "command_delay.delay")  # the pictures tell more than is known


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

    def pause(paused: bool, said: str, state: str) -> None:
        answer = client.call(SetBool, "/identifier/pause", SetBool.Request(data=paused))
        assert answer.success and answer.message == said
        client.until(
            lambda: playing.status("identifier").message.startswith(state), 10.0, f"{state!r}"
        )

    pause(True, "paused", "no observed splines")  # more than that they have ended for long
    pause(False, "running", "no observed splines")
    for name in NODES:
        assert client.call(Trigger, f"/{name}/reset", Trigger.Request()).success
    # A forgotten estimate is no longer told, and a pause hides no missing topic.
    missing = "waiting for dlo/observed"
    pause(True, "paused", f"{missing}; paused")
    pause(False, "running", missing)
    values = playing.values("identifier")
    assert not {"young_modulus [Pa]", "specific_modulus identifiable", "ERR [mm]"} & set(values)
    # Each node tells its own once a second.
    client.until(lambda: "tension [N]" not in playing.values("simulator"), 10.0, "no tension")
