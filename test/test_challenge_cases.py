# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Hidden effects that `diagnose` has to find, in recordings of another simulator.

A few in the ordinary tests; one of every effect, and some through rendered pictures and the
observer, in the slow ones. `make challenge` draws as many as wanted.
"""

import json

import pytest
from challenge import draw
from challenge.draws import NAMED, OTHERS
from challenge.evaluate import compare, good, judge

from dlo_ros.cli.main import main as dlo_ros

QUICK = {
    "curved at rest": (1, "single", ("intrinsic_curvature",)),
    "draughts": (1, "foreign", ("gusts",)),
    "nothing": (2, "none", ()),
    "two": (1, "pair", ("camera_scale", "command_delay")),
    "two, one of which has a double": (1, "pair", ("internal_damping", "gravity_tilt")),
}


def solved(folder, seed, kind, names, *, images=False):
    """The challenge, and the report of the tool, which sees the bags and a parameter file only."""
    challenge = draw(seed, kind, names, recordings=2)
    bags = challenge.write(folder, images=images, edges=150, step=1e-3)
    output = folder / "diagnosis"
    words = ["diagnose", "--params", folder / "params.yaml", "--output", output, *bags]
    assert dlo_ros([str(w) for w in words]) == 0
    return challenge, json.loads((output / "report.json").read_text())


@pytest.mark.parametrize("case", QUICK)
def test_what_was_hidden_is_found(tmp_path, case):
    challenge, report = solved(tmp_path, *QUICK[case])
    outcome = judge(set(challenge.effects), report)
    assert good(challenge.kind, outcome), (outcome, report["effects"], report["candidates"][:4])
    if report["effects"]:
        assert report["gain"]["low"] > 0.1
        assert report["extended"]["err_holdout"] < 1.5 * report["noise_floor"]
    for e in report["effects"]:  # a tilt of gravity is a force that acts evenly
        if e["name"] == "gravity_tilt":
            assert "constant_force" in e["rivals"]


@pytest.mark.slow
@pytest.mark.parametrize("name", [*NAMED, *OTHERS])
def test_every_effect_is_found(tmp_path, name):
    kind = "foreign" if name in OTHERS else "single"
    challenge, report = solved(tmp_path, 7, kind, (name,))
    outcome = judge(set(challenge.effects), report)
    assert good(kind, outcome), (outcome, report["effects"], report["candidates"][:4])
    missed, count = compare(challenge.effects, report)
    assert missed <= count // 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["intrinsic_curvature", "clamp_angle", "point_mass", "nothing"])
def test_pictures_do_as_well(tmp_path, name):
    """Rendered frames, from which the observer makes the shapes."""
    kind, names = ("none", ()) if name == "nothing" else ("single", (name,))
    challenge, report = solved(tmp_path, 5, kind, names, images=True)
    outcome = judge(set(challenge.effects), report)
    assert good(kind, outcome), (outcome, report["effects"], report["candidates"][:4])
