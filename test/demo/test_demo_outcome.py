# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Outcome of the demo from the messages that it received: estimate.json, report, last line."""

import io
import json
import math

import cv2
import numpy as np
import pytest
import recordings_samples
from rich.console import Console

from dlo_ros.demo.outcome import LiveOutcome, assess
from dlo_ros.demo.photographs import ImageWindow
from dlo_ros.demo.result import estimate_tree, last_line, read_truth, report, with_std, write_json
from dlo_ros.demo.terminal_progress import Progress, line
from dlo_ros.errors import InputError, RecordingError
from dlo_ros.inference.forecast import Manipulation, forecast
from dlo_ros.nodes.received_data import QUANTITIES, EstimateSample, ReceivedData
from dlo_ros.parameters import RodParameters, Settings
from dlo_ros.recordings import (
    read_recording,
)
from dlo_ros.report import write_identification_report

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
TRUTH = {"young_modulus": 5e7, "density": 2500.0, "specific_modulus": 2e4}
SETTINGS = Settings(RodParameters(0.4, 0.004, 1e6, 2000.0))


def heard(std=300.0):
    """A run of 3 s: ERR falls from 30 to 2 mm, E/mu rises to 19800."""
    result = ReceivedData()
    basis = np.linspace(0.0, 0.3, 10)
    for k in range(91):
        stamp = START + round(k / 30 * SECOND)
        shape = np.column_stack([basis, 0 * basis, basis**2, 0 * basis])
        result.observed[stamp] = shape
        result.predicted[stamp - 5_000_000] = shape + 0.001
        result.predicted[stamp + 5_000_000] = shape + 0.003
        result.tick(stamp + 8_000_000)
        result.err.append((result.now, 0.03 * math.exp(-k) + 0.002))
        result.take_estimate(4.95e7 * (1 - math.exp(-0.2 * (k + 1))), 2500.0)
        result.take_diagnostics(
            {
                "young_modulus std [Pa]": "-",
                "density std [kg/m^3]": "800",
                "specific_modulus std [m^2/s^2]": f"{std:.4g}",
            }
        )
    return result


def test_prediction_lies_between_its_neighbours():
    run = heard()
    stamp = START + 1 * SECOND
    np.testing.assert_allclose(run.predicted_at(stamp), run.observed[stamp] + 0.002, atol=1e-12)
    assert run.predicted_at(START - SECOND) is None
    assert run.predicted_at(START + 100 * SECOND) is None
    for stamp in [s for s in run.predicted if s > START + 2 * SECOND]:
        del run.predicted[stamp]
    run.predicted[START + 3 * SECOND] = run.observed[START]
    assert run.predicted_at(START + 2_500_000_000) is None  # in a gap


def test_the_estimate_keeps_its_history():
    run = heard()
    assert len(run.samples) == 91
    assert run.samples[0].stamp == START + 8_000_000
    assert run.estimate().values["specific_modulus"] == pytest.approx(19800.0, rel=1e-6)
    assert run.estimate().std == {
        "young_modulus": math.inf,
        "density": 800.0,
        "specific_modulus": 300.0,
    }


def test_nothing_is_known_before_both_values_came():
    run = ReceivedData()
    run.take_estimate(1e6, None)
    assert run.estimate() is None
    run.take_estimate(None, 2000.0)
    assert run.estimate().values["specific_modulus"] == 500.0
    assert run.samples == []  # no clock yet
    run.tick(START)
    assert [s.stamp for s in run.samples] == [START]


def test_identifiable_is_what_the_node_says_else_what_the_std_says():
    run = heard()
    assert not run.identifiable("young_modulus") and not run.identifiable("density")
    assert run.identifiable("specific_modulus")
    run.take_diagnostics({"specific_modulus identifiable": "no"})
    assert not run.identifiable("specific_modulus")


def outcome(run, **changes):
    known = {
        "sample": run.estimate(),
        "err_initial": 0.0312,
        "err": 0.00142,
        "noise_floor": 0.0011,
        "initial": {s: shape + 0.03 for s, shape in run.observed.items()},
    }
    return LiveOutcome(**(known | changes))


def test_estimate_json_has_the_contract_s_keys(tmp_path):
    run = heard()
    write_json(tmp_path / "estimate.json", estimate_tree(run, outcome(run), "c_shape", TRUTH))
    tree = json.loads((tmp_path / "estimate.json").read_text())
    assert tree["young_modulus"]["std"] is None
    assert tree["specific_modulus"] == {"value": pytest.approx(19800.0, rel=1e-6), "std": 300.0}
    assert tree["identifiable"] == {
        "young_modulus": False,
        "density": False,
        "specific_modulus": True,
    }
    assert tree["noise_floor"] == 0.0011
    (recording,) = tree["recordings"]
    assert recording == {"bag": "c_shape", "role": "train", "err": 0.00142, "err_initial": 0.0312}
    assert {k: tree["true"][k]["value"] for k in QUANTITIES} == TRUTH
    assert "true" not in estimate_tree(run, outcome(run), "c_shape", {})


def test_last_line():
    found = outcome(heard())
    assert last_line(found, TRUTH) == (
        "ERR 31.2 -> 1.4 mm; E/mu 1.98e+04 +- 0.03e+04 m^2/s^2 (true 2.00e+04)"
    )
    assert last_line(found, {}).endswith("m^2/s^2")
    assert last_line(outcome(heard(), err_initial=None), {}).startswith("ERR unknown -> 1.4 mm;")


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (1.98e4, 300.0, "1.98e+04 +- 0.03e+04 m^2/s^2"),
        (1.98e4, 4.0, "1.9800e+04 +- 0.0004e+04 m^2/s^2"),
        (1.98e4, 5e5, "1.98e+04 +- 50.00e+04 m^2/s^2"),
        (1.98e4, math.inf, "1.98e+04 +- unknown m^2/s^2"),
    ],
)
def test_value_and_std_share_their_power_of_ten(value, std, text):
    sample = EstimateSample(0, {"specific_modulus": value}, {"specific_modulus": std})
    assert with_std(sample, "specific_modulus") == text


def test_err_at_first_is_that_of_the_initial_guess(tmp_path):
    bag = recordings_samples.write_plain(
        tmp_path / "bag", recordings_samples.messages(images=False)
    )
    settings = recordings_samples.SETTINGS
    recording = read_recording(bag, settings)
    run = ReceivedData()
    for k, observation in enumerate(recording.observations):
        run.observed[observation.stamp] = observation.control_points
        shift = np.array([0.0, 0.0, 0.001 * (k + 1), 0.0])
        run.predicted[observation.stamp] = observation.control_points + shift
        run.tick(observation.stamp)
    with pytest.raises(RecordingError, match="no estimate"):
        assess(bag, settings, run)
    run.take_estimate(2e6, 2000.0)
    found = assess(bag, settings, run)
    manipulation = Manipulation("bag", recording.commands, recording.observations)
    expected = forecast(manipulation, settings)
    assert found.err_initial == pytest.approx(np.mean(expected.err))
    assert found.err == pytest.approx(0.0025)  # four shapes within the last half second
    assert set(found.initial) == set(run.observed)


def test_report_of_a_run(tmp_path):
    run = heard()
    page = report(run, outcome(run), "c_shape", 0.4, TRUTH, {}, ["A remark."], {})
    frames = page.recordings[0].frames
    assert len(frames) == 91 and frames[0].time == 0.0
    assert frames[5].err == pytest.approx(math.sqrt(3.0) * 0.002)
    np.testing.assert_allclose(frames[5].initial, frames[5].observed + 0.03)
    assert len(page.tracks) == 3 and page.tracks[2].true == 2e4
    write_identification_report(tmp_path / "report.html", page)
    assert "A remark." in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("size", [(400, 300), (3000, 2000)])
def test_curves_lie_where_they_lay_in_the_whole_picture(size):
    width, height = size
    picture = np.zeros((height, width, 3), np.uint8)
    line = np.array([[0.3, 0.4], [0.6, 0.7]]) * size
    for x, y in line.astype(int):
        cv2.circle(picture, (int(x), int(y)), max(width // 60, 3), (255, 255, 255), -1)
    window = ImageWindow.around(line.astype(int).astype(float), width, height)
    shown = window.show(picture, {"observed": line.astype(int).astype(float)})
    small = cv2.imdecode(np.frombuffer(shown.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert small.shape == (shown.height, shown.width) and shown.width <= 640
    _, _, _, centres = cv2.connectedComponentsWithStats((small > 128).astype(np.uint8))
    np.testing.assert_allclose(centres[1:] + 0.5, shown.observed, atol=0.6)


def test_truth(tmp_path):
    assert read_truth(tmp_path) == {}
    settings = SETTINGS.with_material(5e7, 2500.0)
    settings.dump(tmp_path / "truth.yaml")
    assert read_truth(tmp_path) == TRUTH
    (tmp_path / "truth.yaml").write_text("rod: 3\n")
    with pytest.raises(InputError, match=r"truth.yaml: rod.young_modulus"):
        read_truth(tmp_path)


def test_a_pipe_gets_a_line_for_each_second(capsys):
    run = heard()
    with Progress(Console(), 3.0) as progress:
        for t in np.arange(0.0, 3.0, 0.1):
            run.now = START + round(t * SECOND)
            progress.update(run)
    lines = capsys.readouterr().out.splitlines()
    assert [text.split(" s")[0].strip() for text in lines] == ["0.0", "1.0", "2.0"]
    assert "ERR 2.00 mm" in lines[0] and "E/mu 1.98e+04 +- 0.03e+04 m^2/s^2" in lines[0]
    assert "ERR not yet" in line(0.0, ReceivedData())


def test_a_terminal_gets_a_table():
    screen = io.StringIO()
    with Progress(Console(force_terminal=True, width=100, file=screen), 3.0) as progress:
        progress.update(heard())
    text = screen.getvalue()
    assert "91 splines" in text and "2.00 mm" in text and "1.98e+04 +- 0.03e+04 m^2/s^2" in text
