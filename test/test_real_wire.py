# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The measured wire that ships: its coordinates become bags, and `make real` explains them."""

import importlib
import json
import sys

import cv2
import numpy as np
import pytest
from conftest import ROOT

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.errors import InputError
from dlo_ros.inference.forecast import forecast
from dlo_ros.parameters import Settings
from dlo_ros.recordings.read import read_recording
from dlo_ros.spline import SplineBasis

FOLDER = ROOT / "examples" / "real_wire"
WIRE = FOLDER / "white"
LEFT_OVER = 1.1e-3
"""[m], mean distance of the measured points from their spline: clicks are no better."""


@pytest.fixture
def example(monkeypatch):
    """A function that gives a module of the example."""
    monkeypatch.syspath_prepend(str(FOLDER))
    yield importlib.import_module
    for name in ("convert", "real"):
        sys.modules.pop(name, None)


@pytest.fixture
def settings():
    return Settings.load(WIRE / "params.yaml")


@pytest.mark.parametrize("trial", ["trial0", "trial1", "trial2"])
def test_the_bag_holds_the_measured_shape(example, settings, tmp_path, trial):
    convert = example("convert")
    convert.convert(WIRE, trial, settings, tmp_path / trial)
    found = read_recording(tmp_path / trial, settings)
    assert not found.skipped
    (observed,), (command,) = found.observations, found.commands
    u, points = convert.read_points(WIRE / f"{trial}.csv")
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    shape = basis.evaluate(observed.control_points[:, :3], u)
    assert np.linalg.norm(shape - points, axis=1).mean() < LEFT_OVER
    # Both clamps are level, 123 mm apart; the wire leaves to the right, and comes back so.
    assert command.names == ("start", "end")
    start, end = command.positions[0]
    assert np.allclose(start, 0.0) and np.linalg.norm(end - start) == pytest.approx(0.123, abs=2e-3)
    assert np.allclose(command.rotations[0], [0.0, 0.0, 0.0, 1.0])
    assert np.linalg.norm(points[0] - start) < 5e-3 and np.linalg.norm(points[-1] - end) < 5e-3


def test_a_tilted_clamp_points_as_its_tangent(example, settings, tmp_path):
    text = "trial,end,x_m,z_m,tangent_x,tangent_z\na,start,0,0,0,-1\na,end,1,0,1,0\n"
    (tmp_path / "clamps.csv").write_text(text)
    command = example("convert").clamps(tmp_path / "clamps.csv", "a", settings)
    x, y, z, w = command.rotations[0, 0]
    axis = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)]
    assert np.allclose(axis, [0.0, 0.0, -1.0])


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("trial0.csv", None, "cannot be read"),
        ("trial0.csv", "u,x,z\n0,0,0\n", "its first line has no u_m, x_m, z_m"),
        ("trial0.csv", "u_m,x_m,z_m\n0,0,0\n1.5,one,0\n", "line 3: x_m is 'one', no number"),
        ("trial0.csv", "u_m,x_m,z_m\n0,0,0\n.5,0,0\n1,0,0\n1.2,0,0\n", "u ends at 1.2 m"),
        ("clamps.csv", "trial,end,x_m,z_m,tangent_x,tangent_z\n", "has no line but the first"),
    ],
)
def test_what_is_no_measurement_is_refused(example, settings, tmp_path, name, text, words):
    for file in WIRE.glob("*.csv"):
        (tmp_path / file.name).write_text(file.read_text())
    if text is None:
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        example("convert").convert(tmp_path, "trial0", settings, tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_the_measurement_comes_with_its_licence_and_source():
    licence = (WIRE / "LICENSE_MIT_adapteddlo_muj.txt").read_text()
    assert "MIT License" in licence and "Copyright (c) 2024 qjchen" in licence
    text = (FOLDER / "README.md").read_text()
    assert "qj25/adapteddlo_muj" in text and "arXiv 2310.00911" in text
    assert not [p for p in FOLDER.rglob("*") if p.suffix in (".jpg", ".jpeg", ".mcap")]


@pytest.mark.parametrize("display", ["", ":0"])
def test_the_report_is_opened_where_there_is_a_display(
    example, monkeypatch, tmp_path, capsys, display
):
    real = example("real")
    opened = []
    monkeypatch.setattr(real.webbrowser, "open", opened.append)
    for name in real.DISPLAYS:
        monkeypatch.setenv(name, display)
    report = tmp_path / "report.html"
    real._open(report, True)
    assert opened == ([report.as_uri()] if display else [])
    assert str(report) in capsys.readouterr().out
    real._open(report, False)
    assert len(opened) == bool(display)


@pytest.mark.slow
def test_the_whole(example, tmp_path, capsys):
    real = example("real")
    assert real.main(["--output", str(tmp_path), "--no-browser"]) == 0
    said = capsys.readouterr().out
    assert str(tmp_path / "diagnose" / "report.html") in said
    estimate = json.loads((tmp_path / "identify" / "estimate.json").read_text())
    ratio = estimate["specific_modulus"]
    assert 3000.0 < ratio["value"] < 6000.0 and ratio["std"] > 0.02 * ratio["value"]
    report = json.loads((tmp_path / "diagnose" / "report.json").read_text())
    before, after = (report[k]["err_holdout"] for k in ("baseline", "extended"))
    assert after < 0.75 * before  # on the shape that no fit has seen
    # The models that are drawn are those whose ERR is told.
    extended = Settings.load(tmp_path / "diagnose" / "extended.yaml")
    for key, model in (("baseline", real._plain(report)), ("extended", extended)):
        shape = load_manipulation(tmp_path / "recordings" / real.KEPT, model)
        (drawn,) = forecast(shape, model).err
        allowed = model.simulation.tolerance * model.rod.length
        assert drawn == pytest.approx(report[key]["err_holdout"], abs=allowed)
    picture = cv2.imread(str(tmp_path / "real_wire.png"))
    assert picture is not None and picture.shape[1] > 600
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50
