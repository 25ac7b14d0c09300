# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings of simulated experiments: what is in the bag agrees with the truth beside it."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import RecordingError
from dlo_ros.parameters import Settings
from dlo_ros.recordings.bag import open_bag
from dlo_ros.recordings.read import iterate_images, read_recording
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.experiment import START_STAMP, read_experiment
from dlo_ros.synthesis.synthesize import synthesize

ROOT = Path(__file__).resolve().parents[2]


def experiment(**changes):
    tree = yaml.safe_load((ROOT / "config" / "experiments" / "c_shape.yaml").read_text())
    tree["duration"] = 0.5
    tree["camera"] = {
        "width": 320,
        "height": 200,
        "focal_length": [240.0, 240.0],
        "distortion": [-0.1, 0.05, 0.0, 0.0, 0.0],
        "rate": 10.0,
    }
    return read_experiment(tree | changes, "small", "small.yaml")


@pytest.fixture(scope="module")
def with_images(tmp_path_factory):
    path = tmp_path_factory.mktemp("bags") / "images"
    return path, experiment(), synthesize(experiment(), path, seed=1)


@pytest.fixture(scope="module")
def with_splines(tmp_path_factory):
    path = tmp_path_factory.mktemp("bags") / "splines"
    made = experiment(measurement={"std": 0.0004, "spacing": 0.001})
    return path, made, synthesize(made, path, seed=1, images=False)


def test_images_and_intrinsics(with_images):
    path, made, truth = with_images
    settings = Settings.load(path / "params.yaml")
    recording = read_recording(path, settings)
    assert recording.has_images and not recording.observations and not recording.skipped
    frames = list(iterate_images(path))
    assert [stamp for stamp, _, _ in frames] == list(truth.stamps)
    assert [(t - START_STAMP) / NANOSECONDS for t in truth.stamps] == [0, 0.1, 0.2, 0.3, 0.4, 0.5]
    for _, picture, info in frames:
        assert picture.shape == (200, 320, 3) and picture.std() > 3.0
        assert (info.width, info.height, info.distortion_model) == (320, 200, "plumb_bob")
        np.testing.assert_allclose(np.reshape(info.k, (3, 3)), made.camera.matrix)
        assert info.d == made.camera.distortion
    assert np.abs(frames[0][1].astype(float) - frames[-1][1]).max() > 60.0  # the rope has moved


def test_command_comes_first_and_says_what_was_imposed(with_images):
    path, made, _ = with_images
    (command,) = read_recording(path, Settings.load(path / "params.yaml")).commands
    assert command.stamp == START_STAMP and command.names == made.command.names
    np.testing.assert_allclose(command.times, made.command.times, atol=1e-9)
    np.testing.assert_allclose(command.positions, made.command.positions)
    with open_bag(path) as bag:
        logged = {c.topic: [raw.stamp for raw in bag.messages([c])] for c in bag.connections}
    assert len(logged["/dlo/command"]) == 1
    assert logged["/dlo/command"][0] < START_STAMP == min(logged["/image_raw/compressed"])
    assert logged["/camera_info"] == logged["/image_raw/compressed"]


def test_parameter_file_has_the_guess_and_truth_the_truth(with_images):
    path, made, truth = with_images
    settings = Settings.load(path / "params.yaml")
    assert (settings.rod.young_modulus, settings.rod.density) == (1e6, 2000.0)
    assert settings.rod.length == 0.4 and settings.camera == made.truth.camera
    told = yaml.safe_load((path / "truth.yaml").read_text())
    assert (told["rod"]["young_modulus"], told["rod"]["density"]) == (5e7, 2500.0)
    assert told["specific_modulus"] == 2e4 and told["damping"]["air_drag"] == 0.01
    assert told["stamps"] == list(truth.stamps)
    basis, u = SplineBasis(10, 0.4), np.linspace(0.0, 0.4, 101)
    for i, points in enumerate(told["control_points"]):
        miss = np.linalg.norm(basis.evaluate(np.array(points), u) - truth.centreline(i, u), axis=1)
        assert miss.mean() == pytest.approx(told["projection_error"][i], rel=0.1)
        assert miss.mean() < 5e-4


def test_splines_carry_the_stated_noise(with_splines):
    path, made, truth = with_splines
    recording = read_recording(path, Settings.load(path / "params.yaml"))
    assert not recording.has_images
    assert [o.stamp for o in recording.observations] == list(truth.stamps)
    basis, u = SplineBasis(10, 0.4), np.linspace(0.0, 0.4, 101)
    errors = []
    for i, observation in enumerate(recording.observations):
        points = observation.points
        assert points is not None
        np.testing.assert_allclose(points.std, 0.0004, rtol=1e-6)
        errors.append(np.linalg.norm(points.positions - truth.centreline(i, points.u), axis=1))
        spline = basis.evaluate(observation.control_points[:, :3], u)
        assert np.linalg.norm(spline - truth.centreline(i, u), axis=1).mean() < 4e-4
    rms = np.sqrt(np.mean(np.concatenate(errors) ** 2))
    assert rms == pytest.approx(made.measurement.std, rel=0.05)


@pytest.mark.slow
def test_same_seed_same_recording(with_images, with_splines, tmp_path):
    path, made, _ = with_images
    synthesize(made, tmp_path / "again", seed=1)
    synthesize(made, tmp_path / "other", seed=2)
    first, again, other = (
        np.array([picture for _, picture, _ in iterate_images(bag)])
        for bag in (path, tmp_path / "again", tmp_path / "other")
    )
    np.testing.assert_array_equal(first, again)
    assert np.mean(first != other) > 0.3
    path, made, _ = with_splines
    synthesize(made, tmp_path / "splines", seed=2, images=False)
    settings = Settings.load(path / "params.yaml")
    a, b = (
        read_recording(bag, settings).observations[0].control_points
        for bag in (path, tmp_path / "splines")
    )
    assert 1e-5 < np.abs(a - b).max() < 5e-3


def test_existing_bag_is_kept_unless_forced(with_splines):
    path, made, _ = with_splines
    before = sorted(p.name for p in path.iterdir())
    with pytest.raises(RecordingError, match="exists already"):
        synthesize(made, path, images=False)
    synthesize(made, path, seed=1, images=False, force=True)
    assert sorted(p.name for p in path.iterdir()) == before


def test_rope_out_of_sight_is_said(tmp_path, caplog):
    far = experiment(duration=0.1)
    tree = yaml.safe_load((ROOT / "config" / "experiments" / "c_shape.yaml").read_text())
    tree["parameters"]["camera"]["translation"] = [0.3, 0.0, 0.5]
    moved = read_experiment(
        tree | {"duration": 0.1, "camera": {"width": 320, "height": 200}}, "far", "far.yaml"
    )
    synthesize(far, tmp_path / "seen")
    assert "leaves the picture" not in caplog.text
    synthesize(moved, tmp_path / "unseen")
    assert "leaves the picture 0.00 s after the start" in caplog.text


def run_tool(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "dlo_ros", "synthesize", *arguments],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ,
        timeout=120,
        check=False,
    )


@pytest.mark.slow
def test_command_line(tmp_path):
    out = str(tmp_path / "bag")
    done = run_tool("approach_two", "--output", out, "--no-images", "--seed", "3")
    assert done.returncode == 0, done.stderr
    assert "61 observed splines of 'approach_two'" in done.stdout
    assert (tmp_path / "bag" / "truth.yaml").is_file()
    again = run_tool("approach_two", "--output", out, "--no-images")
    assert again.returncode == 2 and "exists already" in again.stderr
    wrong = run_tool("c_shap", "--output", str(tmp_path / "x"))
    assert wrong.returncode == 2 and "bundled experiments are" in wrong.stderr
    assert "Traceback" not in again.stderr + wrong.stderr
    assert not (tmp_path / "x").exists()
