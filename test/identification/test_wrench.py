# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measured forces at the grips: read, brought to instants, compared with predicted ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import recordings_samples as samples
from rods import PAPER, command

from dlo_ros.cli.main import main
from dlo_ros.errors import InputError, RecordingError
from dlo_ros.inference.wrench import (
    WrenchField,
    from_change,
    from_mean,
    wrench_field,
    wrench_information,
)
from dlo_ros.inference.wrench_messages import near, scatter, shaken
from dlo_ros.observation import Wrenches
from dlo_ros.recordings import BAG_MESSAGES, read_recording
from dlo_ros.recordings.message_building import transform_message, wrench_message
from dlo_ros.synthesis import discrete_rod, rod_simulation
from dlo_ros.synthesis.rod_reactions import reactions

WEIGHT = PAPER.rod.linear_density * PAPER.rod.length * 9.81
LENGTH = PAPER.rod.length


def bag(folder: Path, items: list) -> Path:
    return samples.write_plain(folder / "bag", [*samples.messages(), *items])


def wrench(k: int, frame: str = "board", force=(1.0, 2.0, 3.0), torque=(0.1, 0.2, 0.3)):
    message = wrench_message(
        BAG_MESSAGES, samples.START + k * samples.STEP, frame, np.array(force), np.array(torque)
    )
    return "/dlo/wrench_end", message, samples.START + k * samples.STEP


def transform(topic: str, k: int, parent: str, child: str, translation, rotation):
    stamp = samples.START + k * samples.STEP
    message = transform_message(BAG_MESSAGES, stamp, parent, child, translation, rotation)
    return topic, message, stamp


def sensor_of(measured: np.ndarray, stamps: np.ndarray) -> Wrenches:
    axes = np.broadcast_to(np.eye(3), (len(stamps), 3, 3))
    return Wrenches("start", stamps, measured[:, :3], measured[:, 3:], axes)


def test_forces_in_the_fixed_frame_are_read_as_they_are(tmp_path, caplog):
    items = [wrench(k) for k in range(4)]
    items[2][1].wrench.force.y = float("nan")
    (found,) = read_recording(bag(tmp_path, items), samples.SETTINGS).wrenches
    assert found.end == "end" and len(found.stamps) == 3
    np.testing.assert_array_equal(found.force, np.tile([1.0, 2.0, 3.0], (3, 1)))
    np.testing.assert_array_equal(found.torque, np.tile([0.1, 0.2, 0.3], (3, 1)))
    assert "1 of 4 messages on dlo/wrench_end are left out" in caplog.text


def test_forces_in_a_sensors_frame_are_turned_and_moved_to_the_end(tmp_path):
    quarter = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))  # x of the sensor along the board's y
    items = [
        transform("/tf_static", 0, "flange", "sensor", (0.0, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0)),
        transform("/tf", 0, "board", "flange", (0.3, 0.0, 0.0), quarter),
        transform("/tf", 4, "board", "flange", (0.7, 0.0, 0.0), quarter),
        *(wrench(k, "sensor") for k in (0, 2)),
    ]
    (found,) = read_recording(bag(tmp_path, items), samples.SETTINGS).wrenches
    np.testing.assert_allclose(found.force, np.tile([-2.0, 1.0, 3.0], (2, 1)), atol=1e-12)
    imposed = samples.command()
    for k, x in ((0, 0.3), (1, 0.5)):
        held = imposed.sample(int(found.stamps[k]))[0][1]
        lever = np.array([x, 0.0, 0.1]) - held
        expected = np.array([-0.2, 0.1, 0.3]) + np.cross(lever, [-2.0, 1.0, 3.0])
        np.testing.assert_allclose(found.torque[k], expected, atol=1e-9)


def test_a_frame_that_nobody_knows_is_refused(tmp_path):
    path = bag(tmp_path, [wrench(0, "gripper")])
    with pytest.raises(RecordingError, match=r"no transform leads from 'gripper' to 'board'"):
        read_recording(path, samples.SETTINGS)


def test_two_frames_are_refused(tmp_path):
    path = bag(tmp_path, [wrench(0), wrench(1, "gripper")])
    with pytest.raises(RecordingError, match="in several frames"):
        read_recording(path, samples.SETTINGS)


def test_wrenches_check_themselves():
    stamps, rows, axes = np.array([1, 1]), np.zeros((2, 3)), np.zeros((2, 3, 3))
    with pytest.raises(InputError, match="do not grow"):
        Wrenches("start", stamps, rows, rows, axes)
    with pytest.raises(InputError, match="shapes that differ"):
        Wrenches("start", np.array([1, 2]), rows[:1], rows, axes)


def test_forces_go_through_tables_and_back(tmp_path, capsys):
    samples.SETTINGS.dump(tmp_path / "params.yaml")
    path = bag(tmp_path, [wrench(k, force=(0.5 * k, 2.0, 3.0)) for k in range(3)])
    both = ["--params", str(tmp_path / "params.yaml"), "--format", "csv"]
    tables, again = str(tmp_path / "tables"), str(tmp_path / "again")
    assert main(["export", *both, "--recording", str(path), "--output", tables]) == 0
    assert main(["import", *both, "--output", again, tables]) == 0
    assert "3 measured forces" in capsys.readouterr().out
    (first,), (second,) = (read_recording(p, samples.SETTINGS).wrenches for p in (path, again))
    for name in ("stamps", "force", "torque"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    table = tmp_path / "tables" / "wrench.csv"
    table.write_text(table.read_text().replace("end,0.5", "tip,0.5"))
    assert main(["import", *both, "--force", "--output", again, tables]) == 2
    assert "end is 'tip'; it must be start or end" in capsys.readouterr().err


def test_the_discrete_rods_clamp_bears_its_weight():
    rod = discrete_rod.DiscreteRod.uniform(PAPER.rod, PAPER.damping, edges=60)
    hold = rod_simulation.ImposedNodes({0: np.zeros(2)}, start=0.3)
    straight = np.column_stack([rod.u, np.zeros(len(rod.u))])
    simulation = rod_simulation.DiscreteRodSimulation(rod, lambda _: hold, straight)
    x = simulation.settle()
    before = reactions(simulation)["start"]
    (force_x, _, force_z), torque = before[:3], before[4]
    assert force_z == pytest.approx(WEIGHT, rel=1e-6) and abs(force_x) < 1e-6 * WEIGHT
    # About +y the weight turns with x times its size, the clamp against it.
    assert torque == pytest.approx(-np.sum(rod.mass * 9.81 * x[:, 0]), rel=1e-4)
    simulation.advance(0.2)  # at rest it stays
    np.testing.assert_allclose(reactions(simulation)["start"], before, atol=1e-5 * WEIGHT)
    assert "end" not in reactions(simulation)


def test_forces_are_brought_to_the_instants_of_shapes():
    rng = np.random.default_rng(1)
    stamps = np.arange(0, 2_000_000_000, 5_000_000)
    time = stamps * 1e-9
    table = np.zeros((len(stamps), 6))
    table[:, 2] = np.sin(2.0 * np.pi * time)
    clean = sensor_of(table, stamps)
    shapes = [round(k / 30.0 * 1e9) for k in range(2, 50)]
    values, share, found = near(clean, shapes)
    assert found.all() and share.max() < 0.7  # several messages average their noise
    expected = np.sin(2.0 * np.pi * np.array(shapes) * 1e-9)
    np.testing.assert_allclose(values[:, 2], expected, atol=2e-4)
    noisy = sensor_of(table + 0.01 * rng.normal(size=table.shape), stamps)
    left = (near(noisy, shapes)[0] - values) / 0.01
    assert np.sqrt(np.mean(left**2)) == pytest.approx(np.sqrt(np.mean(share**2)), rel=0.1)
    assert scatter(noisy)[2] == pytest.approx(0.01, rel=0.2)
    # A gap in the messages, and shapes before the first of them, are left out.
    kept = (time > 0.5) & ((time < 1.0) | (time > 1.3))
    holes = sensor_of(table[kept], stamps[kept])
    _, _, found = near(holes, shapes)
    at = np.array(shapes) * 1e-9
    assert not found[at < 0.49].any() and not found[(at > 1.05) & (at < 1.25)].any()
    assert found[(at > 0.55) & (at < 0.95)].all()


def test_a_swing_of_eight_hertz_is_not_flattened():
    """Three messages of 100 Hz stand about a shape of 30 Hz: their mean would lack a tenth."""
    stamps = np.arange(0, 2_000_000_000, 10_000_000)
    table = np.zeros((len(stamps), 6))
    table[:, 2] = np.sin(16.0 * np.pi * stamps * 1e-9)
    shapes = [round(k / 30.0 * 1e9) for k in range(2, 50)]
    values, _, _ = near(sensor_of(table, stamps), shapes)
    swing = np.sin(16.0 * np.pi * np.array(shapes) * 1e-9)
    np.testing.assert_allclose(values[:, 2], swing, atol=0.01)


def artificial(offset: float, rng: np.random.Generator, waving: float) -> WrenchField:
    """A force that is a scale times (1 + a wave), with noise and an offset of unit prior."""
    time = np.linspace(0.0, 1.0, 60)
    wave = 1.0 + waving * np.sin(2.0 * np.pi * 3.0 * time)
    measured = 1.1 * wave + offset * 0.05 + 0.01 * rng.normal(size=60)
    return WrenchField(
        "", (measured - wave)[:, None], wave[:, None, None], np.full((60, 1, 1), 0.05),
        np.array([True]), np.array([False]), np.array([0.01]), np.array([1.0]),
    )  # fmt: skip


def test_what_rings_is_left_out_and_what_moves_is_not():
    """Pulled abruptly a DLO rings along itself, which neither pictures nor sensors follow."""
    stamps = np.arange(200) * 10_000_000
    time = stamps * 1e-9
    rng = np.random.default_rng(1)
    table = 0.01 * rng.normal(size=(200, 6)) + np.sin(2.0 * np.pi * 2.0 * time)[:, None]
    shapes = list(range(0, 1_950_000_001, 33_000_000))
    assert not shaken(sensor_of(table, stamps), shapes).any()
    ringing = (time > 0.5) & (time < 0.56)
    table[ringing] += 0.5 * np.where(np.arange(ringing.sum()) % 2, 1.0, -1.0)[:, None]
    found = np.array(shapes)[shaken(sensor_of(table, stamps), shapes)] * 1e-9
    assert 0.43 < found.min() < 0.5 and 0.56 < found.max() < 0.63 and len(found) in (4, 5, 6)
    assert not shaken(sensor_of(table[:5], stamps[:5]), shapes).any()
    still = np.ones((200, 6))  # without noise
    assert not shaken(sensor_of(still + 1e-9 * table, stamps), shapes).any()


def test_an_offset_cannot_be_told_from_a_weight_at_rest_but_from_one_that_moves():
    nothing, little = np.zeros(1), 1e-6 * np.eye(1)
    still = artificial(1.0, np.random.default_rng(3), 0.0)
    found = wrench_information(still, nothing, little)
    assert found.information[0, 0] == pytest.approx(0.05**-2, rel=0.05)
    assert from_change(still, found.variance)[0, 0] < 1e-3
    moving = artificial(1.0, np.random.default_rng(3), 0.5)
    found = wrench_information(moving, nothing, little)
    # The wave has 60 instants with a mean square of 1/8, each known to 0.01.
    assert found.information[0, 0] == pytest.approx(60 / 8 / 0.01**2, rel=0.3)
    assert found.gradient[0] / found.information[0, 0] == pytest.approx(0.1, abs=0.015)
    mean, change = from_mean(moving, found.variance), from_change(moving, found.variance)
    assert mean[0, 0] == pytest.approx(0.05**-2, rel=0.1)
    assert mean[0, 0] < change[0, 0] <= found.information[0, 0]


def test_standard_deviations_of_forces_cover_the_truth():
    rng, nothing, little = np.random.default_rng(5), np.zeros(1), 1e-6 * np.eye(1)
    off = []
    for _ in range(60):
        found = wrench_information(artificial(rng.normal(), rng, 0.3), nothing, little)
        step = found.gradient[0] / found.information[0, 0]
        off.append((step - 0.1) * np.sqrt(found.information[0, 0]))
    assert 0.7 < np.std(off) < 1.3


def test_a_tool_is_felt_only_where_the_grip_accelerates():
    stamps = np.arange(30) * 33_000_000
    table = np.ones((30, 6))
    predicted, derivative = np.ones((30, 6)), np.ones((30, 6, 4))
    still = command(["start"], [0.0], np.zeros((1, 3)))
    times = np.linspace(0.0, 1.0, 51)
    way = np.zeros((51, 3))
    way[:, 0] = 0.1 * times**2
    moved = command(["start"], times, way)
    columns = [
        wrench_field(
            "", sensor_of(table, stamps), list(stamps), predicted, derivative, PAPER, [c]
        ).nuisances.shape[2]
        for c in (still, moved)
    ]
    assert columns == [7, 11]  # six offsets and a delay; with a mass and its three levers
