# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that a fit takes for a plain DLO: a creep for a much softer one that is damped strongly,
and a friction within the DLO for a stiffer one."""

import numpy as np
import pytest
from experiment_recordings import moving, true_modulus

from dlo_ros.diagnosis.explain.left_out import without
from dlo_ros.diagnosis.explain.trials import begun_instead
from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.effects import PlainRod, effects, starts
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.inference.joint_fit import ITERATIONS, fit
from dlo_ros.inference.plain_rod import instead_of_law
from dlo_ros.inference.priors import cause_priors

CREEP = {"share": 0.7, "time": 0.3}
FRICTION = {"moment": 0.001, "curvature": 3.0}


def prepared(effect, block):
    """A recording of the discrete rod with the set-up fitted, and the true E / mu."""
    recording, given = moving("simple", {effect: block}, 12)
    begun = begin([recording], given)
    found = training_set(begun, 1, begun.at.model.settings, given).prepared
    return found, true_modulus("simple")


@pytest.fixture(scope="module")
def creeping():
    return prepared("viscoelasticity", CREEP)


def begun_for(effect, found):
    """The fit that is begun with an effect instead of the plain rod; None: none is."""
    trials = begun_instead(found.setup, found.recordings, starts(found.scene))
    return next((t for t in trials if t[1].effect == effect), None)


def test_creep_is_found_where_the_fit_had_taken_it_for_damping(creeping):
    found, modulus = creeping
    soft = found.setup.model.settings
    assert soft.rod.specific_modulus < 0.4 * modulus
    assert soft.damping.relaxation_time > 0.1
    at, proposal = begun_for("viscoelasticity", found)
    assert at.posterior.evidence > found.setup.posterior.evidence + 100.0
    settings = at.model.settings
    creep = settings.effects["viscoelasticity"]
    assert settings.rod.specific_modulus == pytest.approx(modulus, rel=0.1)  # it has only begun
    assert creep["share"] == pytest.approx(CREEP["share"], abs=0.03)
    assert creep["time"] == pytest.approx(CREEP["time"], rel=0.2)
    # Without the creep it is the softer DLO again.
    bare = without(at, proposal, found.recordings)
    assert bare.posterior.evidence == pytest.approx(found.setup.posterior.evidence, abs=3.0)


@pytest.mark.slow
def test_no_creep_is_fitted_where_the_model_has_one_or_the_damping_is_as_guessed(creeping):
    found, _ = creeping
    begun = [s for s in starts(found.scene) if s.effect == "viscoelasticity"]
    ((at, _),) = begun_instead(found.setup, found.recordings, begun)
    assert begun_instead(at, found.recordings, begun) == []
    assert begun_instead(found.setup, found.recordings, []) == []
    elastic, _ = prepared("viscoelasticity", {"share": 0.0, "time": 1.0})
    assert begun_for("viscoelasticity", elastic) is None


@pytest.mark.slow
def test_friction_is_found_where_the_fit_had_taken_it_for_stiffness():
    found, modulus = prepared("hysteresis", FRICTION)
    assert found.setup.model.settings.rod.specific_modulus > 1.4 * modulus
    # Steps that do for the plain rod are too long for the livelier one with the friction.
    assert found.recordings[0].tolerance_with(["hysteresis"]) < found.recordings[0].tolerance
    at, _ = begun_for("hysteresis", found)
    assert at.posterior.evidence > found.setup.posterior.evidence + 30.0
    settings = fit(at, found.recordings, ITERATIONS).model.settings  # it has only begun
    assert settings.rod.specific_modulus == pytest.approx(modulus, rel=0.1)
    friction = settings.effects["hysteresis"]
    assert friction["moment"] == pytest.approx(FRICTION["moment"], rel=0.2)


@pytest.mark.parametrize("name", sorted(effects()))
def test_what_stands_for_a_plain_rod_is_taken_for_it(name, creeping):
    effect, scene = effects()[name], creeping[0].scene
    fitted, guessed = PlainRod(2e6, 0.4, 2e-10, 0.05, 2.0), PlainRod(9e6, 0.01, 2e-10, 0.01, 2.0)
    begun = [s for s in starts(scene) if s.effect == name]
    instead = effect.instead_of(fitted, guessed, begun)
    if instead is None:
        assert name not in ("viscoelasticity", "hysteresis", "quadratic_drag")
        return
    other, beside = instead
    assert np.allclose(other.taken_for(beside), fitted)


@pytest.mark.parametrize("name", sorted(effects()))
def test_the_law_by_which_stiffness_gives_way_says_how_much(name, creeping):
    effect, scene = effects()[name], creeping[0].scene
    begun = [s for s in starts(scene) if s.effect == name]
    stiff = PlainRod(9e6, 0.01, 2e-10)
    found = effect.that_gives_way(0.4, stiff, begun)
    assert (found is not None) == (name in ("viscoelasticity", "hysteresis"))
    if found is None:
        assert effect().giving_way(stiff) is None
        return
    law, beside = found
    share, whole = law.giving_way(beside)
    assert share == pytest.approx(0.4) and np.allclose(whole, stiff)


def test_of_two_laws_by_which_stiffness_gives_way_each_begins_in_the_other_s_place(creeping):
    meant, begun = creeping[0].meant, starts(creeping[0].scene)
    of_friction = next(s for s in begun if s.effect == "hysteresis")
    parameters, _ = cause_priors(meant.settings, of_friction)
    model = meant.extended("hysteresis", {"moment": 2e-3, "curvature": 4.0}, parameters)
    ((start, creep),) = instead_of_law(model, "hysteresis", begun)
    assert start.effect == "viscoelasticity" and "hysteresis" not in creep.settings.effects
    rod, before = creep.settings.rod, model.settings.rod
    more = 2e-3 / 4.0 / before.second_moment
    assert rod.young_modulus == pytest.approx(before.young_modulus + more)
    share = creep.settings.effects["viscoelasticity"]["share"]
    assert share == pytest.approx(more / rod.young_modulus)
    ((start, again),) = instead_of_law(creep, "viscoelasticity", begun)
    assert start.effect == "hysteresis"
    assert again.settings.rod.young_modulus == pytest.approx(before.young_modulus)
    assert instead_of_law(model, "gravity_tilt", begun) == []
    both = [s for s in begun if s.effect != "viscoelasticity"]
    assert instead_of_law(model, "hysteresis", both) == []


def test_a_damping_below_its_guess_stands_for_no_creep():
    creep = effects()["viscoelasticity"]
    assert creep.instead_of(PlainRod(9e6, 1e-3, 2e-10), PlainRod(9e6, 0.01, 2e-10), []) is None


@pytest.mark.parametrize(("drag", "tried"), [(0.005, False), (0.01, False), (0.019, True)])
def test_a_drag_above_its_guess_may_be_one_of_the_square_of_speed(drag, tried):
    """It is as strong at the speed of a swing."""
    fitted, guessed = (PlainRod(9e6, 0.01, 2e-10, c, 2.0) for c in (drag, 0.01))
    instead = effects()["quadratic_drag"].instead_of(fitted, guessed, [])
    assert (instead is not None) == tried
    if instead:
        assert instead[0].coefficient == pytest.approx((drag - 0.01) / 2.0)
        assert instead[1] == guessed
