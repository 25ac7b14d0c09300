# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What to measure next: known answers about shapes, limits of the workspace, the tool."""

import json
from dataclasses import replace
from types import SimpleNamespace

import measured
import numpy as np
import pytest
import yaml
from challenge.generate import _recordings
from challenge.manipulations import carry, swing, wave
from experiment_recordings import recorded
from field.nuisances import set_up
from rods import PAPER, command

from dlo_ros.cli.design import experiment_plan, experiment_text
from dlo_ros.cli.main import main
from dlo_ros.effects import effects, quantities
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification import identify
from dlo_ros.identification.design.expected_information import (
    Noise,
    Plan,
    at_equilibrium,
    outlook,
)
from dlo_ros.identification.design.manipulation_search import (
    KINDS,
    MOMENTS,
    Workspace,
    draw,
    hanging,
    imposed,
    laid,
    plan_of,
    search,
    varied,
)
from dlo_ros.identification.design.standard_manipulations import standard
from dlo_ros.inference.forecast import forecast
from dlo_ros.parameters import DampingParameters, Settings, tolerance
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.experiment import find_experiment, load_experiment, read_experiment
from dlo_ros.synthesis.true_motion import build_simulation

BASIS = SplineBasis(10, 0.4)
PLACE = Workspace((-0.2, 0.2), (-0.1, 0.3))


def rope(ratio):
    """The paper's rope with E such that L is so many times (B/w)^(1/3)."""
    rod = PAPER.rod
    load = 9.81 * rod.linear_density
    return PAPER.with_material((0.4 / ratio) ** 3 * load / rod.second_moment, rod.density)


def exact(settings):
    """The settings with a set-up and a diameter that are known exactly."""
    known = {
        f"effects.{name}.{key}_std": 0.0
        for name in effects() for key, quantity in quantities(name).items()
        if tolerance(settings, f"{name}.{key}") is not None
    }  # fmt: skip
    rod = {"rod.diameter_std": 1e-6 * settings.rod.diameter}
    return Settings.from_mapping(settings.flat() | known | rod)


def bundled(name):
    return experiment_plan(load_experiment(find_experiment(name)), PAPER)


def free_end():
    shape = np.zeros((10, 4))
    shape[:, 0] = BASIS.greville
    return Plan("free end", command(["start"], [0.0], [[0.0, 0.0, 0.0]]), shape, 0.0)


def u_shape(*, clamped=False):
    """Both ends at one height, half the length apart, free to turn or clamped along x."""
    ends = np.array([[0.0, 0.0], [0.2, 0.0]])
    names = ["start", "end"] if clamped else ["control_point_1", "control_point_10"]
    imposed = command(names, [0.0], [[[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]]])
    return Plan("u", imposed, laid(hanging(*ends, 0.4), BASIS), 0.0)


# Mean displacement over L for a unit change of ln(E/mu), computed with a planar elastica.
@pytest.mark.parametrize(
    ("ratio", "moved"),
    [(1.0, 0.049), (2.0, 0.173), (3.15, 0.123), (5.0, 0.065), (7.5, 0.036), (10.8, 0.021)],
)
def test_a_free_end_answers_to_stiffness_as_the_elastica_does(ratio, moved):
    assert outlook(free_end(), rope(ratio)).response == pytest.approx(moved, rel=0.03, abs=0.0015)


# From a boundary value problem of the inextensible elastica.
@pytest.mark.parametrize(
    ("clamped", "ratio", "moved"),
    [(True, 3.15, 0.00240), (True, 5.0, 0.00683), (True, 7.5, 0.01072),
     (False, 3.15, 0.00150), (False, 5.0, 0.00348), (False, 7.5, 0.00396)],
)  # fmt: skip
def test_a_u_answers_as_the_elastica_does_by_how_it_is_held(clamped, ratio, moved):
    found = outlook(u_shape(clamped=clamped), rope(ratio)).response
    assert found == pytest.approx(moved, rel=0.05, abs=2e-4)


def test_a_free_end_near_two_beats_every_u():
    free = {r: outlook(free_end(), exact(rope(r))) for r in (1.0, 2.0, 5.0)}
    assert max(free, key=lambda r: free[r].response) == 2.0
    held = [outlook(u_shape(), exact(rope(r))) for r in (2.0, 3.15, 5.0, 7.5, 10.8)]
    assert free[2.0].response > 10.0 * max(u.response for u in held)
    assert free[2.0].gain > max(u.gain for u in held)


def test_the_c_shape_beats_the_simple_one():
    plans = [bundled(n) for n in ("simple", "c_shape", "different")]
    ranking = sorted((outlook(p, exact(PAPER)) for p in plans), key=lambda o: -o.gain)
    assert [o.plan.name for o in ranking] == ["c_shape", "different", "simple"]
    assert ranking[0].std["specific_modulus"] < 0.3 * ranking[-1].std["specific_modulus"]
    by_eye = min((outlook(p, PAPER) for p in plans), key=lambda o: o.gain)
    assert by_eye.plan.name == "simple"  # nor where the set-up is set up by eye


def test_standard_manipulations_can_be_simulated():
    made = standard(PAPER)
    assert len(made) == 4
    for plan in made:
        shapes = forecast(plan.manipulation(), at_equilibrium(PAPER)).predicted
        assert len(shapes) >= 5, plan.name
        length = np.sum(np.linalg.norm(np.diff(shapes[-1][:, :3], axis=0), axis=1))
        assert length == pytest.approx(PAPER.rod.length, rel=0.05), plan.name


def test_the_prediction_holds_for_what_is_then_identified():
    """The predicted std is that of a fit to such a recording, within the factor of its noise."""
    recording = measured.swing(PAPER, seconds=1.0)
    shape = recording.observations[0].control_points
    plan = Plan("swing", recording.commands[0], shape, 1.0)
    said = outlook(plan, exact(PAPER), Noise(std=3e-4, spacing=0.4 / 120)).std["specific_modulus"]
    estimate = identify([recording], exact(PAPER)).estimate
    found = estimate.specific_modulus_std / estimate.specific_modulus
    assert 0.3 < said / found < 3.0


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [(swing, 0), (carry, 1), (wave, 2)])
def test_the_prediction_holds_where_the_set_up_is_within_its_tolerances(kind, seed):
    rng = np.random.default_rng([seed, 5])
    tree = _recordings(rng, [kind(rng)], 3e-4)[0]
    parameters = tree["parameters"]
    length, diameter = (parameters["rod"][key] for key in ("length", "diameter"))
    parameters["effects"] = set_up(rng, length, ("start",))
    tree["guess"] = {"rod": {"diameter_std": 1e-3 * diameter}}  # else all is the diameter's
    made = read_experiment(tree, kind.__name__, "test")
    recording, guess, _ = recorded(tree, seed, step=1e-3)
    known = guess.with_effects({})
    plan = experiment_plan(made, known)
    said = outlook(plan, known, Noise(std=3e-4, spacing=length / 100)).std["specific_modulus"]
    found = identify([recording], known)
    assert found.fitted.set_up
    estimate = found.estimate
    assert 0.6 < said / (estimate.specific_modulus_std / estimate.specific_modulus) < 1.6
    # Without a stated diameter nothing tells E/mu better than to 4 %.
    bare = replace(known, rod=replace(known.rod, diameter_std=0.0))
    assert 0.04 < outlook(plan, bare).std["specific_modulus"] < 0.042


def test_only_a_known_drag_promises_the_density():
    windy = replace(PAPER, damping=DampingParameters(air_drag=0.15, air_drag_std=0.005))
    guessed = replace(PAPER, damping=DampingParameters(air_drag=0.15))
    plan = bundled("c_shape")
    assert outlook(plan, windy).std["density"] < 0.15
    assert outlook(plan, guessed).std["density"] > 0.25


def test_what_is_known_already_is_not_told_again():
    plan = bundled("c_shape")
    once = outlook(plan, PAPER)
    again = outlook(plan, PAPER, known=once.information + np.diag([1 / 16, 11.0, 0.1, 0.25]))
    assert again.gain < 0.2 * once.gain


@pytest.mark.parametrize("kind", KINDS)
def test_candidates_keep_within_the_workspace(kind):
    rng = np.random.default_rng(3)
    candidate = draw(kind, PLACE, 0.4, rng)
    for _ in range(20):
        for rows in imposed(candidate, PLACE.duration, 10).values():
            assert rows[:, 1].min() >= -0.2 - 1e-9 and rows[:, 1].max() <= 0.2 + 1e-9
            assert rows[:, 2].min() >= -0.1 - 1e-9 and rows[:, 2].max() <= 0.3 + 1e-9
            step, time = np.diff(rows[:, 1:], axis=0), np.diff(rows[:, 0])
            assert np.max(np.hypot(step[:, 0], step[:, 1]) / time) < 1.02 * PLACE.speed
            assert np.max(np.abs(step[:, 2]) / time) < 1.02 * PLACE.turn
        assert candidate.poses.shape == (2, MOMENTS, 3)
        if kind != "free":
            apart = np.hypot(*np.diff(candidate.poses, axis=0)[0, :, :2].T)
            assert apart.max() < 0.98 * 0.4
        plan_of(candidate, "candidate", PLACE, PAPER)
        candidate = varied(candidate, 0.3, PLACE, 0.4, rng)


def test_an_experiment_that_is_found_states_what_is_known_of_the_set_up():
    """Effects and tolerances of the parameter file are known of the next recording, too."""
    candidate = draw("free", PLACE, 0.4, np.random.default_rng(3))
    known = {"effects.clamp_angle.start": 0.02, "effects.clamp_angle.start_std": 0.01}
    settings = Settings.from_mapping(PAPER.flat() | known)
    made = read_experiment(
        yaml.safe_load(experiment_text(candidate, PLACE, settings, Noise(), "x")), "found", "test"
    )
    assert made.hidden.number("clamp_angle", "start") == 0.02
    assert made.guess.tolerances == {"clamp_angle.start": 0.01}
    assert made.guess.effects == {"clamp_angle": {"start": 0.02}}


@pytest.mark.slow
def test_the_search_beats_what_was_given_and_can_be_made():
    candidate, best = search(
        PAPER, PLACE, lambda p, n: outlook(p, PAPER, spans=n), budget=12, seed=1
    )
    assert best.gain > outlook(bundled("c_shape"), PAPER).gain
    tree = experiment_text(candidate, PLACE, PAPER, Noise(), "the best")
    made = read_experiment(yaml.safe_load(tree), "searched", "test")
    build_simulation(made, edges=60)  # settles
    assert made.truth.rod == PAPER.rod


@pytest.mark.parametrize("error", [SimulationError, InputError])
def test_a_candidate_that_cannot_be_simulated_is_worth_nothing(error):
    seen = []

    def judged(plan, spans):
        seen.append(plan.name)
        if len(seen) == 1:
            raise error("the simulated DLO is folded")
        return SimpleNamespace(gain=float(len(seen)), reliable=True)

    search(PAPER, PLACE, judged, budget=4, seed=1)
    assert seen == 4 * ["search"] + ["searched"]

    def never(plan, spans):
        raise error("the simulated DLO is folded")

    with pytest.raises(SimulationError, match=r"none of 4 .*is folded.*--tries"):
        search(PAPER, PLACE, never, budget=4, seed=1)


def test_the_best_of_the_finalists_that_can_be_relied_on_is_taken():
    final = []

    def judged(plan, spans):
        if spans is not None:
            return SimpleNamespace(gain=1.0, reliable=True)
        final.append((10.0 - len(final), len(final) > 0))  # the first cannot be relied on
        return SimpleNamespace(gain=final[-1][0], reliable=final[-1][1])

    _, best = search(PAPER, PLACE, judged, budget=6, seed=1, finalists=3)
    assert len(final) == 4 and best.gain == 9.0


def test_an_empty_workspace_is_refused():
    with pytest.raises(InputError, match=r"x from 0\.2 to 0\.1 m is empty"):
        Workspace((0.2, 0.1), (0.0, 0.1))


@pytest.mark.slow
def test_the_tool_writes_ranking_report_and_experiment(tmp_path, capsys):
    params, output = tmp_path / "params.yaml", tmp_path / "design"
    PAPER.dump(params)
    words = ["design", "--params", params, "--output", output, "--tries", "9", "--bounds", "-0.2",
             "0.2", "-0.1", "0.3", "simple", "c_shape"]  # fmt: skip
    assert main([str(w) for w in words]) == 0
    tree = json.loads((output / "design.json").read_text())
    names = [e["name"] for e in tree["experiments"]]
    assert set(names) == {"simple", "c_shape", "searched"}
    assert names.index("c_shape") < names.index("simple")
    assert tree["experiments"][0]["std"]["density"] is None
    load_experiment(output / "EXPERIMENT.yaml")
    report = (output / "report.html").read_text()
    assert "moves the DLO" in report and "<svg" in report
    assert "http" not in report
    assert "c_shape" in capsys.readouterr().out
    bad = ["design", "--params", str(params), "--output", str(output), "nothing"]
    assert main(bad) == 2
    assert "no such experiment" in capsys.readouterr().err
