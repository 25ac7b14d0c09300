# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Hidden effects that `diagnose` has to find, in recordings of another simulator.

One of every effect, pairs and a plain rope, each in one process, so that `pytest -n` runs several:
nothing hidden in the ordinary tests, all others in the slow ones, where some go through rendered
pictures and the observer. `make challenge` draws as many as wanted.
"""

import json

import pytest
from challenge import draw
from challenge.draws import NAMED, OTHERS
from challenge.evaluate import case_of, compare, good

from dlo_ros.cli.main import main as dlo_ros

pytestmark = pytest.mark.long

CASES = {
    **{name: (7, "single", (name,)) for name in NAMED},
    **{name: (7, "foreign", (name,)) for name in OTHERS},
    "intrinsic_curvature": (1, "single", ("intrinsic_curvature",)),
    "point_mass": (1, "single", ("point_mass",)),
    "obstacle": (7106, "single", ("obstacle",)),
    **{
        name: (2001, "single", (name,))
        for name in ("quadratic_drag", "viscoelasticity", "hysteresis", "clamp_slip")
    },
    # Early enough for the beginnings, from which the ends are predicted, to show it.
    "clamp_slip at one moment": (2006, "single", ("clamp_slip",)),
    "connector": (2002, "single", ("connector",)),
    "clamp_compliance": (2003, "single", ("clamp_compliance",)),
    "gusts": (1, "foreign", ("gusts",)),
    "camera_creep": (2, "foreign", ("camera_creep",)),
    "nothing": (2, "none", ()),
    "two": (1, "pair", ("camera_scale", "command_delay")),
    "two, one of which has a double": (6, "pair", ("internal_damping", "gravity_tilt")),
}
# `test_adding_an_effect` finds something by the same ways.
ORDINARY = frozenset({"nothing"})
assert CASES.keys() >= ORDINARY
DRAUGHTS = (7, "foreign", ("gusts",))
WHIP = (7, "single", ("obstacle",))


def solved(folder, seed, kind, names, *, images=False, workers=2):
    """The challenge, and the report of the tool, which sees the bags and a parameter file only."""
    challenge = draw(seed, kind, names, recordings=2)
    bags = challenge.write(folder, images=images, edges=150, step=1e-3)
    output = folder / "diagnosis"
    words = ["diagnose", "--params", folder / "params.yaml", "--output", output]
    assert dlo_ros([str(w) for w in [*words, "--workers", workers, *bags]]) == 0
    return challenge, json.loads((output / "report.json").read_text())


def named(challenge, report):
    """Whether what was hidden is found."""
    case = case_of(challenge, report, 0.0)
    assert good(case), (case.outcome, report["effects"], report["candidates"][:4])


def held(challenge, report):
    """Whether what was hidden is found, with its numbers, and pays."""
    named(challenge, report)
    missed, count, _ = compare(challenge.effects, report)
    assert missed <= count // 2
    if report["effects"]:
        assert report["gain"]["low"] > 0.1
        assert report["extended"]["err_holdout"] < 1.5 * report["noise_floor"]
    for e in report["effects"]:  # a tilt of gravity is a force that acts evenly
        if e["name"] == "gravity_tilt":
            assert "constant_force" in e["rivals"]


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=() if c in ORDINARY else pytest.mark.slow) for c in CASES]
)
def test_what_was_hidden_is_found(tmp_path, case):
    held(*solved(tmp_path, *CASES[case], workers=1))


@pytest.mark.slow
def test_draughts_on_heavy_ropes_are_none_of_the_causes(tmp_path):
    held(*solved(tmp_path, *DRAUGHTS))


@pytest.mark.slow
def test_a_peg_is_found_round_which_the_rope_whips(tmp_path):
    """From places near it the rope whips otherwise, until one is fitted. What has not been seen yet
    of a whip hangs on less than the peg's std.
    """
    challenge, report = solved(tmp_path, *WHIP)
    named(challenge, report)
    assert compare(challenge.effects, report)[:2] == (0, 3)
    assert report["gain"]["low"] > 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    # A clamp that is 6 degrees off, and a curvature of 3 1/m: within 3 and 1, any set-up may be.
    [("intrinsic_curvature", 10), ("clamp_angle", 13), ("point_mass", 5), ("nothing", 5)],
)
def test_pictures_do_as_well(tmp_path, name, seed):
    """Rendered frames, from which the observer makes the shapes."""
    kind, names = ("none", ()) if name == "nothing" else ("single", (name,))
    named(*solved(tmp_path, seed, kind, names, images=True))
