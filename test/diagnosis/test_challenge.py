# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The generator of challenges: what it hides is there, as strong as it says, and nothing else."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from challenge import KINDS, confusion, draw, evaluate, generate, manipulations
from challenge.draws import NAMED, OTHERS, SET_UP
from challenge.manipulations import FREE, HELD
from challenge.residual import changed
from ordinary import some_of
from scipy.optimize import minimize_scalar

from dlo_ros.parameters import Settings
from dlo_ros.recordings.read import read_recording
from dlo_ros.synthesis.experiment import read_experiment
from dlo_ros.synthesis.hidden_effects import EFFECTS, FOREIGN
from dlo_ros.synthesis.synthesize import synthesize
from dlo_ros.synthesis.true_motion import build_simulation, simulate


def run(tree, edges=60, step=4e-3):
    made = read_experiment(tree, "challenge", "challenge")
    simulation, _ = build_simulation(made, edges=edges, step=step)
    return made, simulate(simulation, made.stamps, made.truth.rod.length)


def test_every_effect_can_be_drawn():
    drawn = set(NAMED) | set(SET_UP)
    # The first two do nothing in the plane, the others act where frames command.
    flat = {"anisotropy", "twisting_stiffness"}
    assert drawn == set(EFFECTS) - flat - {"grip_offset", "grip_angle"}
    assert set(OTHERS) == set(FOREIGN)


def test_effects_can_be_asked_for_by_name(monkeypatch, capsys):
    def solved_at_once(case, folder):
        kind, names = case
        outcome = "named" if names == ("wall",) else "wrong"
        return evaluate.Case(kind, names, outcome, names, 2.0, None, 1, 2, 1)

    monkeypatch.setattr(evaluate, "draw", lambda seed, kind, names: (kind, names))
    monkeypatch.setattr(evaluate, "solve", solved_at_once)
    words = "challenge --count 2 --effect wall --effect connector"
    monkeypatch.setattr("sys.argv", words.split())
    evaluate.main()
    lines = capsys.readouterr().out.splitlines()
    assert "wall, 2 cases: named 2; parameters within 10 % or 2 std: 2 of 4; median 2 s" in lines
    assert any(s.startswith("connector, 2 cases: wrong 2; ") for s in lines)
    assert any(s.startswith("single ") for s in lines)


def test_a_tilt_is_a_force_and_a_table_is_no_tilt():
    manipulation = manipulations.swing(np.random.default_rng(0))
    tree = {"parameters": confusion.ROPE, "duration": manipulations.DURATION}
    made = read_experiment(tree | manipulation.tree(confusion.LENGTH), "swing", "confusion")
    labels, found = confusion.matrix(made)
    tilt, force, table = map(labels.index, ("gravity_tilt", "constant_force, x", "wall, a table"))
    assert found[tilt, force] < 1.0 and found[force, tilt] < 1.0
    assert found[tilt, table] > 0.5 * confusion.FRAMES * 20 * 0.5
    # A drag is fitted beside all other effects, but not beside another drag.
    linear, quadratic = map(labels.index, ("air_drag", "quadratic_drag"))
    assert found[linear, quadratic] == pytest.approx(found[quadratic, linear], rel=1e-6)
    assert 1.0 < found[linear, quadratic] < 0.1 * found[linear, tilt]
    lines = confusion.confused(labels, [found], ["swing"])
    assert "| `gravity_tilt`, `constant_force, x` | 0 |" in lines
    assert not any("wall, a table`, `gravity" in line for line in lines)


@pytest.mark.slow
def test_a_seed_says_it_all():
    first, again = (draw(3, "single", ("constant_force",), recordings=2) for _ in range(2))
    assert first == again
    assert len(set(first.manipulations)) == len(first.trees) == 2
    assert first.effects["constant_force"]["x"] != 0.0 and not first.foreign
    low, high = KINDS["single"]
    assert low <= first.ratio["constant_force"] <= high
    null, other = draw(3, "none"), draw(4, "none")
    assert not null.effects and 2 <= len(null.trees) <= 4 and null != other


@pytest.mark.slow
@pytest.mark.parametrize("name", [*NAMED, *SET_UP, *OTHERS, "weak", "pair"])
def test_every_effect_reaches_the_strength_that_is_asked_for(name):
    for seed in range(100, 103):
        if name in KINDS:
            challenge = draw(seed, name)
        else:
            challenge = draw(seed, "foreign" if name in OTHERS else "single", (name,))
        low, high = KINDS[challenge.kind]
        assert all(low <= ratio <= high for ratio in challenge.ratio.values())
        assert len(challenge.ratio) == (2 if name == "pair" else 1)


def test_what_is_not_touched_beside_another_effect_is_not_hidden(monkeypatch):
    def shapes(trees, effects, foreign):
        # The stiffer rope passes by the peg.
        moved = 5e-3 * ("stiffness_gradient" in effects) or 2e-3 * ("obstacle" in effects)
        return SimpleNamespace(points=np.full((3, 4, 2), moved))

    monkeypatch.setattr(generate, "shapes", shapes)
    assert generate._all_act([], {"obstacle": {}}, 1e-3)
    assert not generate._all_act([], {"stiffness_gradient": {}, "obstacle": {}}, 1e-3)


@pytest.mark.long
@pytest.mark.parametrize(
    "kind", some_of([*FREE, *HELD], [FREE[0], HELD[0]]), ids=lambda k: k.__name__
)
def test_manipulations_bend_the_rope_within_reach(kind):
    """Soft and stiff ropes, both sides; the mirrored one moves as the mirror image."""
    for seed, stiffness in ((0, 1.3), (1, 4.5)):
        manipulation = kind(np.random.default_rng(seed))
        scale = 0.4 / stiffness
        parameters = {
            "rod": {
                "length": 0.4,
                "diameter": 0.005,
                "young_modulus": 9.81 * 1500 * 16 * (scale**3) / 0.005**2,
                "density": 1500.0,
            },
            "damping": {"air_drag": 0.02, "relaxation_time": 0.005},
        }
        common = {"parameters": parameters, "duration": 3.0}
        _, truth = run(common | manipulation.tree(0.4))
        moved = np.linalg.norm(truth.nodes - truth.nodes[0], axis=2)
        assert 0.02 < moved.max() < 0.9 and np.abs(truth.velocities[0]).max() == 0.0
        speed = np.linalg.norm(truth.velocities, axis=2)
        assert speed.max() < 4.0
        _, mirrored = run(common | manipulation.mirrored().tree(0.4))
        np.testing.assert_allclose(mirrored.nodes, truth.nodes * [-1.0, 1.0], atol=1e-4)


@pytest.mark.slow
def test_bags_hold_the_noise_and_nothing_else(tmp_path):
    challenge = draw(5, "none", recordings=2)
    bags = challenge.write(tmp_path / "set", edges=100, step=2e-3)
    assert (
        len(bags) == 2
        and json.loads((tmp_path / "set" / "challenge.json").read_text())["seed"] == 5
    )
    settings = Settings.load(tmp_path / "set" / "params.yaml")
    truth = challenge.trees[0]["parameters"]["rod"]
    assert settings.rod.density == pytest.approx(truth["density"], rel=0.06)
    assert settings.rod.density != truth["density"] and settings.rod.density_std > 0.0
    assert abs(np.log(settings.rod.young_modulus / truth["young_modulus"])) < 0.7
    for bag, tree in zip(bags, challenge.trees, strict=True):
        _, motion = run(tree, edges=100, step=2e-3)
        recording = read_recording(bag, settings)
        assert len(recording.observations) == 91
        errors = []
        for i, observation in enumerate(recording.observations):
            points = observation.points
            errors.append(points.positions - motion.centreline(i, points.u))
        rms = np.sqrt(np.mean(np.sum(np.square(errors), axis=2)))
        assert rms == pytest.approx(challenge.noise, rel=0.03)


@pytest.mark.slow
def test_the_effect_is_as_strong_as_stated(tmp_path):
    """Fit E again by brute force to the finely simulated, noisy recordings without the effect."""
    challenge = draw(7, "single", ("stiff_segment",), recordings=2)
    bags = challenge.write(tmp_path / "set")
    settings = Settings.load(tmp_path / "set" / "params.yaml")
    seen = [read_recording(bag, settings).observations for bag in bags]
    plain = [
        dict(t, parameters={k: v for k, v in t["parameters"].items() if k != "effects"})
        for t in challenge.trees
    ]

    def residual(change):
        total = []
        for tree, observations in zip(plain, seen, strict=True):
            _, motion = run(changed(tree, {}, {}, (change, 0.0)))
            for i in range(0, 91, 9):
                points = observations[i].points
                line = motion.centreline(i, points.u)
                along = np.gradient(line, axis=0)
                along /= np.linalg.norm(along, axis=1, keepdims=True)
                normal = np.column_stack([-along[:, 2], along[:, 0]])
                total.append(((points.positions - line)[:, [0, 2]] * normal).sum(axis=1))
        return float(np.mean(np.square(total)))

    around = challenge.absorbed["stiff_segment"]
    best = minimize_scalar(
        residual, bounds=(around - 0.15, around + 0.15), options={"maxiter": 7}, method="bounded"
    )
    ratio = np.sqrt(best.fun / challenge.noise**2 - 1.0)
    assert ratio == pytest.approx(challenge.ratio["stiff_segment"], rel=0.15)
    assert best.x == pytest.approx(around, abs=0.1)


@pytest.mark.slow
def test_the_camera_sees_the_rope(tmp_path, caplog):
    challenge = draw(1, "none", recordings=3)
    camera = {"width": 192, "height": 108, "focal_length": [145.0, 145.0], "rate": 2.0}
    small = replace(challenge, trees=tuple(t | {"camera": camera} for t in challenge.trees))
    for k, tree in enumerate(small.trees):
        made = read_experiment(tree, "small", "small")
        synthesize(made, tmp_path / str(k), edges=60, step=4e-3)
    assert "leaves the picture" not in caplog.text
