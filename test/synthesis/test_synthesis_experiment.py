# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Experiment files and the true motion that they describe."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from dlo_ros.errors import InputError
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.experiment import (
    START_STAMP,
    find_experiment,
    load_experiment,
    read_experiment,
)
from dlo_ros.synthesis.true_motion import build_simulation, project, simulate

FOLDER = Path(__file__).resolve().parents[2] / "config" / "experiments"
NAMES = ("simple", "different", "c_shape", "approach_two", "approach_four")


def tree(name: str = "c_shape") -> dict:
    return yaml.safe_load((FOLDER / f"{name}.yaml").read_text())


def read(changed: dict):
    return read_experiment(changed, "test", "test.yaml")


def run(experiment):
    """The motion, coarser than in a recording: some hundredths of a millimetre off."""
    simulation, _ = build_simulation(experiment, edges=100, step=4e-3)
    return simulate(simulation, experiment.stamps)


@pytest.fixture(scope="module")
def truths():
    result = {}
    for name in NAMES:
        experiment = load_experiment(FOLDER / f"{name}.yaml")
        result[name] = experiment, run(experiment)
    return result


@pytest.mark.parametrize("name", NAMES)
def test_bundled_experiments_are_those_of_the_paper(name, truths):
    experiment, truth = truths[name]
    rod, short = experiment.truth.rod, not name.startswith("approach")
    assert (rod.young_modulus, rod.density) == (5e7, 2500.0)
    assert (rod.length, rod.diameter) == ((0.4, 0.004) if short else (0.8, 0.008))
    assert experiment.guess.rod.young_modulus < 5e7 and experiment.guess.rod.density == 2000.0
    assert truth.stamps[0] == START_STAMP
    assert truth.stamps[-1] - START_STAMP == (3_000_000_000 if short else 2_000_000_000)
    command = experiment.command
    for i, stamp in enumerate(truth.stamps):
        positions, _ = command.sample(stamp)
        at = dict(zip(command.names, positions, strict=True))
        ends = truth.centreline(i, np.array([0.0, rod.length]))
        np.testing.assert_allclose(ends[0], at["control_point_1"], atol=1e-12)
        np.testing.assert_allclose(ends[1], at["control_point_10"], atol=1e-12)
        if "control_point_2" in at:
            start = truth.centreline(i, np.array([0.0, 1e-4]))
            direction = (start[1] - start[0]) / np.linalg.norm(start[1] - start[0])
            wanted = at["control_point_2"] - at["control_point_1"]
            np.testing.assert_allclose(direction, wanted / np.linalg.norm(wanted), atol=0.02)
    moving = np.abs(truth.velocities).max(axis=(1, 2))
    assert moving[0] == 0.0 and moving[10] > 0.05


def test_motion_is_steady_between_images_and_mirrors(truths):
    """Both ends approach alike, so the rope stays a mirror image of itself."""
    for name in ("approach_two", "approach_four"):
        _, truth = truths[name]
        mirrored = truth.nodes[:, ::-1] * np.array([-1.0, 1.0])
        np.testing.assert_allclose(truth.nodes, mirrored, atol=1e-6)


def test_c_shape_tells_the_stiffness_as_in_the_paper(truths):
    """ERR falls as E goes 1e6, 3e6, 5e7 (Table IV), most of all on the C shape."""
    final = {}
    for name in ("simple", "different", "c_shape"):
        experiment, truth = truths[name]
        for young_modulus, density in ((1e6, 2000.0), (3e6, 2000.0), (5e7, 2000.0)):
            other = replace(
                experiment, truth=experiment.truth.with_material(young_modulus, density)
            )
            guess = run(other)
            final[name, young_modulus] = np.linalg.norm(
                guess.nodes[-1] - truth.nodes[-1], axis=1
            ).mean()
    for name in ("simple", "different", "c_shape"):
        assert final[name, 1e6] > 1.2 * final[name, 3e6] > 5.0 * final[name, 5e7]
    assert final["c_shape", 3e6] > 0.1 * 0.4
    assert final["simple", 3e6] < 0.03 * 0.4


def test_clamp_given_as_frame_equals_two_control_points():
    points = read(tree())
    changed = tree()
    del changed["motion"]["control_point_2"], changed["motion"]["control_point_1"]
    hold = {"time": 0.0, "position": [0.14, 0.0, 0.04], "angle": np.pi}
    changed["motion"]["start"] = [hold]
    stamps = points.stamps[:4]
    a = simulate(build_simulation(points)[0], stamps)
    b = simulate(build_simulation(read(changed))[0], stamps)
    np.testing.assert_allclose(a.nodes, b.nodes, atol=1e-9)


def test_control_point_within_the_rope_is_a_pin_at_its_greville_abscissa():
    changed = tree()
    changed["motion"]["control_point_5"] = [
        {"time": 0.0, "position": [0.0, 0.0, -0.05]},
        {"time": 1.0, "position": [0.01, 0.0, -0.04]},
    ]
    experiment = read(changed)
    truth = simulate(build_simulation(experiment)[0], experiment.stamps[:16])
    greville = SplineBasis(10, 0.4).greville[4]
    held = truth.centreline(15, np.array([greville]))[0]
    np.testing.assert_allclose(held, [0.005, 0.0, -0.045], atol=1e-9)


def test_turning_clamp_is_sampled_the_way_it_turns():
    changed = tree()
    changed["motion"] = {
        "start": [
            {"time": 0.0, "position": [0.0, 0.0, 0.0], "angle": 0.0},
            {"time": 2.0, "position": [0.0, 0.0, 0.0], "angle": 6.0},
        ]
    }
    command = read(changed).command
    for t in (0.3, 1.0, 1.7):
        _, rotation = command.sample(START_STAMP + round(t * 1e9))
        angle = 2.0 * np.arctan2(rotation[0, 1], rotation[0, 3])
        assert np.cos(angle - 3.0 * t) == pytest.approx(1.0, abs=1e-12)


def test_projection_keeps_ends_and_is_exact_for_splines():
    basis = SplineBasis(10, 0.4)
    q = np.random.default_rng(3).normal(0.0, 0.1, (10, 3))
    np.testing.assert_allclose(project(basis, lambda u: basis.evaluate(q, u)), q, atol=1e-10)
    bent = project(basis, lambda u: np.column_stack([u, np.zeros_like(u), np.sin(30.0 * u)]))
    np.testing.assert_allclose(bent[[0, -1], 2], [0.0, np.sin(12.0)], atol=1e-12)


def put(path: str, value: object):
    def change(t: dict) -> None:
        *groups, key = path.split("/")
        for group in groups:
            t = t[int(group)] if isinstance(t, list) else t[group]
        if value is None:
            del t[key]
        else:
            t[key] = value

    return change


BAD = [
    (put("duration", "long"), "duration is 'long'; give a number"),
    (put("duration", -1.0), "duration is -1; allowed"),
    (put("colour", 3), "'colour' is unknown; known are .*camera"),
    (put("parameters", None), "'parameters' is missing"),
    (put("parameters/rod/length", None), "rod.length is missing"),
    (put("parameters/rod/lenght", 0.4), "'rod.lenght' is no parameter"),
    (put("guess/rod/density", -5.0), "rod.density is -5"),
    (put("initial_shape", None), "'initial_shape' is missing"),
    (put("initial_shape", [[0.0, 0.0]]), "initial_shape must be a list of at least two"),
    (put("initial_shape", [[0.0, 0.0], [1.0]]), "initial_shape is .*give 2 numbers"),
    (put("motion", {}), "names nothing"),
    (put("motion/gripper", [{"time": 0.0, "position": [0, 0, 0]}]), "known are start, end"),
    (put("motion/control_point_1", []), "control_point_1 must be a list"),
    (put("initial_shape", [[0.0, 0.0, 0.1], [1.0, 0.0]]), "initial_shape is .*give 3 numbers"),
    (put("motion/control_point_1/0/position", [0.1, 0.0]), "position is .*give 3 numbers"),
    (put("motion/control_point_10/1/time", 0.0), "times of control_point_10 must grow"),
    (put("motion/control_point_10/1/position", [-0.3, 0.0, 0.04]), "ends are 0.440 m apart"),
    (put("motion/control_point_1", None), "control_point_2 without control_point_1"),
    (put("motion/end", [{"time": 0.0, "position": [0, 0, 0]}]), "'angle' is missing"),
    (put("camera/distortion", [0.1, 0.2]), "distortion is .*give 5 numbers"),
    (put("camera/distortion_model", "fisheye"), "plumb_bob or rational_polynomial"),
    (put("camera/width", 640.5), "width is 640.5; it must be a whole number"),
    (put("look", {"rope_color": [1, 2, 3]}), "'rope_color' is unknown"),
    (put("look", 7), "look is 7; it must be a block"),
    (put("measurement", {"std": float("nan")}), "std is nan"),
]


@pytest.mark.parametrize(("change", "message"), BAD, ids=[m for _, m in BAD])
def test_bad_experiments_say_what_is_wrong(change, message):
    changed = copy.deepcopy(tree())
    change(changed)
    with pytest.raises(InputError, match=message) as raised:
        read(changed)
    assert str(raised.value).startswith("test.yaml") and "\n" not in str(raised.value)


def test_unreadable_files(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        load_experiment(tmp_path / "none.yaml")
    (tmp_path / "bad.yaml").write_text("a: [1, 2")
    with pytest.raises(InputError, match="no valid YAML"):
        load_experiment(tmp_path / "bad.yaml")
    (tmp_path / "list.yaml").write_text("- 1\n")
    with pytest.raises(InputError, match="must be a block"):
        load_experiment(tmp_path / "list.yaml")
    with pytest.raises(InputError, match="bundled experiments are approach_four"):
        find_experiment("nonsense")
    assert find_experiment("simple").name == "simple.yaml"
