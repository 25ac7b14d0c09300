# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parts of the nodes that can be tested without processes."""

from __future__ import annotations

import time
from array import array
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
import recordings_samples as samples

from dlo_ros.errors import InputError, VisionError
from dlo_ros.nodes.pairing import GAP, WAITING, Pairing
from dlo_ros.recordings import BAG_MESSAGES

MS = 1_000_000


def shape(t: float) -> np.ndarray:
    """A smooth motion, at t seconds."""
    s = np.linspace(0.0, 1.0, 8)[:, None]
    return np.hstack([s, 0.0 * s, 0.1 * np.sin(6.0 * t + s), 0.2 * t + s])


def at(ms: float) -> np.ndarray:
    return shape(1e-3 * ms)


def test_pairs_are_found_in_either_order_and_interpolated_well():
    pairing = Pairing()
    pairing.observed(50 * MS, at(50))
    assert pairing.pairs() == []
    for t in range(0, 201, 20):
        pairing.predicted(t * MS, at(t))
    pairing.observed(133 * MS, at(133))
    pairing.observed(140 * MS, at(140))
    found = pairing.pairs()
    assert [stamp for stamp, _, _ in found] == [50 * MS, 133 * MS, 140 * MS]
    for stamp, observed, predicted in found:
        # Linear interpolation would be wrong by up to 1.8e-4 here.
        np.testing.assert_allclose(predicted, observed, atol=2e-6, err_msg=str(stamp))
    assert pairing.pairs() == [] and pairing.missed == 0


def test_what_can_have_no_prediction_any_more_is_counted():
    pairing = Pairing()
    gap = round(GAP * 1e9) + 1
    for t in (100 * MS, 120 * MS, 120 * MS + gap):
        pairing.predicted(t, at(t / MS))
    pairing.observed(50 * MS, at(50))  # before the simulation started
    pairing.observed(125 * MS, at(125))  # in the gap
    pairing.observed(110 * MS, at(110))
    assert [s for s, _, _ in pairing.pairs()] == [110 * MS]
    assert pairing.missed == 2
    for i in range(WAITING + 5):
        pairing.observed((10_000 + i) * MS, at(0))
    assert pairing.missed == 7
    pairing.clear()
    pairing.predicted(20_000 * MS, at(0))
    assert pairing.pairs() == [] and pairing.missed == 7


def test_old_predictions_are_forgotten_and_new_ones_replace():
    pairing = Pairing()
    for t in range(0, 60_000, 20):
        pairing.predicted(t * MS, at(t))
    pairing.predicted(50_000 * MS, at(0))
    pairing.observed(50_000 * MS, at(50_000))
    pairing.observed(10_000 * MS, at(10_000))
    ((_, _, predicted),) = pairing.pairs()
    np.testing.assert_array_equal(predicted, at(0))
    assert pairing.missed == 1


def test_messages_of_rclpy_are_built_and_read_by_the_same_code():
    pytest.importorskip("rclpy")
    from dlo_ros.nodes.message_factory import ROS_MESSAGES as ros
    from dlo_ros.recordings import (
        camera_info_message,
        command_message,
        compressed_message,
        image_message,
        points_message,
        read_camera_info,
        read_command,
        read_image,
        read_points,
        read_spline,
        spline_message,
    )

    s = samples.SETTINGS
    for factory in (ros, BAG_MESSAGES):
        spline = spline_message(factory, 5, "board", samples.control_points())
        np.testing.assert_allclose(read_spline(spline, s), samples.control_points(), atol=1e-12)
        command = read_command(command_message(factory, samples.command()), s, 5)
        np.testing.assert_allclose(command.positions, samples.command().positions)
        np.testing.assert_allclose(command.velocities, samples.command().velocities)
        points = read_points(points_message(factory, 5, "board", samples.centreline()), s)
        np.testing.assert_allclose(points.u, samples.centreline().u, atol=1e-7)
        image = image_message(factory, 5, "c", samples.picture())
        np.testing.assert_array_equal(read_image(image), samples.picture())
        jpeg = compressed_message(factory, 5, "c", samples.jpeg())
        assert read_image(jpeg).shape == samples.picture().shape
        assert read_camera_info(camera_info_message(factory, 5, samples.INFO)) == samples.INFO


def test_images_are_handed_over_as_a_block():
    """Bytes are given as an array: a sequence of any other kind is looked at number by number."""
    pytest.importorskip("rclpy")
    from dlo_ros.nodes.message_factory import ROS_MESSAGES
    from dlo_ros.recordings import image_message

    picture = np.zeros((1080, 1920, 3), np.uint8)
    data = array("B", picture.tobytes())

    def seconds(work):
        began = time.thread_time()
        work()
        return time.thread_time() - began

    def fastest(work):
        return min(seconds(work) for _ in range(3))

    one_by_one = seconds(lambda: array("B", list(data)))
    message = image_message(ROS_MESSAGES, 5, "c", picture)
    assert isinstance(message.data, array) and message.data == data
    taken = fastest(lambda: image_message(ROS_MESSAGES, 5, "c", picture))
    assert taken < 0.2 * one_by_one


def test_descriptors_come_from_the_table():
    pytest.importorskip("rclpy")
    from dlo_ros.nodes.declared_parameters import descriptor
    from dlo_ros.parameter_table import TABLE

    for parameter in TABLE.values():
        shown = descriptor(parameter)
        assert shown.description.startswith(parameter.description)
        assert shown.read_only == parameter.read_only
        if parameter.kind == "double":
            assert shown.floating_point_range[0].from_value == parameter.lower
        if parameter.kind == "integer":
            assert shown.integer_range[0].to_value == parameter.upper


def test_a_recording_that_starts_again_does_not_spoil_what_it_has_told():
    pytest.importorskip("rclpy")
    from dlo_ros.nodes.simulator_link import EASED, CertaintyThreshold

    threshold, unknown = CertaintyThreshold(), float("inf")
    assert (
        threshold.passes(unknown)
        and threshold.passes(0.2)
        and threshold.passes(0.01)
        and threshold.passes(0.02)
    )
    threshold.begin_again()
    for std in (unknown, float("nan"), 0.3, 0.021 * EASED):
        assert not threshold.passes(std) and threshold.held
    assert threshold.passes(0.02 * EASED) and not threshold.held
    assert threshold.passes(0.1)  # of the same pass
    # What never is that certain is taken in the end, since it may be another DLO's.
    threshold.begin_again()
    assert not threshold.passes(0.3)
    threshold.begin_again()
    assert threshold.passes(0.3)


def test_a_storm_of_commands_is_thinned_out_and_what_held_is_kept():
    from dlo_ros.command import Motion

    motion, millisecond = Motion(), 1_000_000
    for k in range(5000):  # ten in a millisecond, then one in ten
        motion.add(replace(samples.command(), stamp=k * millisecond // 10))
    assert 500 <= len(motion.commands) <= 1002
    for k in range(0, 5000, 7):
        stamp = k * millisecond // 10
        assert 0 <= stamp - motion.at(stamp).stamp <= millisecond
    assert motion.at(-1) is motion.commands[0]
    motion = Motion()
    for k in range(100):
        motion.add(replace(samples.command(), stamp=10 * k * millisecond))
    assert len(motion.commands) == 100
    motion.add(replace(samples.command(), stamp=55 * millisecond))
    assert [c.stamp // millisecond for c in motion.commands] == [0, 10, 20, 30, 40, 50, 55]


def test_an_estimator_that_is_too_slow_keeps_a_sample_of_all_that_was_seen(monkeypatch):
    from dlo_ros.nodes.estimator_thread import COMMANDS, WAITING, EstimatorThread
    from dlo_ros.observation import Observation

    monkeypatch.setattr(EstimatorThread, "_run", lambda self: None)  # infinitely slow
    thread = EstimatorThread(samples.SETTINGS, lambda: None)
    thread.command(samples.command())
    count = 3 * WAITING
    for k in range(count):
        thread.observe(Observation(k, samples.control_points()))
    kept = [t.stamp for t in thread._tasks if isinstance(t, Observation)]
    assert len(kept) <= WAITING and thread.dropped == count - len(kept)
    assert kept[0] == 0 and kept[-1] == count - 1 and kept == sorted(kept)
    assert max(np.diff(kept)) <= 16
    for k in range(COMMANDS + 5):
        thread.command(replace(samples.command(), stamp=k))
    commands = [t for t in thread._tasks if not isinstance(t, Observation)][1:]
    assert len(commands) == COMMANDS and commands[-1].stamp == COMMANDS + 4


def busy_for(seconds):
    """Takes processor time."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


class Lagging:
    """An online estimator whose first spline leaves work over that takes as long as ten."""

    suspicion = None

    def __init__(self, settings):
        self.left, self.run, self.seen, self.worked = 0, None, [], []
        self.estimate = SimpleNamespace(significant=False)
        Lagging.made = self

    @property
    def busy(self):
        return self.left > 0

    def observe(self, observation):
        busy_for(0.002)
        if not self.seen:
            self.left = 10
        self.seen.append(observation.stamp)

    def proceed(self):
        busy_for(0.002)
        self.left -= 1
        self.worked.append(len(self.seen))


@pytest.mark.parametrize("waiting", [60, 1])
def test_splines_that_wait_leave_time_for_the_work_that_makes_an_estimate_right(
    monkeypatch, waiting
):
    """Beside another program splines come faster than they are worked off, all of the time."""
    from dlo_ros.nodes import estimator_thread
    from dlo_ros.observation import Observation

    monkeypatch.setattr(estimator_thread, "OnlineEstimator", Lagging)
    thread = estimator_thread.EstimatorThread(samples.SETTINGS, lambda: None)
    for k in range(waiting):
        thread.observe(Observation(k, samples.control_points()))
    thread.start()
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        if thread.waiting == 0 and len(Lagging.made.worked) == 10:
            break
        time.sleep(0.01)
    thread.stop()
    assert Lagging.made.seen == list(range(waiting))
    # As much time for the one as for the other.
    assert Lagging.made.worked[-1] <= min(12, waiting)


def test_an_estimate_holds_while_the_estimator_is_paused(monkeypatch):
    """Splines that wait, and the outcome of a step under way, are for later."""
    from dlo_ros.nodes import estimator_thread
    from dlo_ros.observation import Observation

    monkeypatch.setattr(estimator_thread, "OnlineEstimator", Lagging)
    thread = estimator_thread.EstimatorThread(samples.SETTINGS, lambda: None)
    for k in range(20):
        thread.observe(Observation(k, samples.control_points()))
    thread.start()
    thread.pause(True)
    time.sleep(0.1)
    waiting = thread.waiting
    assert waiting > 0 and thread.take() == []
    time.sleep(0.1)
    assert thread.waiting == waiting and thread.take() == []
    thread.pause(False)
    deadline = time.monotonic() + 60.0
    outcomes = []
    while len(outcomes) < 20 and time.monotonic() < deadline:
        outcomes += [o for o in thread.take() if not o.later]
        time.sleep(0.01)
    thread.stop()
    assert [o.stamp for o in outcomes] == list(range(20))


def test_the_observer_says_how_many_control_points_would_do():
    pytest.importorskip("rclpy")
    from dlo_ros.nodes.observer import ObserverNode
    from dlo_ros.observation import CentrelinePoints
    from dlo_ros.spline import SplineBasis

    values: dict[str, str] = {}
    node = SimpleNamespace(settings=samples.SETTINGS, health=SimpleNamespace(values=values))
    length, n = samples.SETTINGS.rod.length, samples.SETTINGS.rod.control_points
    u = np.linspace(0.0, length, 120)
    for waves, few in ((6.0, True), (0.5, False)):
        z = 0.01 * np.sin(2.0 * np.pi * waves * u / length)
        points = CentrelinePoints(np.column_stack([u, 0.0 * u, z]), u, np.full(120, 1e-5))
        spline = SplineBasis(n, length).fit(u, points.positions)
        ObserverNode._judge(node, points, spline)
        assert (f"{n} miss it by " in values["control points"]) == few
        assert ("would do" in values["control points"]) == few


def test_the_observer_gives_the_prediction_of_the_image_to_the_search():
    pytest.importorskip("rclpy")
    from dlo_ros.nodes.message_factory import ROS_MESSAGES
    from dlo_ros.nodes.observer import ObserverNode
    from dlo_ros.recordings.image_building import image_message
    from dlo_ros.recordings.message_building import spline_message
    from dlo_ros.vision.predictions import Predictions

    search = MagicMock()
    search.observe.side_effect = VisionError("none")
    node = MagicMock(settings=samples.SETTINGS, _observer=search, _last_stamp=0)
    node._predictions, node.is_earlier = Predictions(), lambda stamp: False
    n = samples.SETTINGS.rod.control_points
    shape = np.column_stack([np.linspace(0.0, 0.3, n), np.zeros((n, 3))])

    def predict(stamp, points, spoil=lambda message: None):
        message = spline_message(ROS_MESSAGES, stamp, samples.SETTINGS.frame_id, points)
        spoil(message)
        ObserverNode._on_predicted(node, message)

    def spoil_number(message):
        message.poses[1].position.z = float("nan")

    def spoil_frame(message):
        message.header.frame_id = "map"

    picture = image_message(ROS_MESSAGES, 1000 * MS, "camera", np.zeros((8, 8, 3), np.uint8))
    ObserverNode._see(node, picture)
    assert search.observe.call_args.args[2] is None
    predict(990 * MS, shape)
    predict(1010 * MS, shape + np.array([0.02, 0.0, 0.0, 0.0]))
    for spoil, words in ((spoil_number, "not finite"), (spoil_frame, "frame_id")):
        with pytest.raises(InputError, match=words):
            predict(1000 * MS, shape, spoil)
    with pytest.raises(InputError, match=f"{n - 1} poses"):
        predict(1000 * MS, shape[1:])
    ObserverNode._see(node, picture)
    np.testing.assert_allclose(
        search.observe.call_args.args[2], shape + np.array([0.01, 0.0, 0.0, 0.0])
    )
    later = image_message(ROS_MESSAGES, 2000 * MS, "camera", np.zeros((8, 8, 3), np.uint8))
    ObserverNode._see(node, later)
    assert search.observe.call_args.args[2] is None


def test_stamps_that_are_none_or_of_another_clock_are_refused():
    pytest.importorskip("rclpy")
    from dlo_ros.nodes.node_base import DloNode

    node = SimpleNamespace(now=lambda: 100 * 10**9)
    DloNode.check_stamp(node, 100 * 10**9, "image")
    with pytest.raises(InputError, match=r"image has no stamp \(header.stamp is zero\)"):
        DloNode.check_stamp(node, 0, "image")
    DloNode.check_stamp(SimpleNamespace(now=lambda: 10**9), 0, "image")  # simulated time
    with pytest.raises(InputError, match=r"image is stamped 60\.0 s ahead of the clock"):
        DloNode.check_stamp(node, 160 * 10**9, "image")
