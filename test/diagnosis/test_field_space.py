# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The field's cases in space; `make field SPACE=1` draws as many as wanted."""

import json

import numpy as np
import pytest
from field import spatial
from field.evaluate import judge, solve
from field.nuisances import Errors

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.parameters import Settings


@pytest.fixture(scope="module")
def case():
    return spatial.draw(7300, 1, ("point_mass",))


def test_a_case_leaves_the_plane_in_everything(case, tmp_path):
    assert spatial.draw(7300, 1, ("point_mass",)) == case
    assert 4.0 <= case.ratio["point_mass"] <= 20.0
    assert all(len(v) == 3 for v in case.set_up["clamp_offset"].values())
    assert all(len(v) == 3 for v in case.set_up["clamp_angle"].values())
    assert len(case.set_up["camera_rotation"]["angle"]) == 3
    assert {"across", "angle"} == set(case.set_up["gravity_tilt"])
    bags, own = case.write(tmp_path)
    guess, length = (
        Settings.load(tmp_path / "params.yaml"),
        case.trees[0]["parameters"]["rod"]["length"],
    )
    assert not guess.effects and guess.damping != Settings().damping
    assert 2 <= len(bags) <= 3 and 0.0 < own < 0.02 * length
    for bag in bags:
        shapes = np.array([o.control_points for o in load_manipulation(bag, guess).observations])
        assert len(shapes) > 60
        assert np.ptp(shapes[:, :, 1]) > 0.05 * length
    told = json.loads((tmp_path / "case.json").read_text())
    assert list(told["causes"]) == ["point_mass"]


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


@pytest.mark.slow
def test_a_cause_in_space_is_found(case, tmp_path):
    result = solve(case, tmp_path)
    assert result.main in ("named", "rival") and not result.wrong
    assert result.share is None or result.share > 0.8
    report = json.loads((tmp_path / "diagnosis" / "report.json").read_text())
    assert judge(case, report) == (result.main, result.wrong)
