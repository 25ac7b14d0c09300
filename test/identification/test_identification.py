# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What is identified, how sure it is, and what is said not to be known."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from measured import at_rest, swing
from rods import PAPER, SECOND, command

from dlo_ros.command import Motion
from dlo_ros.errors import InputError
from dlo_ros.identification import Manipulation, OnlineEstimator, identify, shape_error
from dlo_ros.identification.residual_noise import noise_floor
from dlo_ros.inference.err import deviation
from dlo_ros.observation import CentrelinePoints, Observation
from dlo_ros.parameters import DampingParameters
from dlo_ros.rod.boundary.shape_orientation import along
from dlo_ros.spline import SplineBasis

TRUE_RATIO = PAPER.rod.specific_modulus
BASIS = SplineBasis(10, 0.4)


@pytest.fixture(scope="module")
def swinging():
    return swing(PAPER)


@pytest.fixture(scope="module")
def resting():
    return at_rest(PAPER)


def guess(factor, **rod):
    """The paper's rope with a wrong E and a density that is only guessed."""
    wrong = PAPER.with_material(5e7 * factor, 2000.0)
    return replace(wrong, rod=replace(wrong.rod, **rod))


def test_err_is_the_mean_distance_along_the_dlo():
    a = np.zeros((10, 4))
    a[:, 0] = BASIS.greville
    b = a.copy()
    b[:, 2] += 0.003
    b[:, 3] = 1.0  # twist does not count
    assert shape_error(a, b, BASIS) == pytest.approx(0.003, rel=1e-12)
    c = a.copy()
    c[:, 2] = 0.01 * (BASIS.greville / 0.4 - 0.5)  # a straight line that crosses
    assert shape_error(a, c, BASIS) == pytest.approx(0.0025, rel=1e-3)
    apart = deviation(a, c, BASIS)  # evenly spread from 0 to 5 mm, which it is at the ends
    assert apart.mean == shape_error(a, c, BASIS)
    assert apart.std == pytest.approx(0.005 / math.sqrt(12.0), rel=1e-3)
    assert apart.maximum == pytest.approx(0.005, rel=1e-12)


def test_noise_is_found_in_the_frames(swinging):
    # 120 points of 0.3 mm through 10 control points, in two directions
    sigma = 3e-4 * np.sqrt(10 / 120)
    assert noise_floor(swinging.observations, BASIS) == pytest.approx(1.25 * sigma, rel=0.35)


def test_a_motion_that_is_fast_for_the_frame_rate_is_no_noise(swinging):
    rare = replace(swinging, observations=swinging.observations[::3])
    found = identify([rare], guess(2.0))
    own = 1.25 * 3e-4 * np.sqrt(10 / 120)
    assert noise_floor(rare.observations, BASIS) > 10.0 * own  # as far as shapes alone tell
    assert found.noise_floor == pytest.approx(own, rel=0.35)


@pytest.mark.parametrize("factor", [1 / 30, 30.0])
def test_a_motion_gives_the_ratio_from_far_off(swinging, factor):
    found = identify([swinging], guess(factor))
    estimate = found.estimate
    assert found.fitted.converged
    off = estimate.specific_modulus / TRUE_RATIO - 1.0
    assert abs(off) < 0.01
    assert abs(off) * TRUE_RATIO < 4.0 * estimate.specific_modulus_std
    assert estimate.identifiable == {
        "young_modulus": False, "density": False, "specific_modulus": True
    }  # fmt: skip
    assert estimate.young_modulus_std is None
    assert estimate.density_std is None
    assert found.recordings[0].err < 2.0 * found.noise_floor
    assert found.recordings[0].err_initial > 5.0 * found.recordings[0].err


def test_a_shape_at_rest_never_tells_the_density(resting):
    estimate = identify([resting], guess(0.1)).estimate
    assert estimate.specific_modulus == pytest.approx(TRUE_RATIO, rel=0.05)
    assert estimate.identifiable["specific_modulus"]
    assert not estimate.identifiable["density"]
    assert estimate.density_std is None


def test_a_weighing_gives_e_without_making_it_identified(resting):
    known = guess(0.1, density=2500.0, density_std=50.0)
    estimate = identify([resting], known).estimate
    assert estimate.density == pytest.approx(2500.0, rel=0.01)
    assert estimate.density_std == pytest.approx(50.0, rel=0.05)
    assert estimate.young_modulus == pytest.approx(5e7, rel=0.06)
    assert estimate.young_modulus_std > 0.02 * estimate.young_modulus * 0.9
    assert not estimate.identifiable["density"]


def test_the_same_picture_five_times_is_one_measurement():
    once = identify([at_rest(PAPER, frames=2)], guess(0.3)).estimate
    often = identify([at_rest(PAPER, frames=20)], guess(0.3)).estimate
    assert often.specific_modulus_std == pytest.approx(once.specific_modulus_std, rel=0.3)


def test_only_a_known_drag_tells_the_density():
    windy = replace(PAPER, damping=DampingParameters(air_drag=0.15, relaxation_time=0.002))
    recording = swing(windy)
    for std, identified in ((0.005, True), (0.0, False)):
        known = replace(guess(0.2), damping=replace(windy.damping, air_drag_std=std))
        estimate = identify([recording], known).estimate
        assert estimate.identifiable["density"] is identified
        assert estimate.specific_modulus == pytest.approx(TRUE_RATIO, rel=0.02)
        if identified:
            assert abs(estimate.density - 2500.0) < 4.0 * estimate.density_std
            assert estimate.density_std < 0.1 * 2500.0
        else:
            assert estimate.density_std is None


def test_what_cannot_be_identified_from_is_refused(resting):
    with pytest.raises(InputError, match="no recording"):
        identify([], PAPER)
    with pytest.raises(InputError, match="at_rest: has no usable dlo/command"):
        identify([replace(resting, commands=())], PAPER)
    with pytest.raises(InputError, match="no usable dlo/observed"):
        identify([Manipulation("empty", resting.commands, ())], PAPER)


def run_online(estimator, manipulation, observations=None):
    for imposed in manipulation.commands:
        estimator.set_command(imposed)
    for observation in observations or manipulation.observations:
        estimator.observe(observation)
    return estimator.estimate


def at_once(settings):
    """An estimator that does all work as soon as it is due, however long it takes."""
    return OnlineEstimator(settings, budget=np.inf)


class Count:
    """A clock that goes on by a fixed time whenever it is read."""

    def __init__(self, step):
        self.step, self.now = step, 0.0

    def __call__(self):
        self.now += self.step
        return self.now


@pytest.mark.parametrize("factor", [1 / 30, 30.0])
def test_online_work_in_slices_converges_within_two_seconds(swinging, factor):
    # As if every piece of work took 0.7 ms: three or four of them in an update.
    estimator = OnlineEstimator(guess(factor), clock=Count(7e-4))
    for imposed in swinging.commands:
        estimator.set_command(imposed)
    off, busy = [], 0
    for observation in swinging.observations:
        estimator.observe(observation)
        off.append(abs(estimator.estimate.specific_modulus / TRUE_RATIO - 1.0))
        busy += estimator.busy
    assert busy > 20  # work was left over from one update to the next
    assert max(off[-10:]) < 0.02
    assert estimator.estimate.identifiable["specific_modulus"]
    assert not estimator.estimate.identifiable["density"]


def test_online_an_update_is_never_long(swinging):
    """Loosely, since other programs run beside the tests; measured numbers are in the docs."""
    for _ in range(2):  # the first time, compiled code is loaded
        estimator, times = OnlineEstimator(guess(0.1)), []
        for imposed in swinging.commands:
            estimator.set_command(imposed)
        for observation in swinging.observations:
            begin = time.thread_time()
            estimator.observe(observation)
            times.append(time.thread_time() - begin)
    assert np.median(times) < 0.010
    assert np.percentile(times, 95) < 0.020


def test_online_a_command_that_came_late_is_put_right(swinging):
    (imposed,) = swinging.commands
    still = replace(
        imposed, times=imposed.times[:1], positions=imposed.positions[:1],
        rotations=imposed.rotations[:1], velocities=imposed.velocities[:1],
    )  # fmt: skip
    estimator = at_once(guess(0.5))
    estimator.set_command(still)
    for observation in swinging.observations[:20]:
        estimator.observe(observation)
    estimator.set_command(imposed)
    for observation in swinging.observations[20:]:
        estimator.observe(observation)
    assert estimator.estimate.specific_modulus == pytest.approx(TRUE_RATIO, rel=0.02)


@pytest.mark.parametrize("factor", [1 / 30, 30.0])
def test_online_the_ratio_converges_within_the_motion(swinging, factor):
    estimator = at_once(guess(factor))
    within = [o for o in swinging.observations if o.stamp <= 1.5 * SECOND]
    estimate = run_online(estimator, swinging, within)
    assert estimate.specific_modulus == pytest.approx(TRUE_RATIO, rel=0.02)
    assert not estimate.identifiable["density"]


@pytest.mark.slow
def test_a_guessed_damping_of_zero_does_not_bend_the_ratio(swinging, caplog):
    """Undamped, the rope would swing on, and only a wrong E/mu could bring it to rest."""
    undamped = replace(guess(0.3), damping=DampingParameters(air_drag=0.0, relaxation_time=0.0))
    found = identify([swinging], undamped).estimate
    assert abs(found.specific_modulus - TRUE_RATIO) < 4 * found.specific_modulus_std
    assert "damping.relaxation_time is guessed to be 0" in caplog.text
    online = run_online(at_once(undamped), swinging)
    assert online.specific_modulus == pytest.approx(TRUE_RATIO, rel=0.02)


def test_online_tells_once_that_a_change_is_significant(swinging):
    estimator = at_once(guess(0.2))
    for imposed in swinging.commands:
        estimator.set_command(imposed)
    told = []
    for observation in swinging.observations:
        estimator.observe(observation)
        if estimator.estimate.significant:
            told.append(estimator.estimate.specific_modulus)
    assert 1 <= len(told) < 10
    assert told[-1] == pytest.approx(TRUE_RATIO, rel=0.03)


def test_online_bears_late_double_and_unusable_splines(swinging):
    observations = list(swinging.observations)
    observations[10], observations[12] = observations[12], observations[10]
    observations.insert(20, observations[19])
    estimator = at_once(guess(0.3))
    with pytest.raises(InputError, match="7 control points"):
        estimator.observe(Observation(0, np.zeros((7, 4))))
    estimate = run_online(estimator, swinging, observations)
    assert estimate.specific_modulus == pytest.approx(TRUE_RATIO, rel=0.02)
    estimator.reset()
    assert estimator.estimate.specific_modulus == pytest.approx(0.3 * 5e7 / 2000.0)
    assert run_online(estimator, swinging).specific_modulus == pytest.approx(TRUE_RATIO, rel=0.02)


def test_online_waits_for_a_command(swinging):
    estimator = at_once(guess(0.3))
    for observation in swinging.observations[:5]:
        estimator.observe(observation)
    assert estimator.estimate.specific_modulus_std is None


def swapped(observation):
    """As an observer may see it that does not know the command: read from the end."""
    return Observation(observation.stamp, observation.control_points[::-1].copy())


def test_shapes_with_swapped_ends_are_turned_round(swinging):
    motion = Motion(list(swinging.commands))
    for observation in swinging.observations:
        assert along(motion, observation, 0.4) is observation
        unknown = swapped(observation)
        assert along(Motion(), unknown, 0.4) is unknown
        again = along(motion, swapped(observation), 0.4).control_points
        np.testing.assert_array_equal(again[:, :3], observation.control_points[:, :3])
    # A closed loop has no wrong direction.
    turn = BASIS.greville * 2.0 * np.pi / BASIS.length
    loop = np.column_stack([0.06 * np.sin(turn), 0.0 * turn, 0.06 * np.cos(turn), 0.0 * turn])
    held = Motion([command(["start", "end"], [0.0], [loop[[0, -1], :3]])])
    assert along(held, Observation(0, loop), 0.4).control_points is loop
    # Twist keeps its hand, and measured points their places.
    u = np.array([0.1, 0.3])
    points = CentrelinePoints(np.array([[0.3, 0.0, 0.0], [0.1, 0.0, 0.0]]), u, np.full(2, 1e-3))
    shape = np.column_stack([0.4 - BASIS.greville, 0.0 * turn, 0.0 * turn, 2.0 * BASIS.greville])
    imposed = Motion([command(["start"], [0.0], [[0.0, 0.0, 0.0]])])
    found = along(imposed, Observation(0, shape, points), 0.4)
    np.testing.assert_allclose(found.control_points[:, 0], BASIS.greville, atol=1e-12)
    assert np.all(np.diff(found.control_points[:, 3]) > 0.0)
    np.testing.assert_allclose(found.points.u, found.points.positions[:, 0])


def test_online_a_first_shape_with_swapped_ends_does_no_harm(swinging):
    estimator = at_once(guess(0.3))
    first, *rest = swinging.observations
    estimate = run_online(estimator, swinging, [swapped(first), *rest])
    assert estimate.specific_modulus == pytest.approx(TRUE_RATIO, rel=0.02)


@pytest.mark.parametrize("known", [{}, {"relaxation_time": 0.0, "relaxation_time_std": 1e-3}])
def test_online_keeps_what_it_knows_beyond_its_window(swinging, monkeypatch, known):
    monkeypatch.setattr("dlo_ros.identification.online.online_estimator.WINDOW", 0.6)
    begun = guess(0.3)
    estimator = at_once(replace(begun, damping=replace(begun.damping, **known)))
    estimate = run_online(estimator, swinging)
    assert estimate.specific_modulus == pytest.approx(TRUE_RATIO, rel=0.03)
    assert len(estimator._past.observations) <= 20
