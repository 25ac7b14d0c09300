# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The demo as a tool: recordings that it refuses, files that it finds, how it ends, the truth."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import recordings_samples
from conftest import ROOT

from dlo_ros.cli import main as cli
from dlo_ros.demo.plan import params_beside, plan_run
from dlo_ros.errors import InputError, RecordingError
from dlo_ros.own_process import command_of
from dlo_ros.parameters import RodParameters, Settings
from dlo_ros.recordings import (
    BAG_MESSAGES,
    BagWriter,
    float_message,
    spline_message,
)
from dlo_ros.share import shared_file

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
TRUTH = {"young_modulus": 5e7, "density": 2500.0, "specific_modulus": 2e4}
SETTINGS = Settings(RodParameters(0.4, 0.004, 1e6, 2000.0))


def write_bag(path, *topics_used):
    with BagWriter(path) as bag:
        for k in range(3):
            stamp = START + k * SECOND
            if "dlo/observed" in topics_used:
                points = np.zeros((10, 4))
                bag.write(
                    "dlo/observed", spline_message(BAG_MESSAGES, stamp, "board", points), stamp
                )
            if "dlo/err" in topics_used:
                bag.write("dlo/err", float_message(BAG_MESSAGES, 0.1), stamp)
    return path


def test_a_bag_without_images_and_splines_is_refused(tmp_path):
    bag = write_bag(tmp_path / "bag", "dlo/err")
    with pytest.raises(RecordingError, match="neither images nor dlo/observed"):
        plan_run(bag, tmp_path / "p.yaml", SETTINGS, tmp_path)


def test_a_bag_without_command_is_refused(tmp_path):
    bag = write_bag(tmp_path / "bag", "dlo/observed")
    with pytest.raises(RecordingError, match="no dlo/command"):
        plan_run(bag, tmp_path / "p.yaml", SETTINGS, tmp_path)


def test_params_without_a_bag_are_refused(tmp_path, capsys):
    """They would be taken for the synthetic recording, which has its own."""
    output = tmp_path / "out"
    words = ["demo", "--params", str(tmp_path / "my.yaml"), "--output", str(output)]
    assert cli.main(words) == 2
    assert "name it with --bag" in capsys.readouterr().err
    assert not output.exists()


def test_params_stand_in_or_beside_the_bag(tmp_path):
    bag = tmp_path / "bag"
    with pytest.raises(RecordingError, match="no such bag"):
        params_beside(bag)
    bag.mkdir()
    with pytest.raises(InputError, match="--params"):
        params_beside(bag)
    (tmp_path / "params.yaml").touch()
    assert params_beside(bag) == tmp_path / "params.yaml"
    (bag / "params.yaml").touch()
    assert params_beside(bag) == bag / "params.yaml"


def test_shared_files_are_found():
    assert shared_file("config/experiments/c_shape.yaml").is_file()
    with pytest.raises(InputError, match=r"no/such\.yaml"):
        shared_file("no/such.yaml")


def test_a_missing_bag_is_one_line_and_2(tmp_path, capsys):
    (tmp_path / "params.yaml").write_text("")
    SETTINGS.dump(tmp_path / "params.yaml")
    arguments = ["--bag", str(tmp_path / "none"), "--output", str(tmp_path / "out")]
    assert cli.main(["demo", *arguments]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and str(tmp_path / "none") in text


@pytest.fixture
def demo(tmp_path):
    """Start the demo on a small bag of splines, as a user does; it is ended with the test."""
    recordings_samples.SETTINGS.dump(tmp_path / "params.yaml")
    bag = recordings_samples.write_plain(
        tmp_path / "bag", recordings_samples.messages(images=False)
    )
    started = []

    def start(*words):
        arguments = ["--bag", str(bag), "--output", str(tmp_path / "out"), *words]
        process = subprocess.Popen(
            [sys.executable, "-m", "dlo_ros", "demo", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            cwd=tmp_path,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.terminate()
            process.communicate(timeout=30)


def children_of(pid, count, seconds=120.0):
    """Process ids of the nodes that a demo has started, by their names."""
    own, deadline = command_of("dlo_ros"), time.monotonic() + seconds
    while time.monotonic() < deadline:
        found = {}
        for folder in Path("/proc").iterdir():
            if not folder.name.isdigit():
                continue
            with contextlib.suppress(OSError):
                parent = (folder / "stat").read_text().rpartition(")")[2].split()[1]
                words = (folder / "cmdline").read_bytes().decode().split("\0")
                if int(parent) == pid and words[: len(own)] == own:
                    found[words[len(own)]] = int(folder.name)
        if len(found) >= count:
            return found
        time.sleep(0.05)
    raise AssertionError(f"the demo started {sorted(found)} only")


def running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
def test_ctrl_c_stops_the_children(demo):
    process = demo()
    nodes = children_of(process.pid, 3)
    assert set(nodes) == {"observer", "simulator", "identifier"}
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130 and said == ""
    assert not any(running(pid) for pid in nodes.values())


@pytest.mark.slow
def test_a_node_that_dies_is_reported_and_the_others_stop(demo):
    process = demo()
    nodes = children_of(process.pid, 3)
    os.kill(nodes["simulator"], signal.SIGKILL)
    _, said = process.communicate(timeout=40)
    assert process.returncode == 2
    assert said.count("\n") == 1 and "simulator ended with status -9" in said
    assert not any(running(pid) for pid in nodes.values())


@pytest.mark.slow
def test_the_demo_finds_the_truth(tmp_path):
    """The whole of it, as `make demo` runs it: images, three live nodes, the report."""
    done = subprocess.run(
        [sys.executable, "-m", "dlo_ros", "demo", "--output", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=120,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    number = r"\d\.\d+e[+-]\d\d"
    assert re.fullmatch(
        rf"ERR \d+\.\d -> \d+\.\d mm; E/mu {number} \+- {number} m\^2/s\^2 \(true 2.00e\+04\)",
        done.stdout.splitlines()[-1],
    )
    tree = json.loads((tmp_path / "estimate.json").read_text())
    assert tree["specific_modulus"]["value"] == pytest.approx(2e4, rel=0.05)
    assert tree["identifiable"]["specific_modulus"] and not tree["identifiable"]["density"]
    (recording,) = tree["recordings"]
    assert recording["err"] < 0.01 * 0.4 < recording["err_initial"]
    assert "<svg" in (tmp_path / "report.html").read_text()
    assert (tmp_path / "overview.png").read_bytes().startswith(b"\x89PNG")
