# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Faults while the live nodes run: the estimate recovers, the simulator stays stable and in time.

`make faults` runs them.
"""

from __future__ import annotations

import multiprocessing
import re
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy")

import fault_rig
from fault_rig import EVERY, GUESS, NANOSECONDS, N, Rig, Sent, shapes
from fuzz_graph import SETTINGS, Good
from live_graph import Client, Process, to_ros
from rclpy.qos import QoSProfile, ReliabilityPolicy

from dlo_ros.command import Command
from dlo_ros.demo.network import free_domain
from dlo_ros.nodes.message_factory import message_class
from dlo_ros.recordings import BAG_MESSAGES, command_message, spline_message, topics

pytestmark = [pytest.mark.live, pytest.mark.slow]

SECONDS = 4.0
IN_TIME = 0.5
"""Seconds of simulated time that the last prediction may lie behind the clock."""


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory):
    made = Rig(tmp_path_factory.mktemp("faults"))
    yield made
    made.close()


@pytest.fixture(scope="module")
def measured():
    return shapes(SECONDS)


def finite(rig: Rig) -> None:
    """Nothing that was predicted is infinite or flies away: the DLO is 0.4 m long."""
    for message in rig.predicted:
        points = [(p.position.x, p.position.y, p.position.z) for p in message.poses]
        assert np.all(np.isfinite(points)) and np.abs(points).max() < 1.0


def check(rig: Rig, seconds: float = SECONDS) -> None:
    """The estimate is right, predictions are sound and in time."""
    off = rig.recovered()
    finite(rig)
    print(f"{off:.2f} standard deviations off, {len(rig.predicted)} predictions", end=" ")
    rig.client.until(
        lambda: rig.lag(seconds) < IN_TIME or any("behind" in m for m in rig.told("simulator")),
        10.0, f"predictions {rig.lag(seconds):.2f} s behind; {rig.told('simulator')}",
    )  # fmt: skip


@pytest.mark.parametrize("fault", ["untouched", "lost", "doubled", "delayed", "shuffled"])
def test_messages_on_their_way(rig, measured, fault):
    """30 % lost; each twice; half a second late; out of order."""
    rig.fresh()
    rig.drive(SECONDS, getattr(fault_rig, fault), measured=measured)
    check(rig)


def test_clock_jumps_both_ways(rig, measured):
    """Four seconds ahead for a moment, then back; later half a second back."""
    rig.fresh()

    def off(now: float) -> float:
        return 4.0 if 1.0 < now < 1.2 else -0.7 if 1.8 < now < 1.9 else 0.0

    rig.drive(SECONDS, during=off, measured=measured)
    finite(rig)
    # How much of a motion is left that tells of the DLO when half of it is dropped, is chance.
    rig.drive(SECONDS, measured=measured)
    check(rig)


def test_shapes_that_overtake_their_command(rig, measured):
    """The simulator has started under the command of the motion before: it starts again."""
    errors = rig.client.hear(topics.ERR, 1000)
    for overtaken in (0.0, 0.2):  # after the former there is a motion before
        rig.fresh()
        rig.with_the_truth()
        errors.clear()
        rig.drive(2.4, measured=measured, overtaken=overtaken)
        rig.client.spin(0.5)
        found = [e.data for e in errors]
        assert len(found) > 20 and np.median(found) < 3.0 * fault_rig.NOISE, found


def test_a_looping_recording(rig, measured):
    """Time starts again and again, as `play --loop` has it."""
    rig.fresh()
    for _ in range(2):
        rig.drive(1.5, measured=measured)
    rig.drive(SECONDS, measured=measured)
    check(rig)


def test_splines_of_the_pass_before_are_dropped(rig, measured):
    """The last ones of each pass come when the clock has gone back, as from a busy observer."""
    seconds, passes, tardy = 2.4, 3, 8
    shown = [(t, shape) for t, shape in measured if t < seconds]
    errors = rig.client.hear(topics.ERR, 1000)
    rig.fresh()
    rig.with_the_truth()  # so that ERR is the same in all passes
    errors.clear()
    said = {name: len(process.said) for name, process in rig.nodes.items()}
    late = [Sent(0.1 + 0.03 * k, t, shape) for k, (t, shape) in enumerate(shown[-tardy:])]

    def first(messages):
        return messages[:-tardy]

    def again(messages):
        return [*messages[:-tardy], *late]

    counts, means = [], []
    for fault in (first, *[again] * (passes - 1)):
        rig.drive(seconds, fault, measured=shown)
        rig.client.spin(0.5)
        counts.append(len(errors))
        means.append(float(np.mean([e.data for e in errors])))
        errors.clear()
    assert min(counts) >= len(shown) - tardy - 3 and max(counts) <= len(shown) - tardy, counts
    assert max(means) < 2.0 * fault_rig.NOISE and means[1:] == pytest.approx(means[:1] * 2, rel=0.1)
    # All of them at the identifier; of the simulator's queue some are lost while it starts.
    for name, least in (("identifier", tardy * (passes - 1)), ("simulator", 1)):
        rig.client.until(
            lambda name=name, least=least: (
                int(rig.values(name).get("messages of the pass before dropped", 0)) >= least
            ),
            what=f"messages that the {name} drops",
        )
    for name, process in rig.nodes.items():
        assert "[WARN]" not in process.said[said[name] :], process.said[said[name] :]
    starts = re.findall("simulation starts at ([0-9.]+) s", rig.nodes["simulator"].said)[-passes:]
    assert {float(start) - rig.base / NANOSECONDS for start in starts} == {0.0}, starts


def held(stamp: int) -> Command:
    """The start held as it is at the beginning of the swing."""
    return Command(
        stamp, ("start",), np.zeros(1), np.zeros((1, 1, 3)), np.array([[[0.0, 0.0, 0.0, 1.0]]]),
        np.full((1, 1, 3), np.nan), N,
    )  # fmt: skip


def test_a_storm_of_commands(rig, measured):
    """A second of ten thousand commands a second, then the motion: nothing is left of the storm."""
    rig.fresh()
    kind = message_class(topics.TYPES[topics.COMMAND])
    stormy = rig.client.node.create_publisher(kind, topics.COMMAND, 10)
    rig.client.until(lambda: stormy.get_subscription_count() >= 2, what="subscribers of the storm")
    before = rig.base - NANOSECONDS
    sent, began = 0, time.monotonic()
    message = to_ros(command_message(BAG_MESSAGES, held(before)))
    while time.monotonic() < began + 1.0:
        due = int(10_000 * (time.monotonic() - began))
        for _ in range(max(due - sent, 0)):
            nanoseconds = before % NANOSECONDS + sent * 100_000
            message.header.stamp.sec = before // NANOSECONDS + nanoseconds // NANOSECONDS
            message.header.stamp.nanosec = nanoseconds % NANOSECONDS
            stormy.publish(message)
            sent += 1
    rate = sent / (time.monotonic() - began)
    rig.client.node.destroy_publisher(stormy)
    print(f"{rate:.0f} commands a second", end=" ")
    rig.drive(SECONDS, measured=measured)
    check(rig)


def test_a_robot_that_sends_poses_one_by_one(rig, measured):
    """A thousand a second while it moves: each replaces the one before."""
    rig.fresh()
    kind = message_class(topics.TYPES[topics.COMMAND])
    poses = rig.client.node.create_publisher(kind, topics.COMMAND, 10)
    rig.client.until(lambda: poses.get_subscription_count() >= 2, what="subscribers of the poses")
    whole, waiting = fault_rig.swing(0, SECONDS), []
    for k in range(round(1000 * SECONDS)):  # beforehand: this process must keep up, too
        stamp = k * NANOSECONDS // 1000
        position, rotation = whole.sample(stamp)
        one = replace(held(rig.base + stamp), positions=position[None], rotations=rotation[None])
        waiting.append((stamp / NANOSECONDS, fault_rig.as_bytes(one)))

    def pose(now: float) -> None:
        while waiting and waiting[0][0] < now:
            poses.publish(waiting.pop(0)[1])

    rig.drive(SECONDS, during=pose, measured=measured)
    rig.client.node.destroy_publisher(poses)
    check(rig)


def test_a_slow_subscriber(rig, measured):
    """Who asks for every prediction reliably and takes none does not hold the simulator up."""
    rig.fresh()
    slow = Client(rig.domain)
    try:
        everything = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        kind = message_class(topics.TYPES[topics.PREDICTED])
        slow.node.create_subscription(kind, topics.PREDICTED, lambda _: None, everything)
        rig.drive(SECONDS, measured=measured)
        check(rig)
    finally:
        slow.close()


def busy() -> None:
    while True:
        pass


def test_other_processes_take_the_processors(rig, measured):
    """Twice as many as there are: the simulator keeps up or says by how much it lags."""
    rig.fresh()
    count = 2 * multiprocessing.cpu_count()
    hogs = [multiprocessing.get_context("spawn").Process(target=busy) for _ in range(count)]
    for hog in hogs:
        hog.start()
    try:
        rig.drive(SECONDS, measured=measured)
    finally:
        for hog in hogs:
            hog.kill()
            hog.join()
    check(rig)


@pytest.mark.parametrize("name", ["simulator", "identifier"])
def test_a_node_is_killed_and_started_again(rig, measured, name):
    """With kill -9 after a motion; what it needs to go on comes by itself."""

    def told() -> bool:
        """Whether the simulator has the identifier's estimate, which is not the guess."""
        modulus, density = rig.client.get("/simulator", "rod.young_modulus", "rod.density")
        return bool(abs(modulus / density / rig.estimate()[0] - 1.0) < 0.02)

    rig.fresh()
    if name == "simulator":
        rig.drive(SECONDS, measured=measured)
        rig.recovered(180.0)
        rig.client.until(told, 60.0, "the estimate in the simulator")
    rig.nodes[name].process.kill()
    rig.nodes[name].process.wait()
    rig.start(name)
    rig.ready()
    rig.client.until(
        lambda: (
            rig.commands.get_subscription_count() >= 2
            and rig.splines.get_subscription_count() >= 2
            and rig.clock.get_subscription_count() >= 2
        ),
        60.0,
        "the node that was started again",
    )
    if name == "simulator":  # the identifier tells it what it knows, without new splines
        rig.client.until(told, 60.0, "the estimate in the new simulator")
    rig.base += 100 * NANOSECONDS
    rig.predicted.clear()
    rig.drive(SECONDS, measured=measured)
    check(rig)


def test_an_observer_is_killed_and_started_again_while_images_come(tmp_path):
    """And its camera pauses: what it publishes afterwards is what it published before."""
    good, domain = Good(), free_domain()
    SETTINGS.dump(tmp_path / "params.yaml")
    words = ("observer", "--ros-args", "--params-file", str(tmp_path / "params.yaml"))
    process, client = Process(tmp_path, *words, domain=domain), Client(domain)
    try:
        observed = client.hear(topics.OBSERVED, 50)
        infos = client.publisher(topics.CAMERA_INFO)
        images = client.publisher(topics.IMAGE)

        def show(seconds: float) -> None:
            deadline = time.monotonic() + seconds
            while time.monotonic() < deadline:
                stamp = client.node.get_clock().now().nanoseconds
                infos.publish(good.camera_info(stamp))
                images.publish(good.image(stamp))
                client.spin(0.1)

        def found() -> np.ndarray:
            observed.clear()
            client.until(lambda: show(0.2) or len(observed) > 3, 60.0, process.said)
            poses = [(p.position.x, p.position.z) for p in observed[-1].poses]
            return np.array(poses)

        before = found()
        client.spin(10.0)  # the camera is silent
        np.testing.assert_allclose(found(), before, atol=1e-3)
        process.process.kill()
        process.wait()
        process = Process(tmp_path, *words, domain=domain)
        np.testing.assert_allclose(found(), before, atol=1e-3)
    finally:
        client.close()
        assert process.interrupt(times=2) == 0, process.said


def test_the_guess_is_far_enough_off_to_be_told_from_the_truth(measured):
    """Else all of the above would hold for a node that does nothing."""
    assert abs(fault_rig.TRUTH / GUESS.rod.young_modulus - 1.0) > 0.5
    assert len(measured) == round(SECONDS / EVERY)
    message = spline_message(BAG_MESSAGES, 0, "board", measured[-1][1])
    assert len(message.poses) == N
