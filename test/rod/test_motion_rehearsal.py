# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A motion that is tried is the motion that is made, with its band; and the live one goes on."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command

from dlo_ros.command import Command
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification.estimate import estimate_covariance, stated_covariance
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.live_simulation import LiveSimulation
from dlo_ros.rod.motion_rehearsal import (
    PLACES,
    Fork,
    at_rest,
    rehearse,
    slack,
    stamps_of,
    varied_by,
)
from dlo_ros.spline import SplineBasis

LENGTH = PAPER.rod.length
KNOWN = Settings.from_mapping({**PAPER.flat(), "rod.specific_modulus_std": 0.05 * 5e7 / 2500.0})


def moved(stamp, *, off_plane=0.0, ends=1):
    """A command of one second that lifts the start, from rest to rest."""
    t = np.linspace(0.0, 1.0, 21)
    names = ("start", "end")[:ends]
    position, velocity = np.zeros((21, ends, 3)), np.zeros((21, ends, 3))
    position[:, 0, 2], velocity[:, 0, 2] = (
        0.05 * (1 - np.cos(np.pi * t)), 0.05 * np.pi * np.sin(np.pi * t)
    )  # fmt: skip
    position[:, 0, 1], velocity[:, 0, 1] = (
        off_plane * position[:, 0, 2],
        off_plane * velocity[:, 0, 2],
    )
    if ends == 2:
        position[:, 1, 0] = 0.3
    rotation = np.tile([0.0, 0.0, 0.0, 1.0], (21, ends, 1))
    return Command(stamp, names, t, position, rotation, velocity, 10)


def live(settings, first):
    """A live simulation that has started where a command begins."""
    simulation = LiveSimulation(settings)
    simulation.set_command(first)
    simulation.start([Observation(first.stamp, slack(settings, first))])
    return simulation


@pytest.mark.parametrize("off_plane", [0.0, 0.5])
@pytest.mark.parametrize("ends", [1, 2])
def test_what_is_tried_is_what_then_happens(off_plane, ends):
    first = moved(SECOND, ends=ends)
    held = replace(
        first, times=first.times[:1], positions=first.positions[:1],
        rotations=first.rotations[:1], velocities=first.velocities[:1],
    )  # fmt: skip
    running = live(KNOWN, held)
    running.advance(SECOND + SECOND // 10)
    motion = moved(SECOND + SECOND // 5, off_plane=off_plane, ends=ends)
    covariance = stated_covariance(KNOWN)
    fork = running.rehearsing(motion, varied_by(covariance))
    stamps = stamps_of(motion, motion.stamp, 50.0)
    found = rehearse(fork.prepared(), stamps, covariance)
    # The running simulation has not moved, and has the same command.
    assert running.rehearsing(motion, ()).simulation.stamp == SECOND + SECOND // 10
    assert running.motion.commands == [held]
    running.set_command(motion)
    shapes = np.array([running.advance(stamp).control_points for stamp in stamps])
    assert found.stamps == tuple(stamps)
    assert np.abs(found.shapes - shapes).max() < 1e-3 * LENGTH
    assert len(found.loadings) == len(stamps)
    assert (found.loadings[0].end is None) == (ends == 1)


def test_a_motion_whose_start_has_passed_is_tried_whole():
    first = moved(SECOND)
    running = live(PAPER, first)
    now = SECOND + SECOND // 4
    running.advance(now)
    shapes = []
    for stamp in (now, now - SECOND // 10, SECOND // 2):
        motion = moved(stamp, off_plane=0.3)
        fork = running.rehearsing(motion, ())
        assert fork.late == now - stamp
        stamps = [s + fork.late for s in stamps_of(motion, stamp, 50.0)]
        shapes.append(rehearse(fork.prepared(), stamps, None).shapes)
    np.testing.assert_array_equal(shapes[1], shapes[0])
    np.testing.assert_array_equal(shapes[2], shapes[0])


def test_the_band_is_what_other_parameters_do():
    motion = moved(SECOND)
    covariance = stated_covariance(KNOWN)
    stamps = stamps_of(motion, SECOND, 50.0)
    found = rehearse(at_rest(KNOWN, motion, covariance, stamps[-1]), stamps, covariance)
    basis = SplineBasis(10, LENGTH)
    along = basis.matrix(np.linspace(0.0, LENGTH, PLACES))

    def places(factor):
        other = KNOWN.with_material(factor * 5e7, 2500.0)
        return along @ rehearse(at_rest(other, motion, None), stamps, None).shapes[:, :, :3]

    apart = 0.5 * np.linalg.norm(places(1.05) - places(0.95), axis=2)
    assert found.std.shape == apart.shape == (len(stamps), PLACES)
    assert found.std == pytest.approx(apart, abs=0.05 * apart.max())
    assert apart.max() > 1e-3 * LENGTH
    assert "mm at the end" in found.sentences(KNOWN.limits)[0]


def test_without_a_stated_std_there_is_no_band():
    motion = moved(SECOND)
    assert stated_covariance(PAPER) is None and varied_by(None) == ()
    found = rehearse(at_rest(PAPER, motion, None), stamps_of(motion, SECOND, 50.0), None)
    assert found.std is None and "none" in found.sentences(PAPER.limits)[0]


def test_stated_stds_make_the_covariance():
    values = {"rod.density_std": 250.0, "damping.air_drag_std": 0.002}
    found = stated_covariance(Settings.from_mapping({**KNOWN.flat(), **values}))
    assert found[0, 0] == pytest.approx(0.05**2 + 0.1**2)
    assert found[0, 1] == found[1, 1] == pytest.approx(0.1**2)
    assert found[2, 2] == pytest.approx(0.2**2) and not found[3].any()
    assert varied_by(found) == ("young_modulus", "density", "air_drag")


def test_an_estimate_that_tells_much_leaves_little_open():
    told = estimate_covariance(PAPER, np.diag([1e4, 0.0, 0.0, 0.0]))
    assert told[0, 0] == pytest.approx(1e-4, rel=1e-2) and told[1, 1] > 0.05


def test_a_rehearsal_in_a_thread_leaves_the_running_simulation_as_it_is():
    still = live(PAPER, moved(SECOND, off_plane=0.5))
    other = live(PAPER, moved(SECOND, off_plane=0.5))
    stamps = [SECOND + k * SECOND // 50 for k in range(1, 51)]
    expected = [still.advance(stamp).control_points for stamp in stamps]
    motion, results = moved(SECOND + SECOND // 2, off_plane=-0.5), []

    def work(fork):
        stamps = stamps_of(motion, fork.simulation.stamp, 50.0)
        results.append(rehearse(fork.prepared(), stamps, None))

    found, threads = [], []
    for k, stamp in enumerate(stamps):
        if k % 5 == 0 and k < 25:
            threads.append(threading.Thread(target=work, args=(other.rehearsing(motion, ()),)))
            threads[-1].start()
        found.append(other.advance(stamp).control_points)
    for thread in threads:
        thread.join()
    assert len(results) == 5
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("apart", [0.0, 0.2, 0.3999, 0.4])
def test_a_slack_dlo_is_as_long_as_the_real_one(apart):
    places = [[0.1, 0.0, 0.2], [0.1 + apart, 0.0, 0.2]]
    shape = slack(PAPER, command(["start", "end"], [0.0], [places]))
    u = np.linspace(0.0, LENGTH, 400)
    points = SplineBasis(10, LENGTH).evaluate(shape[:, :3], u)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert points[[0, -1]] == pytest.approx(np.array(places))
    assert length == pytest.approx(max(apart, LENGTH if apart < 0.399 else apart), rel=0.11)
    assert points[200, 2] <= 0.2 + 1e-9


@pytest.mark.parametrize("name", ["end", "control_point_10", "control_point_1"])
def test_whatever_is_held_a_dlo_finds_its_rest(name):
    imposed = command([name], [0.0], [[0.1, 0.0, 0.2]], stamp=SECOND)
    found = rehearse(at_rest(PAPER, imposed, None), [SECOND], None)
    assert np.all(np.isfinite(found.shapes)) and len(found.loadings) == 1
    held = 0 if name == "control_point_1" else -1
    assert found.shapes[0, held, :3] == pytest.approx([0.1, 0.0, 0.2], abs=1e-6)


@pytest.mark.parametrize("end", ["start", "end"])
@pytest.mark.parametrize("angle", [0.4, np.pi])
def test_two_control_points_hold_an_end_as_a_clamp_does(end, angle):
    """Whichever way they point: the DLO is laid in their direction before it finds its rest."""
    place = np.array([0.1, 0.0, 0.2])
    along = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    step = LENGTH / 21 * along  # of the outer control points of a straight DLO
    turned = np.array([[[0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)]]])
    nothing = np.full((1, 1, 3), np.nan)
    clamp = Command(SECOND, (end,), np.zeros(1), place[None, None], turned, nothing, 10)
    names = ["control_point_1", "control_point_2"]
    points = [place, place + step]
    if end == "end":
        names, points = ["control_point_9", "control_point_10"], [place - step, place]
    imposed = command(names, [0.0], [points], stamp=SECOND)
    by_clamp, by_points = (
        rehearse(at_rest(PAPER, held, None), [SECOND], None).shapes[0] for held in (clamp, imposed)
    )
    np.testing.assert_allclose(by_points[:, :3], by_clamp[:, :3], atol=2e-3 * LENGTH)


def test_a_motion_that_cannot_be_made_is_refused():
    places = [[[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]]]
    torn = command(["start", "end"], [0.0, 1.0], places, stamp=SECOND)
    with pytest.raises(SimulationError, match="but the DLO between them"):
        rehearse(at_rest(PAPER, torn, None), stamps_of(torn, SECOND, 50.0), None)
    endless = command(["start"], [0.0, 1e5], np.zeros((2, 1, 3)), stamp=SECOND)
    with pytest.raises(InputError, match="too long"):
        stamps_of(endless, SECOND, 50.0)


def test_stamps_reach_the_end_at_the_rate():
    motion = moved(SECOND)
    stamps = stamps_of(motion, SECOND, 30.0)
    assert stamps[0] == SECOND and stamps[-1] == 2 * SECOND and len(stamps) == 31
    assert stamps_of(motion, 3 * SECOND, 30.0) == [3 * SECOND]


def test_a_fork_of_nothing_is_none():
    assert LiveSimulation(PAPER).rehearsing(moved(SECOND), ()) is None
    assert Fork.__doc__
