# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""E/mu from a motion in space with twist, simulated by the independent rod."""

import numpy as np
import pytest
import yaml
from ordinary import some_of

from dlo_ros.cli.identify_results import remarks
from dlo_ros.cli.loading import load_manipulation
from dlo_ros.diagnosis import diagnose
from dlo_ros.identification import identify
from dlo_ros.inference.scene import scene
from dlo_ros.parameters import Settings
from dlo_ros.synthesis.experiment import find_experiment, read_experiment
from dlo_ros.synthesis.synthesize import synthesize

pytestmark = pytest.mark.long


def recorded(folder, factor, effects, seconds):
    """A recording of the independent rod, and its experiment: the guess of E is off by a factor."""
    tree = yaml.safe_load(find_experiment("twisted").read_text())
    true = tree["parameters"]["rod"]["young_modulus"]
    tree["guess"] = {"rod": {"young_modulus": factor * true, "density": 2000.0}}
    tree["parameters"]["effects"] = effects
    made = read_experiment(tree | {"duration": seconds}, "space", "space.yaml")
    synthesize(made, folder / "bag", images=False, edges=60, step=4e-3)
    return load_manipulation(folder / "bag", made.guess), made


@pytest.mark.parametrize("factor", some_of([1.0 / 30.0, 30.0], [30.0]))
def test_the_ratio_is_found_from_thirty_times_off(factor, tmp_path):
    recording, made = recorded(tmp_path, factor, {}, 1.5)
    found = identify([recording], made.guess).estimate
    ratio = made.truth.rod.specific_modulus
    assert found.specific_modulus == pytest.approx(ratio, rel=0.02)
    assert abs(found.specific_modulus - ratio) < 4.0 * found.specific_modulus_std
    assert found.density_std is None  # a motion alone tells E/mu


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.4, 2.5])
def test_a_twisting_stiffness_is_told_where_a_turned_clamp_tells_it(ratio, tmp_path):
    effects = {"twisting_stiffness": {"ratio": ratio}}
    recording, made = recorded(tmp_path, 3.0, effects, 2.0)
    found = identify([recording], made.guess)
    told, std = found.fitted.set_up["effects.twisting_stiffness.ratio"]
    assert told == pytest.approx(ratio, rel=0.03)
    assert abs(told - ratio) < 3.0 * std < 0.15 * ratio
    true = made.truth.rod.specific_modulus
    assert found.estimate.specific_modulus == pytest.approx(true, rel=0.02)


@pytest.mark.slow
def test_a_free_end_tells_no_twisting_stiffness(tmp_path):
    """A rope that is not held at its end untwists, whatever the stiffness."""
    tree = yaml.safe_load(find_experiment("simple").read_text())
    tree["guess"] = {"rod": {"young_modulus": 5e7, "density": 2000.0}}
    tree["motion"]["control_point_10"][1]["position"][1] = 0.08  # its end is led, and not turned
    tree["parameters"]["effects"] = {
        "clamp_angle": {"start": [0.04, 0.0, 0.04]},
        "twisting_stiffness": {"ratio": 0.5},
    }
    made = read_experiment(tree | {"duration": 1.5}, "free", "free.yaml")
    synthesize(made, tmp_path / "bag", images=False, edges=60, step=4e-3)
    found = identify([load_manipulation(tmp_path / "bag", made.guess)], made.guess)
    told, std = found.fitted.set_up["effects.twisting_stiffness.ratio"]
    assert std > 0.3 * told
    assert not any("twisting" in line for line in remarks(found))


@pytest.mark.slow
def test_a_set_up_that_is_off_in_space_is_found_with_it(tmp_path):
    off = {
        "clamp_angle": {"start": [0.05, 0.03, -0.04], "end": [0.02, -0.04, 0.03]},
        "camera_rotation": {"angle": [0.005, 0.01, -0.006]},
        "gravity_tilt": {"angle": 0.01, "across": 0.02},
    }
    recording, made = recorded(tmp_path, 3.0, off, 3.0)
    found = identify([recording], made.guess)
    assert found.estimate.specific_modulus == pytest.approx(
        made.truth.rod.specific_modulus, rel=0.02
    )
    for name, true in (("clamp_angle.end", off["clamp_angle"]["end"]),
                       ("camera_rotation.angle", off["camera_rotation"]["angle"])):  # fmt: skip
        for k, value in enumerate(true):
            told, std = found.fitted.set_up[f"effects.{name}[{k}]"]
            assert abs(told - value) < max(3.0 * std, 0.002)


@pytest.mark.parametrize(("aside", "spatial"), [(0.0, False), (0.003, False), (0.03, True)])
def test_shapes_out_of_the_board_s_plane_make_a_scene_in_space(aside, spatial):
    rod = {"length": 0.4, "diameter": 0.004, "young_modulus": 1e7, "density": 2000.0}
    settings = Settings.from_mapping({f"rod.{name}": value for name, value in rod.items()})
    n = settings.rod.control_points
    shapes = np.zeros((20, n, 4))
    shapes[..., 0] = np.linspace(0.0, 0.4, n)
    shapes[..., 2] = -0.1 * np.sin(np.linspace(0.0, 3.0, n))
    shapes[..., 1] = np.random.default_rng(0).normal(0.0, aside, (20, n))
    assert scene(settings, ["start"], [shapes]).spatial == spatial


@pytest.mark.slow
def test_a_rope_held_beside_where_turning_hands_say_is_found(tmp_path):
    """As the mounting of a robot's grips is off; the delay of the camera is told beside it."""
    tree = yaml.safe_load(find_experiment("two_grippers").read_text())
    off = {"start": [0.003, -0.002, 0.002], "end": [0.0, 0.0, 0.0]}
    tree["parameters"]["effects"] = {"grip_offset": {"start": off["start"]}}
    made = read_experiment(tree | {"duration": 1.5}, "space", "space.yaml")
    synthesize(made, tmp_path / "bag", seed=31, images=False, edges=60, step=4e-3)
    given = Settings.load(tmp_path / "bag" / "params.yaml")
    assert given.command.source == "tf"
    recording = load_manipulation(tmp_path / "bag", given)
    found = identify([recording], given)
    ratio, told = made.truth.rod.specific_modulus, found.estimate
    assert told.specific_modulus == pytest.approx(ratio, rel=0.02)
    assert abs(told.specific_modulus - ratio) < 2.0 * told.specific_modulus_std
    for end, offset in off.items():
        for k, true in enumerate(offset):
            value, std = found.fitted.set_up[f"effects.grip_offset.{end}[{k}]"]
            assert std < 1e-3 and abs(value - true) < 3.0 * std
    delay, std = found.fitted.set_up["effects.command_delay.delay"]
    assert abs(delay) < max(3.0 * std, 1e-3) and 0.0 < std < 1e-3
    diagnosis = diagnose([recording], given)
    assert [e.name for e in diagnosis.effects] == ["grip_offset"]
    assert diagnosis.verdict == "adequate" and not diagnosis.effects[0].rivals
    numbers = diagnosis.effects[0].parameters
    assert numbers["start"].value == pytest.approx(off["start"], abs=2e-4)


@pytest.mark.slow
def test_hands_that_do_not_turn_do_not_separate_the_axes(tmp_path):
    """An offset in the hand is then one along the board's axes, and the std of both says so."""
    tree = yaml.safe_load(find_experiment("two_grippers").read_text())
    for points in tree["motion"].values():
        for point in points:
            point.update({key: points[0].get(key, 0.0) for key in ("angle", "swing", "turn")})
    tree["parameters"]["effects"] = {"grip_offset": {"start": [0.003, -0.002, 0.002]}}
    made = read_experiment(tree | {"duration": 1.5}, "space", "space.yaml")
    synthesize(made, tmp_path / "bag", seed=32, images=False, edges=60, step=4e-3)
    given = Settings.load(tmp_path / "bag" / "params.yaml")
    found = identify([load_manipulation(tmp_path / "bag", given)], given)
    ratio = made.truth.rod.specific_modulus
    assert found.estimate.specific_modulus == pytest.approx(ratio, rel=0.02)
    for end in ("start", "end"):
        for k in range(3):
            for effect in ("grip_offset", "clamp_offset"):
                value, std = found.fitted.set_up[f"effects.{effect}.{end}[{k}]"]
                assert abs(value) < 3.0 * std and std > 1e-3
