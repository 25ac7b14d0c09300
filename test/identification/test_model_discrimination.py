# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Which manipulation separates two causes: answers known from physics, and fits to another rod."""

from dataclasses import replace

import numpy as np
import pytest
from challenge.confusion import LENGTH, ROPE
from challenge.generate import _recordings
from challenge.manipulations import DURATION, swing, u_shape, wave
from experiment_recordings import recorded
from ordinary import some_of
from rods import PAPER

from dlo_ros.cli.design import experiment_plan
from dlo_ros.effects import Scene
from dlo_ros.errors import InputError, ParameterError, SimulationError
from dlo_ros.identification.design.expected_information import Noise
from dlo_ros.identification.design.model_discrimination import (
    _model,
    _with_same_spans,
    discriminate,
    hardest,
)
from dlo_ros.identification.design.plausible_explanations import (
    AssumedEffect,
    plausible_explanation,
)
from dlo_ros.inference.forecast import forecast
from dlo_ros.inference.joint import evaluate
from dlo_ros.inference.joint_fit import settled
from dlo_ros.inference.measured import measured
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.smooth_modes import whitening
from dlo_ros.parameters import DampingParameters
from dlo_ros.synthesis.experiment import read_experiment

SPANS, RATE = 14, 10.0
SURE, OPEN = 5.0, 3.0  # log evidence: 150 to one, twenty to one
HELD = Scene(PAPER.scale, ("start", "end"), ("start", "end"), 10.0)
GIVES = AssumedEffect("clamp_compliance", {"start": 1.0})
TURNED = AssumedEffect("clamp_angle", {"start": 0.05})
CREEP = AssumedEffect("viscoelasticity", {"share": 0.1, "time": 0.1})
FRICTION = AssumedEffect("hysteresis", {"moment": 3e-4, "curvature": 1.0})


def planned(kind):
    """The rope and a manipulation of `challenge.confusion`."""
    tree = {"parameters": ROPE, "duration": DURATION}
    motion = kind(np.random.default_rng(0)).tree(LENGTH)
    made = read_experiment(tree | motion, kind.__name__, "test")
    return replace(experiment_plan(made, made.truth), rate=RATE), made.truth


def separated(kind, *explanations, duration=DURATION):
    plan, rope = planned(kind)
    return discriminate(replace(plan, duration=duration), rope, explanations, spans=SPANS)


def test_a_grip_that_gives_is_a_turned_one_at_rest_and_another_in_motion():
    """One moment, one angle: only a moment that changes separates them (docs/effects.md)."""
    assert separated(swing, GIVES, TURNED, duration=0.0).gain < OPEN
    found = separated(swing, GIVES, TURNED)
    assert found.gain > SURE
    assert found.reliable and set(found.pair) == {"clamp_compliance", "clamp_angle"}
    assert len(found.imitation) == len(found.forecast.predicted)


def test_all_explanations_have_the_short_spans_that_one_of_them_needs():
    """A grip that gives next to nothing was separated from nothing by errors of discretisation."""
    plain = _with_same_spans(PAPER, [TURNED, GIVES])
    assert plain.gives and plain.effects == {"clamp_compliance": {"start": 0.0}}
    assert _with_same_spans(plain, [GIVES]) is plain
    assert _with_same_spans(PAPER, [TURNED, CREEP]) is PAPER


def test_a_mass_at_a_held_end_is_not_seen():
    mass = AssumedEffect("point_mass", {"mass": 0.006, "position": LENGTH})
    softer = AssumedEffect("stiffness_gradient", {"change": 0.3})
    held, free = (separated(kind, mass, softer) for kind in (u_shape, wave))
    assert held.evidence[0, 1] < 0.5  # whatever else is fitted to it does nothing, either
    assert held.evidence[1, 0] > SURE  # a mass there is no gradient
    assert held.gain < OPEN < SURE < free.gain


def test_slow_motion_to_and_fro_separates_friction_from_creep_and_rest_does_not():
    """What has not been bent to and fro yet rubs nowhere, and what has crept is only softer."""
    assert separated(wave, CREEP, FRICTION, duration=0.0).gain < 0.5
    assert separated(wave, CREEP, FRICTION).gain > SURE


def test_the_worst_pair_and_direction_counts():
    tilt = AssumedEffect("gravity_tilt", {"angle": 0.05})
    three = separated(swing, GIVES, TURNED, tilt)
    two = separated(swing, GIVES, TURNED)
    assert three.evidence[:2, :2] == pytest.approx(two.evidence, rel=0.2, abs=3.0)
    away = three.evidence[~np.eye(3, dtype=bool)]
    assert three.gain == pytest.approx(max(away.min(), 0.0))
    assert three.effects == ("clamp_compliance", "clamp_angle", "gravity_tilt")
    assert hardest(np.array([[0.0, -1.0], [2.0, 0.0]])) == (0, 1)


def test_more_of_an_effect_is_separated_better():
    weak = [replace(e, block={k: 0.2 * v for k, v in e.block.items()}) for e in (GIVES, TURNED)]
    assert separated(swing, *weak).gain < 0.3 * separated(swing, GIVES, TURNED).gain


def test_a_manipulation_that_cannot_be_simulated_is_refused():
    plan, rope = planned(swing)
    slack = AssumedEffect("length_error", {"difference": 10.0})
    with pytest.raises(SimulationError):
        discriminate(plan, rope, (GIVES, slack), spans=SPANS)


def test_sizes_are_those_of_a_cause():
    turned = plausible_explanation("clamp_angle", PAPER, HELD)
    assert turned.block == {"start": pytest.approx(np.radians(9.0)), "end": turned.block["start"]}
    stated = replace(PAPER, tolerances={"clamp_angle.start": 0.01, "clamp_angle.end": 0.02})
    assert plausible_explanation("clamp_angle", stated, HELD).block == {"start": 0.03, "end": 0.06}
    mass = plausible_explanation("point_mass", PAPER, HELD).block
    assert mass["mass"] == pytest.approx(0.3 * PAPER.scale.mass)
    assert 0.0 < mass["position"] < PAPER.rod.length
    given = plausible_explanation("point_mass", PAPER, HELD, {"mass": 0.01})
    assert given.block == {"mass": 0.01}


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(ParameterError, match="no effect 'moonlight'; known are"):
        plausible_explanation("moonlight", PAPER, HELD)
    with pytest.raises(InputError, match=r"state damping\.air_drag_std"):
        plausible_explanation("air_drag", PAPER, HELD, {"coefficient": 0.1})
    known = replace(HELD, known=("air_drag",))
    windy = replace(PAPER, damping=DampingParameters(air_drag=0.1, air_drag_std=0.01))
    assert plausible_explanation("air_drag", windy, known).block["coefficient"] > 0.0
    with pytest.raises(InputError, match="state its values in the parameter file"):
        plausible_explanation("obstacle", PAPER, HELD)


@pytest.mark.parametrize(
    "where",
    some_of([(swing, "wall"), (u_shape, "wall"), (wave, "clamp_slip")], [(wave, "clamp_slip")]),
)
def test_a_start_is_taken_that_makes_sense_in_the_manipulation(where):
    """No wall through a grip, no slip after the end: both explanations can be told apart."""
    kind, effect = where
    plan, rope = planned(kind)
    plan = replace(plan, duration=2.0)
    recording = plan.manipulation()
    seen = scene(rope, imposed_names([recording]), [forecast(recording, rope).predicted])
    taken = plausible_explanation(effect, rope, seen, None, (plan,))
    if "onset" in taken.block:
        assert taken.block["onset"] < plan.duration
    tilt = AssumedEffect("gravity_tilt", {"angle": 0.05})
    found = discriminate(plan, rope, (taken, tilt), spans=SPANS)
    assert found.reliable and found.evidence[0, 1] > SURE


def seen_with_noise(tree, seed, noise):
    """A recording of the discrete rod, its splines with noise that is white along the DLO."""
    exact = tree | {"measurement": tree["measurement"] | {"std": 1e-7}}
    recording, _, truth = recorded(exact, seed, step=1e-3)
    n, length = truth.rod.control_points, truth.rod.length
    std = noise.std / np.sqrt(length / noise.spacing + 1.0)
    rng = np.random.default_rng(seed)
    observations = []
    for o in recording.observations:
        shape = o.control_points.copy()
        shape[:, [0, 2]] += np.linalg.solve(whitening(n, length), std * rng.normal(size=(n, 2)))
        observations.append(replace(o, control_points=shape, points=None))
    return replace(recording, observations=tuple(observations))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed", "a", "b"), [(swing, 30, GIVES, TURNED), (swing, 30, CREEP, FRICTION)]
)
def test_the_expected_log_evidence_is_that_of_fits_to_recordings_of_another_rod(kind, seed, a, b):
    rng = np.random.default_rng([seed, 5])
    tree = _recordings(rng, [kind(rng)], 3e-4)
    made = read_experiment(tree[0], kind.__name__, "test")
    known = made.truth
    noise = Noise(3e-4, known.rod.length / 100, common=0.0, along=0.0)
    expected = discriminate(experiment_plan(made, known), known, (a, b), noise)
    fitted = []
    for true, rival in ((a, b), (b, a)):
        effects = {true.effect: dict(true.block)}
        hidden = tree[0] | {"parameters": tree[0]["parameters"] | {"effects": effects}}
        seen = measured(seen_with_noise(hidden, seed, noise), known)
        view = scene(known, imposed_names([seen.manipulation]), [seen.observed])
        models = [_model(e, (a, b), known, view) for e in (true, rival)]
        found = [settled(evaluate(m, [seen]), [seen]).posterior.evidence for m in models]
        fitted.append(found[0] - found[1])
    assert 0.5 < expected.gain / min(fitted) < 2.0
