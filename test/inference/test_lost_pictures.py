# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Lost pictures that the stamps do not count: found, their time put back, and what is none."""

from dataclasses import replace

import numpy as np
import pytest
from measured import spline_through
from rods import SECOND, command

from dlo_ros.cli.main import main
from dlo_ros.inference.forecast import Manipulation, forecast
from dlo_ros.inference.lost_pictures import lost_pictures, with_lost_time
from dlo_ros.inference.lost_time import Gap, stated_stamps, true_stamps
from dlo_ros.observation import Observation, Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.recordings import BagWriter, topics
from dlo_ros.recordings.bag import deserialise, open_bag
from dlo_ros.recordings.message_building import BAG_MESSAGES, command_message, spline_message
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis import discrete_rod, rod_simulation

BEGIN = 1_750_000_000 * SECOND
EVERY, FRAMES = SECOND // 100, 161
SETTINGS = Settings.from_mapping(
    {
        "rod.length": 0.6, "rod.diameter": 0.006, "rod.young_modulus": 2e6, "rod.density": 1200.0,
        "rod.control_points": 10, "simulation.start": "moving",
    }
)  # fmt: skip
LOST = {40: 2, 46: 4, 90: 1}
"""Pictures that are lost, by the number of the picture before them."""


def place(seconds):
    """Where the start is held, x and z [m]."""
    return np.array([0.1 * np.sin(5.0 * seconds), 0.05 * np.sin(3.0 * seconds)])


def recorded(settings, frames, noise=5e-5):
    """A rope that is carried about by its start, by the independent rod, at 100 Hz."""
    rng = np.random.default_rng(3)
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    rod = discrete_rod.DiscreteRod.uniform(settings.rod, settings.damping, edges=60)

    def boundary(t):
        return rod_simulation.ImposedNodes({0: place(t)}, start=np.pi / 2)

    hanging = np.column_stack([np.zeros(len(rod.u)), -rod.u])
    simulation = rod_simulation.DiscreteRodSimulation(rod, boundary, hanging, step=1e-3)
    simulation.settle()
    shapes = []
    for k in range(frames):
        if k:
            simulation.advance(k * EVERY / SECOND)
        shapes.append(spline_through(rod, simulation.x, basis, noise, rng))
    return stamped(shapes, np.array([place(k * EVERY / SECOND) for k in range(frames)]), basis)


def stamped(shapes, held, basis):
    """A manipulation at 100 Hz, its command recorded with the pictures."""
    positions = np.insert(held, 1, 0.0, axis=1)[:, None]
    down = np.tile([0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4)], (len(held), 1, 1))
    times = np.arange(len(held)) * EVERY / SECOND
    imposed = command(["start"], times, positions, down, n=basis.control_points, stamp=BEGIN)
    seen = tuple(Observation(BEGIN + k * EVERY, s) for k, s in enumerate(shapes))
    return Manipulation("carried", (imposed,), seen)


@pytest.fixture(scope="module")
def whole():
    return recorded(SETTINGS, FRAMES)


def without(whole, lost):
    """The recording without some pictures, stamped as if they had never been."""
    gone = {k + i + 1 for k, count in lost.items() for i in range(count)}
    kept = [k for k in range(len(whole.observations)) if k not in gone]
    held = whole.commands[0].positions[kept, 0][:, [0, 2]]
    basis = SplineBasis(SETTINGS.rod.control_points, SETTINGS.rod.length)
    return stamped([whole.observations[k].control_points for k in kept], held, basis), kept


def test_lost_pictures_are_found_and_their_time_put_back(whole):
    short, kept = without(whole, LOST)
    gaps = lost_pictures(short)
    assert [g.lost for g in gaps] == list(LOST.values())
    mended = with_lost_time(short, gaps)
    assert [o.stamp for o in mended.observations] == [BEGIN + k * EVERY for k in kept]
    assert mended.commands[0].times == pytest.approx([k * EVERY / SECOND for k in kept], abs=1e-9)
    stated = np.array([o.stamp for o in short.observations])
    assert np.array_equal(stated_stamps(true_stamps(stated, gaps), gaps), stated)
    assert not lost_pictures(mended)
    errors = [1e3 * forecast(m, SETTINGS).err.mean() for m in (short, mended, whole)]
    assert errors[0] > 3.0 * errors[1] and errors[1] < 1.2 * errors[2] + 0.1, errors


def test_time_goes_on_evenly_within_a_gap():
    gaps = (Gap(100, 200, 2), Gap(500, 600, 1))
    stated = np.array([0, 100, 150, 200, 500, 550, 600, 700])
    true = np.array([0, 100, 250, 400, 700, 800, 900, 1000])
    assert np.array_equal(true_stamps(stated, gaps), true)
    assert np.array_equal(stated_stamps(true, gaps), stated)
    assert true_stamps(stated, ()) is stated_stamps(stated, ()) is stated
    exact = np.array([2**60 + 1, 2**60 + 3])
    assert np.array_equal(true_stamps(exact, (Gap(2**60, 2**60 + 1, 1),)), exact + 1)


def test_forces_are_moved_with_the_pictures(whole):
    short, _ = without(whole, LOST)
    stamps = np.array([o.stamp for o in short.observations])
    sensed = Wrenches.along_axes("start", stamps, np.zeros((len(stamps), 6)))
    mended = with_lost_time(replace(short, wrenches=(sensed,)), lost_pictures(short))
    assert np.array_equal(mended.wrenches[0].stamps, [o.stamp for o in mended.observations])


def moved(manipulation, k, by):
    """The recording with one picture moved aside."""
    seen = list(manipulation.observations)
    seen[k] = replace(seen[k], control_points=seen[k].control_points + by)
    return replace(manipulation, observations=tuple(seen))


def clock_of_its_own(whole):
    """Pictures were lost, but the robot's commands have the stamps of the robot."""
    short, _ = without(whole, LOST)
    return replace(short, commands=whole.commands)


def counted(whole):
    """Pictures were lost, and the stamps know it."""
    _, kept = without(whole, LOST)
    return replace(whole, observations=tuple(whole.observations[k] for k in kept))


def carried_at_once(whole):
    """The robot itself makes a jump between two rests, and the rope goes along."""
    shape, rng = whole.observations[0].control_points, np.random.default_rng(1)
    held = 1e-6 * rng.normal(size=(60, 2))
    held[30:, 0] += 0.05
    shapes = [shape + np.array([x, 0.0, z, 0.0]) for x, z in held]
    return stamped(shapes, held, SplineBasis(10, 0.6))


@pytest.mark.parametrize(
    "changed",
    [
        lambda m: m,
        lambda m: moved(m, 50, np.array([0.03, 0.0, 0.02, 0.0])),  # a wrong picture
        clock_of_its_own,
        counted,
        carried_at_once,
        lambda m: replace(m, observations=m.observations[:4]),
        lambda m: replace(m, commands=()),
    ],
)
def test_what_is_no_lost_picture(whole, changed):
    assert not lost_pictures(changed(whole))


def test_a_wrong_picture_elsewhere_hides_no_lost_one(whole):
    short, _ = without(whole, {40: 3})
    assert [g.lost for g in lost_pictures(moved(short, 100, np.array([0.05, 0.0, 0.02, 0.0])))] == [
        3
    ]


def test_predict_tells_lost_pictures_and_keeps_the_stamps_of_the_recording(
    whole, tmp_path, caplog, capsys
):
    short, _ = without(whole, LOST)
    SETTINGS.dump(tmp_path / "params.yaml")
    with BagWriter(tmp_path / "bag") as writer:
        message = command_message(BAG_MESSAGES, short.commands[0])
        writer.write(topics.COMMAND, message, BEGIN)
        for seen in short.observations:
            message = spline_message(BAG_MESSAGES, seen.stamp, "board", seen.control_points)
            writer.write(topics.OBSERVED, message, seen.stamp)
    words = ["predict", "--params", str(tmp_path / "params.yaml")]
    words += ["--output", str(tmp_path / "out.mcap"), str(tmp_path / "bag")]
    assert main(words) == 0
    assert "7 pictures were lost that the stamps do not count" in caplog.text
    assert "(2 after 0.40 s, 4 after 0.44 s, 1 after 0.84 s)" in caplog.text
    assert "the 0.07 s are put back" in caplog.text
    with open_bag(tmp_path / "out.mcap") as bag:
        raw = list(bag.messages(bag.find(topics.PREDICTED)))
    stamps = [deserialise(r).header.stamp for r in raw]
    found = [s.sec * SECOND + s.nanosec for s in stamps]
    assert found == [o.stamp for o in short.observations[1:]]
    capsys.readouterr()
