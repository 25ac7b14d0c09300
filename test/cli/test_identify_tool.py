# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`predict` and `identify` as a user types them, on recordings written and read as bags."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured import swing
from ordinary import some_of
from rods import PAPER
from tool_runs import run, write_bag

from dlo_ros.parameters import Settings
from dlo_ros.recordings.read import read_recording

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two recordings of a swinging rope, and a parameter file with a wrong guess."""
    path = tmp_path_factory.mktemp("recordings")
    for seed, name in enumerate(("one", "two")):
        write_bag(path / name, swing(PAPER, seconds=1.0, seed=seed))
    PAPER.with_material(1e7, 2000.0).dump(path / "params.yaml")
    return path


def test_identify_writes_estimate_parameters_and_report(folder, tmp_path, capsys):
    params, output = folder / "params.yaml", tmp_path / "result"
    status = run(
        "identify", "--params", params, "--output", output, "--validate", folder / "two",
        folder / "one",
    )  # fmt: skip
    assert status == 0
    estimate = json.loads((output / "estimate.json").read_text())
    assert set(estimate) >= {
        "young_modulus", "density", "specific_modulus", "identifiable", "noise_floor", "recordings"
    }  # fmt: skip
    assert "E and mu change together" in " ".join(estimate["statement"])
    assert estimate["knowledge"]["specific_modulus"]["source"] == "data"
    assert estimate["knowledge"]["density"] == {"source": "guess", "data_std": None, "std": None}
    ratio = estimate["specific_modulus"]
    assert abs(ratio["value"] - 2e4) < max(4 * ratio["std"], 100.0)
    assert estimate["density"]["std"] is None
    assert estimate["identifiable"] == {
        "young_modulus": False, "density": False, "specific_modulus": True
    }  # fmt: skip
    assert [r["role"] for r in estimate["recordings"]] == ["train", "validate"]
    assert [r["bag"] for r in estimate["recordings"]] == ["one", "two"]
    for recording in estimate["recordings"]:
        assert recording["err"] < 0.05 * recording["err_initial"]
    settings = Settings.load(output / "estimate.yaml")
    assert settings.rod.specific_modulus == pytest.approx(ratio["value"])
    assert settings.rod.specific_modulus_std == pytest.approx(ratio["std"])
    report = (output / "report.html").read_text()
    assert "E/mu" in report
    assert "Residuals along the DLO" in report
    assert "predicted at first" in report
    assert "Not drawn: E beside mu, since these data do not determine E and mu." in report
    assert "Largest loads in the recordings" in report and "smallest bend radius" in report
    assert "http" not in report.replace("http://www.w3.org", "")
    out = capsys.readouterr().out
    assert "E/mu" in out
    assert "not determined" in out


@pytest.mark.slow
def test_identify_samples_and_draws_recordings_where_it_is_asked(folder, tmp_path, capsys):
    params, output = folder / "params.yaml", tmp_path / "result"
    words = (
        "identify", "--params", params, "--output", output, "--sample", 200, "--bootstrap", 3,
        folder / "one", folder / "two",
    )  # fmt: skip
    assert run(*words) == 0
    estimate = json.loads((output / "estimate.json").read_text())
    posterior, drawn = estimate["posterior"]["specific_modulus"], estimate["bootstrap"]
    assert posterior["low"] < 2e4 < posterior["high"] < 1.2 * posterior["low"]
    assert posterior["low"] < posterior["median"] < posterior["high"]
    assert drawn["draws"] == 3 and drawn["specific_modulus"]["low"] == pytest.approx(2e4, rel=0.1)
    assert [p.name for p in output.iterdir() if p.name.startswith(".")] == []
    assert run(*(("-1" if w == 3 else w) for w in words)) == 2
    assert "--bootstrap is -1; it must not be negative" in capsys.readouterr().err
    assert run(*(1 if w == 3 else w for w in words)) == 2
    assert "--bootstrap is 1; a spread takes at least two draws" in capsys.readouterr().err
    assert run(*words[:-1]) == 2
    assert "needs at least two" in capsys.readouterr().err


def test_predict_writes_splines_and_err_at_the_observed_stamps(folder, tmp_path):
    output = tmp_path / "predicted.mcap"
    PAPER.dump(tmp_path / "true.yaml")
    assert (
        run("predict", "--params", tmp_path / "true.yaml", "--output", output, folder / "one") == 0
    )
    observed = read_recording(folder / "one", PAPER).observations
    from rosbags.highlevel import AnyReader

    predicted, err = [], []
    with AnyReader([output]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/dlo/predicted":
                stamp = message.header.stamp
                predicted.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
                assert len(message.poses) == 10
            elif connection.topic == "/dlo/err":
                err.append(message.data)
    assert predicted == [o.stamp for o in observed]
    assert len(err) == len(predicted)
    assert np.mean(err) < 3e-4
    # The copy of the input's topics lets it be judged again.
    assert len(read_recording(output, PAPER).observations) == len(observed)
    assert (
        run("predict", "--params", tmp_path / "true.yaml", "--output", output, folder / "one") == 2
    )


def test_start_may_be_overridden(folder, tmp_path, capsys):
    params = tmp_path / "true.yaml"
    PAPER.dump(params)
    for start in ("observed", "moving"):
        output = tmp_path / f"{start}.mcap"
        words = ("predict", "--params", params, "--start", start, "--output", output)
        assert run(*words, folder / "one") == 0
        text = capsys.readouterr().out
        assert float(text.split("ERR ")[1].split(" mm")[0]) < 3.0


def test_shapes_with_swapped_ends_are_turned_round_and_told(folder, tmp_path, capsys, caplog):
    """An observer that has not heard a command yet cannot know which end is the start."""
    good = swing(PAPER, seconds=1.0)
    swapped = [replace(o, control_points=o.control_points[::-1].copy()) for o in good.observations]
    mixed = replace(good, observations=(*swapped[:2], *good.observations[2:]))
    write_bag(tmp_path / "mixed", mixed)
    words = ("predict", "--params", folder / "params.yaml", "--output")
    for bag, output in ((folder / "one", "a"), (tmp_path / "mixed", "b")):
        assert run(*words, tmp_path / output, bag) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if "predicted splines" in line]
    first, second = (line.split(": ", 1)[1] for line in said)
    assert first == second
    assert f"mixed: 2 of {len(swapped)} observed shapes run from the commanded end" in caplog.text


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"bag": "nowhere"}, "no such bag"),
        ({"params": "nowhere.yaml"}, "cannot be read"),
        ({"output": "params.yaml"}, "is a file"),
    ],
)
def test_unusable_input_ends_with_one_line(folder, tmp_path, capsys, change, said):
    bag = folder / change.get("bag", "one")
    params = folder / change.get("params", "params.yaml")
    output = folder / change["output"] if "output" in change else tmp_path / "out"
    assert run("identify", "--params", params, "--output", output, bag) == 2
    err = capsys.readouterr().err.strip()
    assert said in err
    assert "Traceback" not in err
    assert len(err.splitlines()) == 1


def test_a_length_that_cannot_be_is_told(folder, tmp_path, capsys):
    text = (folder / "params.yaml").read_text().replace("length: 0.4", "length: -1.0")
    Path(tmp_path / "bad.yaml").write_text(text)
    status = run(
        "identify", "--params", tmp_path / "bad.yaml", "--output", tmp_path, folder / "one"
    )
    assert status == 2
    assert "rod.length" in capsys.readouterr().err


BLACK = "hanging_loop/black"


@pytest.mark.parametrize("factor", some_of([0.1, 1.0, 10.0], [0.1]))
def test_real_wire_gives_the_same_ratio_from_any_guess(shared_data, tmp_path, factor):
    folder = shared_data / BLACK
    given = Settings.load(folder / "params.yaml")
    given.with_material(factor * given.rod.young_modulus, given.rod.density).dump(
        tmp_path / "params.yaml"
    )
    trials = [folder / f"trial{k}" for k in range(3)]
    assert run("identify", "--params", tmp_path / "params.yaml", "--output", tmp_path, *trials) == 0
    estimate = json.loads((tmp_path / "estimate.json").read_text())
    # No truth is known: three trials that differ by more than they are noisy bound it.
    assert estimate["specific_modulus"]["value"] == pytest.approx(3.14e4, rel=0.25)
    assert estimate["specific_modulus"]["std"] > 0.05 * estimate["specific_modulus"]["value"]
    assert not estimate["identifiable"]["density"]


def test_the_photograph_of_a_real_wire_gives_what_its_clicked_points_give(shared_data, tmp_path):
    folder = shared_data / BLACK
    values = []
    for bag in ("photo0", "trial0"):
        output = tmp_path / bag
        params = folder / "params.yaml"
        assert run("identify", "--params", params, "--output", output, folder / bag) == 0
        estimate = json.loads((output / "estimate.json").read_text())
        values.append((estimate["specific_modulus"]["value"], estimate["specific_modulus"]["std"]))
    (seen, seen_std), (clicked, clicked_std) = values
    assert abs(seen - clicked) < 2.0 * np.hypot(seen_std, clicked_std) < 0.25 * clicked
