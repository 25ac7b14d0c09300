# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The field's cases in space; `make field SPACE=1` draws as many as wanted."""

import numpy as np
import pytest
from challenge import manipulations
from challenge.draws import Scene
from challenge.residual import changed
from field import spatial
from field.evaluate import judge, solve
from field.generate import Case
from field.nuisances import Errors

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.parameters import Settings

SCENE = Scene(0.4, 0.3, 12.0, 0.03, 0.01, 0.012, True, True, ())


def test_a_case_leaves_the_plane(tmp_path):
    rng = np.random.default_rng(3)
    trees = spatial.recordings(rng, [manipulations.u_shape(rng)])
    length = trees[0]["parameters"]["rod"]["length"]
    set_up = spatial.set_up_in_space(rng, length, ("start", "end"))
    tree = changed(trees[0], set_up, {}) | {"duration": 0.4}
    case = Case(3, {"clamp_slip": {}}, set_up, {}, ("u_shape",), (tree,))
    (bag,), own = case.write(tmp_path)
    guess = Settings.load(tmp_path / "params.yaml")
    assert not guess.effects and 0.0 < own < 0.02 * length
    seen = load_manipulation(bag, guess).observations
    shapes = np.array([o.control_points for o in seen])
    assert 8 <= len(shapes) <= 11 and np.ptp(shapes[:, :, 1]) > 0.05 * length


def test_causes_act_in_any_direction():
    rng = np.random.default_rng(4)
    for name, blocks in (
        ("clamp_angle", 3), ("camera_rotation", 3), ("gravity_tilt", 2), ("constant_force", 3)
    ):  # fmt: skip
        drawn = [spatial.CAUSES[name](rng, SCENE) for _ in range(20)]
        flat = [np.concatenate([np.ravel(v) for v in d.values(d.upper).values()]) for d in drawn]
        assert all(len(row) == blocks for row in flat)
        assert np.linalg.norm(flat, axis=1) == pytest.approx(np.linalg.norm(flat[0]), rel=1e-9)
        assert (np.std(flat, axis=0) > 0.3 * np.std(flat)).all()
    values = [spatial.CAUSES["intrinsic_curvature"](rng, SCENE).values(1.0) for _ in range(20)]
    assert any("across" in v for v in values) and any("kink" in v for v in values)
    assert not {"plasticity", "obstacle"} & set(spatial.CAUSES)


def test_each_coordinate_is_measured_wrongly_by_itself():
    rng = np.random.default_rng(0)
    u = np.linspace(0.0, 1.0, 10)
    shapes = np.zeros((400, 10, 3))
    shapes[:, :, 0] = 0.5 * u
    errors = Errors.drawn(rng, u, 0.5, (0, 1, 2))
    missed = errors.of(rng, shapes, u, free=False)[0] - shapes
    lasting = np.median(missed, axis=0)
    assert lasting == pytest.approx(errors.fixed, abs=1e-4)
    fading = (missed - lasting)[:, 4]
    assert np.median(np.abs(fading), axis=0) / 0.6745 == pytest.approx([3e-4] * 3, rel=0.15)
    assert np.abs(np.corrcoef(np.clip(fading, -1e-3, 1e-3).T) - np.eye(3)).max() < 0.2


def test_a_set_up_has_errors_in_all_directions():
    rng = np.random.default_rng(1)
    drawn = [spatial.set_up_in_space(rng, 0.5, ("start",)) for _ in range(300)]
    for name, key, size in (
        ("clamp_angle", "start", 3.0), ("camera_rotation", "angle", 0.5),
        ("gravity_tilt", "across", 1.0),
    ):  # fmt: skip
        spread = np.std([d[name][key] for d in drawn], axis=0)
        assert spread == pytest.approx(np.full_like(spread, np.deg2rad(size)), rel=0.2)
    assert np.std([d["clamp_offset"]["start"][1] for d in drawn]) == pytest.approx(2.5e-3, rel=0.2)


def test_what_is_off_beyond_its_tolerance_is_no_wrong_name():
    rng = np.random.default_rng(6)
    tree = {"parameters": {"rod": {"length": 0.5}}, "guess": {"damping": {}}}
    tree["parameters"]["damping"] = dict.fromkeys(("air_drag", "relaxation_time"), 0.1)
    tree["guess"]["damping"] = dict(tree["parameters"]["damping"])
    set_up = spatial.set_up_in_space(rng, 0.5, ("start", "end"))

    def named(ratio):
        twisting = {"twisting_stiffness": {"ratio": ratio}}
        report = {"effects": [{"name": "twisting_stiffness", "rivals": []}]}
        return judge(Case(6, {}, set_up | twisting, {}, ("u_shape",), (tree,)), report)[1]

    assert named(np.exp(0.6)) == ("twisting_stiffness",)
    assert named(np.exp(-0.8)) == named(np.exp(0.8)) == ()


@pytest.mark.slow
def test_a_cause_in_space_is_found(tmp_path):
    case = spatial.draw(7300, 1, ("point_mass",))
    assert spatial.draw(7300, 1, ("point_mass",)) == case
    assert 4.0 <= case.ratio["point_mass"] <= 20.0
    result = solve(case, tmp_path)
    assert result.main in ("named", "rival") and not result.wrong
    assert result.share is None or result.share > 0.8
