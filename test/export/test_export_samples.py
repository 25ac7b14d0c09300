# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Plausible cables of `export --sample`: each in its own shape, held by its own grips."""

import json
import re
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import yaml
from cables import ROD
from scipy.spatial.transform import Rotation

from dlo_ros.cli import export
from dlo_ros.cli.main import main
from dlo_ros.errors import InputError
from dlo_ros.export import mujoco_run
from dlo_ros.export.draws import draw, read_knowledge
from dlo_ros.export.fidelity import another_chain
from dlo_ros.export.scenes import standard_scene
from dlo_ros.parameters import Settings


@pytest.mark.parametrize("young_modulus", [2.5e9, 1e10])
def test_a_cable_sags_by_its_own_stiffness(young_modulus):
    """By the closed form w L^4 / (8 B) of a stiff level cantilever."""
    scene = standard_scene(Settings(replace(ROD, young_modulus=5e9)))
    rod = replace(ROD, young_modulus=young_modulus)
    last = another_chain(scene, Settings(rod), 40).poses[-1]
    tip = last.position + last.rotation.apply([0.5 * ROD.length / 40, 0.0, 0.0])
    sag = rod.linear_density * 9.81 * ROD.length**4 / (8.0 * rod.bending_stiffness)
    assert np.isclose(-tip[2], sag, rtol=0.01)


@pytest.fixture
def samples(tmp_path, monkeypatch, capsys):
    """Exports plausible cables of an effect: exit status, messages and the files' texts."""
    monkeypatch.setattr(mujoco_run, "installed", lambda: None)

    def exported(effects, count):
        params = tmp_path / "params.yaml"
        Settings(ROD).dump(params)
        tree = yaml.safe_load(params.read_text())
        tree["/**"]["ros__parameters"]["effects"] = effects
        params.write_text(yaml.safe_dump(tree))
        call = ["export", "--params", str(params), "--format", "mjcf-chain", "--sample", str(count)]
        status = main([*call, "--output", str(tmp_path / "cable.xml")])
        told = capsys.readouterr()
        return status, told.err, [p.read_text() for p in sorted(tmp_path.glob("cable_*.xml"))]

    return exported


def test_the_grip_holds_a_cable_at_the_angle_that_was_drawn(samples):
    status, _, texts = samples({"clamp_angle": {"start": 0.1, "start_std": 0.2}}, 4)
    assert status == 0 and len(texts) == 4
    for text in texts:
        drawn = float(re.search(r"direction of a clamp.*: start (\S+)", text)[1])
        assert abs(drawn - 0.1) > 0.005
        for part in ('site name="grip_start"', 'body name="link_0"'):
            quaternion = re.search(f'<{part} pos="[^"]*" quat="([^"]*)"', text)[1].split()
            turn = Rotation.from_quat(np.array(quaternion, float), scalar_first=True)
            assert np.isclose(turn.as_rotvec()[1], drawn, atol=2e-4)


def test_each_of_several_numbers_of_an_estimate_is_drawn(tmp_path):
    estimate = tmp_path / "estimate.json"
    setup = {"intrinsic_curvature.curvature[1]": {"value": 2.0, "std": 0.5},
             "gravity_tilt.angle": {"value": 0.1, "std": 0.01}}  # fmt: skip
    tree = {"information": {"matrix": np.eye(4).tolist()}, "setup": setup}
    estimate.write_text(json.dumps(tree))
    settings = Settings(ROD).with_effects(
        {"intrinsic_curvature": {"curvature": (1.0, 2.0, 3.0)}, "gravity_tilt": {"angle": 0.1}}
    )
    known = read_knowledge(settings, estimate)
    drawn = np.array(
        [c.effects["intrinsic_curvature"]["curvature"] for c in islice(draw(settings, known), 200)]
    )
    assert np.all(drawn[:, [0, 2]] == [1.0, 3.0])  # nobody knows how well
    assert drawn[:, 1].mean() == pytest.approx(2.0, abs=0.15)
    assert drawn[:, 1].std() == pytest.approx(0.5, rel=0.2)


def test_impossible_cables_are_drawn_again(samples):
    """Half of the draws have the mass beyond the DLO's end."""
    values = {"mass": 0.01, "position": 0.39, "position_std": 0.05}
    status, _, texts = samples({"point_mass": values}, 6)
    places = [float(re.search(r"mass on the DLO: .*position (\S+)", t)[1]) for t in texts]
    assert status == 0 and len(places) == 6 and max(places) <= ROD.length
    assert len(set(places)) == 6


def test_where_hardly_any_cable_is_possible_it_is_told(samples, monkeypatch):
    def impossible(*_):
        raise InputError("the grips are further apart than it is long")

    monkeypatch.setattr(export, "another_chain", impossible)
    status, told, texts = samples({"point_mass": {"mass": 0.01, "position": 0.3}}, 6)
    assert status == 2 and told.count("\n") == 1 and not texts
    assert "--sample: 100 cables" in told and "apart than it is long; state smaller" in told
