# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The README's five minutes, every step as it stands there, on the recording that it tells to make.

Not run: photographs of a pattern (step 2, test_calibrate.py), `ros2`, and the live nodes of step 7
(test_demo_live.py).
"""

import json
import os
import re
import shutil
import subprocess
import sysconfig

import pytest
import yaml
from conftest import ROOT

from dlo_ros.cli.diagnosis_output import WIDTH
from dlo_ros.parameters import Settings

SECTION = "With your own rope"
BIN = sysconfig.get_path("scripts")
STEPS = {"1": "calibrate", "4": "observe", "5": "identify", "6": "diagnose"}
PARTS = re.compile(r"^\*\*(\d)\. ", re.MULTILINE)
JARGON = ("holdout", "held out", "noise floor", "autocovariance", "more of this kind", "e+0", "_")
"""What the terminal says to nobody who has not read the documentation; `_` stands in file names."""


def section():
    text = (ROOT / "README.md").read_text()
    return text[text.index(f"## {SECTION}") :].split("\n## ")[0].split(SECTION, 1)[1]


def inline(text, start):
    """Commands in backticks that begin with a word, lines joined."""
    return [" ".join(c.split()) for c in re.findall(r"`([^`]+)`", text) if c.startswith(start)]


def commands():
    """The commands of the recording, of each step that can be run here, and of what follows."""
    text = section()
    pieces = PARTS.split(text)
    steps = dict(zip(pieces[1::2], pieces[2::2], strict=True))
    found = {"0": [c for w in ("dlo_ros synthesize", "cp ") for c in inline(pieces[0], w)]}
    for number, tool in STEPS.items():
        lines = [line.strip() for line in steps[number].splitlines() if line.startswith("    ")]
        found[number] = [line for line in lines if line.startswith(f"dlo_ros {tool}")]
    found["8"], found["9"] = ([c] for c in inline(text, "dlo_ros design"))
    return found


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """Everything is run in one folder; what each step has said on the terminal, by number."""
    folder = tmp_path_factory.mktemp("tutorial")
    environment = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    told = {}
    for number, lines in commands().items():
        told[number] = ""
        for line in lines:
            done = subprocess.run(
                line, shell=True, cwd=folder, env=environment, capture_output=True, text=True
            )
            # What is adequate has no causes between which design could decide.
            assert (done.returncode == 0) == (number != "9"), f"{line}: {done.stderr}"
            told[number] += done.stdout + done.stderr
    told["folder"] = folder
    return told


def test_every_step_has_its_command():
    found = commands()
    assert [len(found[k]) for k in ("0", "1", "4", "5", "6", "8")] == [2, 1, 1, 1, 1, 1]
    assert "--report" in found["9"][0]
    assert found["0"][0].startswith("dlo_ros synthesize c_shape")
    numbers = PARTS.findall(section())
    assert numbers == sorted(numbers) and set(STEPS) < set(numbers)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("sh") is None, reason="there is no shell")
def test_every_step_does_what_the_readme_says(said):
    folder = said["folder"]
    assert (folder / "pattern.pdf").stat().st_size > 1000
    assert len(list((folder / "pictures").glob("*.png"))) > 50
    assert "images show the DLO" in said["4"]
    rod = yaml.safe_load((folder / "recording" / "truth.yaml").read_text())["rod"]
    estimate = json.loads((folder / "build" / "estimate" / "estimate.json").read_text())
    ratio, true = estimate["specific_modulus"], rod["young_modulus"] / rod["density"]
    assert abs(ratio["value"] - true) < max(3.0 * ratio["std"], 0.01 * true)
    report = json.loads((folder / "build" / "diagnosis" / "report.json").read_text())
    assert report["verdict"] == "adequate" and report["effects"] == []
    assert report["baseline"]["err_holdout"] < report["material_err"]
    for made in ("build/estimate/estimate.yaml", "build/diagnosis/extended.yaml"):
        Settings.load(folder / made)
    for page in ("estimate", "diagnosis", "design"):
        assert (folder / "build" / page / "report.html").exists()


@pytest.mark.slow
def test_the_terminal_can_be_read(said):
    text = said["6"]
    assert text.startswith("adequate: The simulation agrees with the recordings; it is 0.0")
    for question in ("How wrong is my simulation?", "Why?", "What do I gain?"):
        assert question in text
    assert "names no rivals" in said["9"]
    for number in ("4", "5", "6", "8", "9"):
        lines = said[number].splitlines()
        assert lines and "Traceback" not in said[number]
        if number == "6":
            assert max(map(len, lines)) <= WIDTH, [s for s in lines if len(s) > WIDTH]
            words = re.sub(r"\S*[/.]\S*", "", text)  # files
            assert not [j for j in JARGON if j in words]
