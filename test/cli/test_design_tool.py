# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The tool that looks for the manipulation that separates two causes, from the command line."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from diagnoses import KNOWN, found
from rods import PAPER

from dlo_ros.cli.design_separation import named_rivals
from dlo_ros.cli.diagnosis_output import REPORT, summary, write_results
from dlo_ros.cli.main import main
from dlo_ros.parameters import Settings
from dlo_ros.synthesis.experiment import load_experiment

GIVES = {"start": 2.0}
TURNED = {"start": 0.05}


def report(path, **changes):
    """A report.json of a grip that gives, or points elsewhere."""
    cause = {
        "name": "clamp_compliance",
        "parameters": {"start": {"value": 2.0, "std": 0.1, "unit": "rad/(N m)"}},
        "rivals": ["clamp_angle"],
        "rival_values": {"clamp_angle": TURNED},
        "share": 0.9,
    }
    setup = {"camera_shift.x": {}, "intrinsic_curvature.curvature[1]": {}}
    path.write_text(json.dumps({"effects": [cause | changes], "setup": setup}))
    return path


def run(tmp_path, *words):
    params = tmp_path / "params.yaml"
    PAPER.with_effects({"clamp_compliance": GIVES}).dump(params)
    start = ["design", "--params", params, "--output", tmp_path / "out", "--tries", "3"]
    return main([str(w) for w in (*start, *words)])


def test_the_report_says_what_is_to_be_separated_and_how_large_it_is(tmp_path):
    path = report(tmp_path / "report.json")
    fitted = {
        "clamp_compliance": GIVES,
        "point_mass": {"mass": 0.01, "position": 0.2},
        "intrinsic_curvature": {"curvature": (0.1, 0.2)},
        "camera_shift": {"x": 0.001, "z": 0.002},
    }
    settings, rivals = named_rivals(PAPER.with_effects(fitted), (), path)
    assert rivals == {"clamp_compliance": GIVES, "clamp_angle": TURNED}
    # What is within its tolerance is open again; what is certain stays.
    assert settings.effects == {k: fitted[k] for k in ("clamp_compliance", "point_mass")} | {
        "camera_shift": {"z": 0.002}
    }
    _, rivals = named_rivals(PAPER, ("clamp_angle", "gravity_tilt"), path)
    assert rivals == {"clamp_angle": TURNED, "gravity_tilt": None}
    _, rivals = named_rivals(PAPER.with_effects(fitted), ("point_mass", "gravity_tilt"), None)
    assert rivals == {"point_mass": fitted["point_mass"], "gravity_tilt": None}


def test_what_diagnose_writes_names_the_rivals_and_the_command(tmp_path):
    made = found()
    (cause,) = made.effects
    made = replace(made, effects=(replace(cause, rival_values={"clamp_angle": {"end": 0.1}}),))
    output = tmp_path / "diagnosis"
    write_results(output, KNOWN, made)
    fitted, rivals = named_rivals(Settings.load(output / "extended.yaml"), (), output / REPORT)
    assert rivals == {
        "intrinsic_curvature": {"curvature": (0.5, 1.0), "position": 0.1},
        "clamp_angle": {"end": 0.1},
    }
    assert fitted.effects == made.extended.settings.effects
    assert summary(made, 0.4, Path("out"))[-2:] == [
        "  dlo_ros design --params out/extended.yaml --report out/report.json \\",
        "      --output design",
    ]
    page = (output / "report.html").read_text()
    assert "dlo_ros design --params extended.yaml --report report.json --output design" in page
    alone = replace(made, effects=(replace(cause, rivals=()),))
    assert "dlo_ros design" not in "\n".join(summary(alone, 0.4, Path("out")))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--apart", "clamp_angle", "moonlight"], "there is no effect 'moonlight'; known are"),
        (["--apart", "clamp_angle", "clamp_angle"], "--apart: clamp_angle is named twice"),
        (["--report", "alone.json", "--estimate", "estimate.json"], "--estimate counts for E and"),
        (["--report", "nowhere.json"], "nowhere.json: cannot be read"),
        (["--report", "params.yaml"], "params.yaml: is no report.json of diagnose"),
        (["--report", "alone.json"], "alone.json: names no rivals; name the effects: --apart"),
        (["--duration", "1e9"], "--duration is 1e+09 s; allowed is 0.01 to 3600 s"),
        (["--duration", "1e-3"], "--duration is 0.001 s; allowed is 0.01 to 3600 s"),
        (["--noise", "5"], "--noise is 5 m; allowed is 0 to 1 m"),
        (["--report", "strange.json"], "'clamp_angle' has no parameter 'size'"),
    ],
)
def test_what_cannot_be_used_is_refused_at_once(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    report(tmp_path / "alone.json", rivals=[])
    report(tmp_path / "strange.json", rival_values={"clamp_angle": {"size": 1.0}})
    assert run(tmp_path, *words) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_damping_that_is_only_guessed_is_no_rival(tmp_path, capsys):
    assert run(tmp_path, "--apart", "air_drag", "gravity_tilt", "simple") == 2
    assert "state damping.air_drag_std to compare it" in capsys.readouterr().err


@pytest.mark.slow
def test_the_tool_ranks_by_what_separates_two_causes(tmp_path, capsys):
    path = report(tmp_path / "report.json")
    assert run(tmp_path, "--report", path, "c_shape", "approach_two") == 0
    tree = json.loads((tmp_path / "out" / "design.json").read_text())
    shown = {e["name"]: e for e in tree["experiments"]}
    assert set(shown) == {"c_shape", "approach_two", "searched"}
    # Its ends are led by their positions alone: no clamp has a direction there.
    assert shown["approach_two"]["log_evidence"] < 0.5
    assert shown["c_shape"]["log_evidence"] > 5.0
    assert tree["apart"][0] == {"name": "clamp_compliance", "parameters": GIVES}
    load_experiment(tmp_path / "out" / "EXPERIMENT.yaml")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "It separates" in page and "It does not separate" in page and "<svg" in page
    told = capsys.readouterr().out
    assert "separates give of a grip and direction of a clamp, the largest first" in told
    assert "certain" in told


@pytest.mark.slow
def test_the_tool_says_where_nothing_separates_them(tmp_path, capsys):
    weak = {"clamp_compliance": {"start": 1e-4}}
    params = tmp_path / "weak.yaml"
    PAPER.with_effects(weak | {"clamp_angle": {"start": 1e-5}}).dump(params)
    words = ["--params", params, "--apart", "clamp_compliance", "clamp_angle", "simple"]
    assert run(tmp_path, *words) == 0
    assert "No manipulation that was tried separates give of a grip" in capsys.readouterr().out
