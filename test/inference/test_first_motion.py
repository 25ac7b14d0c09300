# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How a recording begins: in equilibrium, let go, or in motion; and what the tools make of it."""

import argparse
from dataclasses import replace

import numpy as np
import pytest
import yaml

from dlo_ros.cli.loading import unstated
from dlo_ros.cli.main import main
from dlo_ros.command import Command
from dlo_ros.diagnosis.explain.measurement_error import own_err
from dlo_ros.identification.material_model import material_model
from dlo_ros.inference.first_motion import apparent_start, frames_at_rest
from dlo_ros.inference.forecast import Manipulation, forecast
from dlo_ros.inference.joint import evaluate
from dlo_ros.inference.measured import measured
from dlo_ros.observation import Observation
from dlo_ros.parameter_file import parameter_values
from dlo_ros.parameters import Settings
from dlo_ros.recordings import BAG_MESSAGES, BagWriter, command_message, spline_message, topics
from dlo_ros.recordings.bag import TYPESTORE, open_bag
from dlo_ros.spline import SplineBasis

BEGIN, EVERY, FRAMES = 10**18, 33_000_000, 12
ROD = Settings.from_mapping(
    {
        "rod.length": 0.4, "rod.diameter": 0.004, "rod.young_modulus": 1e7, "rod.density": 2000.0,
        "simulation.tolerance": 0.001,
    }
)  # fmt: skip
LENGTH, N = ROD.rod.length, ROD.rod.control_points
BENT = 0.8  # [rad] a point at the tip lies aside by this over L, as a hanging rope that is bent


def bent(amount):
    """A hanging DLO that bends more and more towards its tip, as one that is pulled aside."""
    u = SplineBasis(N, LENGTH).greville / LENGTH
    angle = amount * u
    shape = np.zeros((N, 4))
    shape[1:, 0] = np.cumsum(LENGTH * np.diff(u) * np.sin(0.5 * (angle[1:] + angle[:-1])))
    shape[1:, 2] = -np.cumsum(LENGTH * np.diff(u) * np.cos(0.5 * (angle[1:] + angle[:-1])))
    return shape


def command(turning=0.0):
    """The start held, straight down at first; it turns by so many radians a second."""
    angles = np.array([0.0, turning])
    half = np.pi / 4 - 0.5 * angles
    turns = np.stack([0 * half, np.sin(half), 0 * half, np.cos(half)], axis=1)[:, None]
    return Command(
        BEGIN, ("start",), np.array([0.0, 1.0]), np.zeros((2, 1, 3)), turns,
        np.full((2, 1, 3), np.nan), N,
    )  # fmt: skip


def recording(amounts, *, turning=0.0, noise=0.0):
    draw = np.random.default_rng(0)
    seen = []
    for k, amount in enumerate(amounts):
        shape = bent(amount)
        shape[:, :3:2] += noise * draw.normal(size=(N, 2))
        seen.append(Observation(BEGIN + k * EVERY, shape))
    return Manipulation("swing", (command(turning),), tuple(seen))


T = np.arange(FRAMES) * EVERY * 1e-9
LET_GO = BENT * np.cos(5.0 * T)
IN_MOTION = BENT * np.sin(5.0 * T)


@pytest.mark.parametrize("noise", [0.0, 5e-4])
def test_a_dlo_that_was_let_go_starts_from_what_was_observed(noise):
    assert apparent_start(recording(LET_GO, noise=noise), LENGTH) == "observed"


@pytest.mark.parametrize("noise", [0.0, 5e-4])
def test_a_dlo_in_motion_starts_moving(noise):
    assert apparent_start(recording(IN_MOTION, noise=noise), LENGTH) == "moving"


def test_noise_at_rest_and_wrong_pictures_are_no_motion():
    for wrong in (None, 0, 1, 3, 4):
        amounts = np.zeros(FRAMES)
        if wrong is not None:
            amounts[wrong] = BENT
        assert apparent_start(recording(amounts, noise=1e-3), LENGTH) is None, wrong


def test_what_follows_its_command_begins_in_equilibrium():
    assert apparent_start(recording(-2.0 * T, turning=2.0), LENGTH) is None


def test_few_pictures_tell_nothing():
    found = recording(LET_GO)
    assert apparent_start(replace(found, observations=found.observations[:4]), LENGTH) is None


def test_a_forecast_starts_as_its_recording_says():
    swing = recording(LET_GO)
    settled = forecast(swing, ROD)
    released = forecast(replace(swing, start="observed"), ROD)
    moving = forecast(replace(swing, start="moving"), ROD)
    assert settled.err[0] > 0.05 * LENGTH
    assert released.err[0] < 0.01 * LENGTH
    assert len(moving.stamps) == len(settled.stamps) - 1


def predicted(path):
    with open_bag(path) as bag:
        kept = [c for c in bag.connections if topics.is_topic(c.topic, topics.ERR)]
        return [
            TYPESTORE.deserialize_cdr(raw.data, raw.connection.msgtype).data
            for raw in bag.messages(kept)
        ]


def written(bag):
    """The recording of a swing."""
    swing = recording(LET_GO)
    with BagWriter(bag) as writer:
        message = command_message(BAG_MESSAGES, swing.commands[0])
        writer.write(topics.COMMAND, message, BEGIN)
        for o in swing.observations:
            message = spline_message(BAG_MESSAGES, o.stamp, "board", o.control_points)
            writer.write(topics.OBSERVED, message, o.stamp)


def test_predict_starts_a_swing_where_it_was_let_go(tmp_path, caplog):
    bag, file = tmp_path / "swing", tmp_path / "params.yaml"
    written(bag)

    def first_err(name, *words):
        out = tmp_path / f"{name}.mcap"
        assert main(["predict", "--params", str(file), "--output", str(out), *words, str(bag)]) == 0
        return predicted(out)[0]

    block = {k: v for k, v in ROD.flat().items() if k != "simulation.start"}
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": block}}))
    assert first_err("open") < 0.01 * LENGTH
    assert "simulated with --start observed" in caplog.text
    assert first_err("told", "--start", "equilibrium") > 0.05 * LENGTH
    block["simulation.start"] = "equilibrium"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": block}}))
    caplog.clear()
    assert first_err("stated") > 0.05 * LENGTH
    assert "try --start observed" in caplog.text


@pytest.mark.slow
def test_results_state_no_start_that_the_tool_has_found_itself(tmp_path, capsys):
    """A recording that began in motion would be predicted from rest by what it gave."""
    bag, file = tmp_path / "swing", tmp_path / "params.yaml"
    written(bag)
    block = {k: v for k, v in ROD.flat().items() if k != "simulation.start"}
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": block}}))

    def stated(name, *words):
        call = ["identify", "--params", str(file), "--output", str(tmp_path / name), *words]
        assert main([*call, str(bag)]) == 0
        found = parameter_values(tmp_path / name / "estimate.yaml")
        assert found["rod.length"] == LENGTH and capsys.readouterr()
        return found.get("simulation.start")

    assert stated("open") is None
    assert stated("told", "--start", "observed") == "observed"
    given = argparse.Namespace(start=None, params=file)
    assert unstated(given) == ("simulation.start",)
    file.write_text(ROD.text())
    assert unstated(given) == ()


@pytest.mark.parametrize(("begins", "turning", "still"), [(0, 1.0, 1), (5, 1.0, 6), (5, 0.0, 12)])
def test_frames_at_rest_are_those_before_the_command_moves(begins, turning, still):
    given = recording([0.0] * FRAMES, turning=turning)
    waiting = replace(given.commands[0], stamp=BEGIN + begins * EVERY)
    assert frames_at_rest(replace(given, commands=(waiting,)), LENGTH) == still


def test_a_recording_that_begins_in_motion_has_no_frames_at_rest():
    given = recording([0.0] * FRAMES, noise=1e-5)
    assert measured(given, ROD).frames_at_rest == FRAMES
    assert measured(given, ROD).of(np.arange(3, 7)).frames_at_rest == 4
    assert measured(given, ROD).of(np.array([3, 11])).frames_at_rest == 2
    assert measured(replace(given, start="moving"), ROD).frames_at_rest == 0


def test_what_changes_at_rest_is_the_measurement_however_smooth_it_is():
    """A smooth error that lasts for some frames looks like one of the model."""
    draw, shapes = np.random.default_rng(3), []
    size = np.zeros(2)
    for _ in range(8 * FRAMES):
        size = 0.85 * size + 1e-4 * draw.normal(size=2)
        shape = bent(0.0)
        shape[:, :3:2] += size * np.linspace(0.0, 1.0, N)[:, None] + 4e-5 * draw.normal(size=(N, 2))
        shapes.append(shape)
    given = recording([0.0] * len(shapes))
    seen = zip(given.observations, shapes, strict=True)
    given = replace(given, observations=tuple(replace(o, control_points=s) for o, s in seen))
    found = measured(given, ROD)
    at = evaluate(material_model(ROD, ROD), [found])
    blind = own_err(at, [replace(found, frames_at_rest=0)])
    assert blind < 0.65 * at.mean_err
    assert 0.75 * at.mean_err < own_err(at, [found]) < at.mean_err
