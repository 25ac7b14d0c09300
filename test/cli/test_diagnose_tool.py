# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`diagnose` as a user types it, and how its answers are judged."""

import json
from dataclasses import replace

import numpy as np
import pytest
from challenge.evaluate import Case, compare, judge, summary
from diagnoses import KNOWN, SETUP, case, found
from measured import swing
from rods import PAPER
from tool_runs import run, write_bag

from dlo_ros.cli.diagnosis_output import tree, write_results
from dlo_ros.inference.priors import uncertain
from dlo_ros.parameters import Settings
from dlo_ros.report.force import force_arrows, force_maps
from dlo_ros.report.loads import LoadRow

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A short recording of a swinging rope and its parameter file."""
    path = tmp_path_factory.mktemp("recordings")
    write_bag(path / "one", swing(PAPER, seconds=1.0))
    KNOWN.dump(path / "params.yaml")
    return path


def test_results_are_what_the_interface_says(tmp_path):
    loads = (LoadRow("one", 0.5, 0.03, 0.6, None),)
    write_results(tmp_path / "out", KNOWN, found(), loads)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert set(report) == {
        "verdict", "effects", "noise_floor", "baseline", "extended", "gain", "candidates",
        "advice", "material_err", "remaining_err", "share", "setup", "systematic", "trace",
    }  # fmt: skip
    assert report["remaining_err"] == report["extended"]["err_holdout"]
    (effect,) = report["effects"]
    assert effect["parameters"]["curvature"] == {
        "value": [0.5, 1.0], "std": [0.01, None], "unit": "1/m"
    }  # fmt: skip
    assert effect["parameters"]["position"]["std"] is None
    assert report["baseline"]["err_holdout"] is None
    assert report["baseline"]["young_modulus"] == {"value": 1e7, "std": None}
    assert report["candidates"][1] == {"name": "none", "err_holdout": None, "score": 1e4}
    assert tree(found()) == report
    loaded = Settings.load(tmp_path / "out" / "extended.yaml")
    assert loaded.effects["intrinsic_curvature"]["curvature"] == (0.5, 1.0)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Largest loads in the recordings" in page
    for words in ("curvature at rest", "direction of a clamp", "load per length", "Turn the clamp.",
                  "A remark.", "1.0 mm off", "Inputs that the residual depends on",
                  "so does the bending of the DLO", "too slowly to be judged",
                  "missing force, the longest", "</svg>extended model</span>",
                  "</svg>plain model</span>"):  # fmt: skip
        assert words in page
    assert "http" not in page.replace("http://www.w3.org", "")


def test_a_fitted_force_is_no_known_one_in_the_extended_file(tmp_path):
    """An exact mass would tell the density to nobody's knowledge; places are exact."""
    write_results(tmp_path / "out", KNOWN, case(setup=SETUP))
    extended = Settings.load(tmp_path / "out" / "extended.yaml")
    assert extended.tolerances == {"point_mass.mass": 0.0021}
    (mass,) = uncertain(extended)
    assert mass.name == "effects.point_mass.mass"
    # A std that the parameter file states holds.
    made = case()
    stated = replace(made.extended.settings, tolerances={"point_mass.mass": 0.001})
    made = replace(made, extended=replace(made.extended, settings=stated))
    write_results(tmp_path / "again", KNOWN, made)
    assert Settings.load(tmp_path / "again" / "extended.yaml").tolerances == stated.tolerances


def test_arrows_stand_on_the_rope_where_the_force_is_sure():
    made = found()
    (view,) = made.views
    arrows, legend = force_arrows(
        view.observed, KNOWN.rod.length, view.u, view.force, view.force_std
    )
    size = np.linalg.norm(view.force, axis=2)
    longest = 0.0
    assert len(arrows) == len(view.times) and len(arrows[-1]) == 16
    for sure in arrows:
        assert np.abs(sure[:, 0, 2]).max(initial=0.0) < 1e-12  # the rope lies along x
        along = sure[:, 1] - sure[:, 0]
        assert np.allclose(along[:, 0], -along[:, 2])  # as the force does
        longest = max(longest, np.linalg.norm(along, axis=1).max(initial=0.0))
    assert longest == pytest.approx(0.2 * KNOWN.rod.length)
    assert f"{size.max():.2g}"[:3] in legend
    unsure = force_arrows(view.observed, KNOWN.rod.length, view.u, view.force, 9.0 + 0 * view.force)
    assert unsure == ([], "")
    nothing = force_maps(view.times, view.u, view.force, 9.0 + 0 * view.force)
    assert nothing.startswith("<p>No missing force") and "<img" not in nothing
    assert "<img" in force_maps(view.times, view.u, view.force, view.force_std)


def test_diagnose_says_that_a_plain_rope_is_adequate(folder, tmp_path, capsys):
    output = tmp_path / "result"
    words = ("--params", folder / "params.yaml", "--output", output, "--workers", 1)
    assert run("diagnose", *words, folder / "one") == 0
    report = json.loads((output / "report.json").read_text())
    assert report["verdict"] == "adequate"
    assert report["effects"] == []
    assert report["noise_floor"] == pytest.approx(report["extended"]["err_holdout"], rel=0.4)
    assert report["gain"]["value"] == 0.0
    assert "adequate" in capsys.readouterr().out
    assert Settings.load(output / "extended.yaml").effects == {}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--params", "{params}", "--output", "{out}", "absent"], "absent"),
        (["--params", "absent.yaml", "--output", "{out}", "{bag}"], "absent.yaml"),
        (["--params", "{params}", "--output", "{params}", "{bag}"], "is a file"),
        (["--params", "{params}", "--output", "{out}", "--holdout", "none", "{bag}"], "none"),
        (["--params", "{params}", "--output", "{out}", "--workers", "-1", "{bag}"], "--workers"),
    ],
)
def test_unusable_input_is_one_line(folder, tmp_path, capsys, words, message):
    names = {"params": folder / "params.yaml", "bag": folder / "one", "out": tmp_path / "out"}
    assert run("diagnose", *(w.format(**names) for w in words)) == 2
    err = capsys.readouterr().err.strip()
    assert message in err
    assert len(err.splitlines()) == 1


def test_a_wrong_name_is_told_from_a_right_one():
    def report(*effects, verdict="explained"):
        named = [{"name": n, "rivals": r, "parameters": {}} for n, r in effects]
        return {"verdict": verdict, "effects": named}

    assert judge({"point_mass"}, report(("point_mass", []))) == "named"
    assert judge({"point_mass"}, report(("obstacle", ["point_mass"]))) == "among rivals"
    assert judge({"point_mass"}, report(("obstacle", []))) == "wrong"
    assert judge({"point_mass"}, report(("point_mass", []), ("obstacle", []))) == "wrong"
    assert judge({"point_mass", "obstacle"}, report(("obstacle", []))) == "part"
    assert judge({"point_mass"}, report(verdict="unexplained")) == "unexplained"
    assert judge(set(), report(verdict="adequate")) == "adequate"
    assert judge(set(), report(("obstacle", []))) == "wrong"


def test_the_confusion_matrix_counts():
    parameters = {"mass": {"value": 1.3, "std": 0.1}, "position": {"value": 0.2, "std": None}}
    report = {"effects": [{"name": "point_mass", "parameters": parameters}]}
    assert compare({"point_mass": {"mass": 1.0, "position": 0.21}}, report) == (1, 2, 1)
    cases = [
        Case("single", ("point_mass",), "named", ("point_mass",), 3.0, 1.1, 1, 2, 2),
        Case("none", (), "wrong", ("obstacle",), 5.0, 1.5, 0, 0, 0),
        Case("triple", ("wall", "point_mass", "connector"), "part", ("wall",), 3.0, 1.1, 0, 0, 0),
    ]
    text = "\n".join(summary(cases))
    assert "none: nothing -> wrong: obstacle" in text
    assert "triple: wall + point_mass + connector -> part: wall" in text
    assert "1 of 2" in text
    assert "100%" in text
