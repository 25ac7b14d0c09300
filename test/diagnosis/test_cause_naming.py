# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Which of the causes that a search has found are named."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiment_recordings import fitted_set_up
from rods import PAPER

from dlo_ros.diagnosis.explain import cause_naming, cause_search
from dlo_ros.diagnosis.explain.certainty import SCALES, certain, strained
from dlo_ros.diagnosis.explain.joint_explanation import Explanation
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, freed, proposal_of
from dlo_ros.effects import Start
from dlo_ros.inference import joint_fit
from dlo_ros.inference.joint import borrowed
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import believed, material_priors

SERVING = SimpleNamespace(serves=lambda _: True, beside=lambda _: None)
"""An offer that no model is too far from."""


def evaluation(evidence, err):
    """A fit to one recording."""
    posterior = SimpleNamespace(evidence=evidence)
    return SimpleNamespace(posterior=posterior, mean_err=err, err=[np.full(9, err)])


def only_err_decides(monkeypatch):
    """A single cause, certain, which neither the set-up nor a plain rod stands for."""
    monkeypatch.setattr(cause_naming, "certain", lambda *_: True)
    monkeypatch.setattr(cause_naming, "beyond", lambda *_: [])
    monkeypatch.setattr(cause_naming, "_rivals", lambda *_, **__: {})
    monkeypatch.setattr(cause_naming, "strained", lambda *_: [])
    monkeypatch.setattr(cause_naming, "has_certainly_other_stiffness", lambda *_: False)


def test_what_is_not_known_of_the_weight_makes_no_force_doubtful():
    """A force that is known to a hundredth of the weight, on a DLO that was not weighed."""
    names = ["young_modulus", "density", "effects.constant_force.x"]
    off, share = np.array([0.0, 0.0, -0.04]), 1e-2
    force = np.array([0.0, 0.04, 0.0])  # for a change of ln mu
    covariance = np.diag([0.01, 0.49, (share * 0.04) ** 2])
    covariance[2, 2] += 0.49 * force[1] ** 2
    covariance[1, 2] = covariance[2, 1] = 0.49 * force[1]
    at = SimpleNamespace(
        model=SimpleNamespace(names=names, offset=lambda: off, index=names.index),
        posterior=SimpleNamespace(covariance=covariance),
    )
    start = Start("constant_force", {"x": 0.0}, ("x",), ("x",))
    group = proposal_of(PAPER, start)
    assert not certain(at, group)
    assert certain(at, group, SCALES)
    covariance[2, 2] += 0.03**2
    assert not certain(at, group, SCALES)


@pytest.mark.parametrize(
    ("linear", "loss", "without", "strained", "named"),
    [
        (40.0, 40.0, 2.0e-3, False, True),
        (4.0, 40.0, 2.0e-3, False, True),  # linearly it is not needed, but a fit needs it
        (40.0, 6.0, 2.0e-3, False, False),  # one of many that were tried
        (40.0, 2.0, 2.5e-3, False, True),  # without it shapes are far off
        (40.0, -1.0, 2.5e-3, False, False),
        (40.0, 40.0, 1.05e-3, False, False),  # immaterial
        (40.0, 40.0, 1.3e-3, False, False),  # no more than another's law asks for
        (40.0, 40.0, 1.3e-3, True, True),  # the set-up does its work beyond its tolerance
        (40.0, 40.0, 1.05e-3, True, True),  # all of it
        (40.0, 40.0, 0.9e-3, True, True),  # as near as the cause
        (40.0, 40.0, 0.9e-3, False, False),
    ],
)
def test_a_cause_matters_or_is_not_named(monkeypatch, linear, loss, without, strained, named):
    start = Start("point_mass", {"mass": 0.0}, ("mass",), ("mass",))
    others = [replace(start, effect=f"effect {k}") for k in range(15)]
    only_err_decides(monkeypatch)
    monkeypatch.setattr(cause_naming, "linear_loss", lambda *_, wholly: linear)
    tilt = proposal_of(PAPER, Start("gravity_tilt", {"angle": 0.0}, ("angle",), ("angle",)))
    monkeypatch.setattr(cause_naming, "strained", lambda *_: [tilt] * strained)
    monkeypatch.setattr(cause_naming, "approached", lambda at, *_: at)
    softer = replace(PAPER.rod, young_modulus=0.5 * PAPER.rod.young_modulus)
    bare = evaluation(-loss, without)
    tilted = replace(PAPER, rod=softer).with_effects({"gravity_tilt": {"angle": 0.3}})
    bare.model = SimpleNamespace(settings=tilted)
    neither = evaluation(-90.0, 5e-3)

    def without_some(_, group, *__, wholly):
        return bare if len(group.parameters) == 1 else neither

    monkeypatch.setattr(cause_naming, "without", without_some)
    at = evaluation(0.0, 0.9e-3)
    at.model = SimpleNamespace(settings=PAPER)
    found = SimpleNamespace(at=at, causes=(proposal_of(PAPER, start),), offer=SERVING)
    setup = evaluation(-50.0, 2e-3)
    causes, shifts = cause_naming.named(found, setup, {}, (), [start, *others], 0.85e-3, 0.5e-3)
    assert [c.effect for c in causes] == (["point_mass"] if named else [])
    if named and without <= at.mean_err:  # one of the two acts: without both shapes are far off
        assert causes[0].rivals == {"gravity_tilt": {"angle": 0.3}}
        assert causes[0].err == neither.mean_err
    told = Explanation(at, at, causes, 0.0, 0.0, 0.0, (), (), shifts)
    # A cause that is not named may act or not, and a rival may act in its place: E / mu may be that
    # with it or without.
    known = named and not causes[0].rivals
    assert told.stiffness_doubt == pytest.approx(0.0 if known else np.log(2.0))


@pytest.mark.parametrize("acts", [True, False])
def test_the_stiffness_beside_a_rival_is_doubtful(monkeypatch, acts):
    """E / mu beside a rival that acts just as well is a third of that beside the cause."""
    mass = Start("point_mass", {"mass": 0.0}, ("mass",), ("mass",))
    only_err_decides(monkeypatch)
    softer = replace(PAPER.rod, young_modulus=PAPER.rod.young_modulus / 3.0)
    at, bare, other = (evaluation(*x) for x in ((0.0, 0.9e-3), (-40.0, 2e-3), (-1.0, 0.9e-3)))
    at.model = bare.model = SimpleNamespace(settings=PAPER)
    other.model = SimpleNamespace(settings=replace(PAPER, rod=softer))
    rivals = {"constant_force": (other, {"x": 0.3})} if acts else {}
    monkeypatch.setattr(cause_naming, "_rivals", lambda *_, **__: rivals)
    monkeypatch.setattr(cause_naming, "approached", lambda at, *_: at)
    bares = {proposal_of(PAPER, mass).label: bare}
    found = SimpleNamespace(at=at, causes=(proposal_of(PAPER, mass),), offer=SERVING)
    causes, shifts = cause_naming.named(
        found, evaluation(-50.0, 2e-3), bares, (), [mass], 0.85e-3, 0.5e-3
    )
    assert causes[0].rivals == ({"constant_force": {"x": 0.3}} if acts else {})
    told = Explanation(at, at, causes, 0.0, 0.0, 0.0, (), (), shifts)
    assert told.stiffness_doubt == pytest.approx(np.log(3.0) if acts else 0.0)


@pytest.mark.parametrize(("alone", "named"), [(5e-3, ["hysteresis"]), (1.1e-3, [])])
def test_of_two_that_do_each_other_s_work_one_is_named(monkeypatch, alone, named):
    """A friction and a creep: without either the rest comes within the measurement's error."""
    friction = Start("hysteresis", {"moment": 0.1}, ("moment",), ("moment",))
    creep = Start("viscoelasticity", {"share": 0.0}, ("share",), ("share",))
    causes = tuple(proposal_of(PAPER, s) for s in (creep, friction))
    values = {"hysteresis": {"moment": 0.2}, "viscoelasticity": {"share": 0.3}}
    at = evaluation(0.0, 0.9e-3)
    bare = {"hysteresis": evaluation(-900.0, 1.1e-3), "viscoelasticity": evaluation(-90.0, 1.0e-3)}
    for fit in (at, *bare.values()):
        fit.model = SimpleNamespace(settings=PAPER.with_effects(values))
    setup = evaluation(-5000.0, alone)
    setup.model = SimpleNamespace(settings=PAPER)
    only_err_decides(monkeypatch)
    monkeypatch.setattr(cause_naming, "without", lambda _, group, *__, wholly: bare[group.effect])
    monkeypatch.setattr(cause_naming, "approached", lambda at, *_: at)
    found = SimpleNamespace(at=at, causes=causes, offer=SERVING)
    told, _ = cause_naming.named(found, setup, {}, (), [friction, creep], 0.9e-3, 0.05e-3)
    assert [c.effect for c in told] == named
    assert not named or told[0].rivals == {"viscoelasticity": {"share": 0.3}}


@pytest.mark.parametrize(("near", "named"), [(0.82e-3, False), (1.9e-3, True)])
def test_a_fit_without_a_cause_that_has_only_drifted_does_not_tell_of_it(monkeypatch, near, named):
    """Without a hundredth of the mass at its tip, a fit lay twice as far from the shapes as that
    model can come.
    """
    start = Start("point_mass", {"mass": 0.0}, ("mass",), ("mass",))
    at, bare = evaluation(0.0, 1.14e-3), evaluation(-40.0, 1.89e-3)
    nearest = {id(at): evaluation(0.0, 0.65e-3), id(bare): evaluation(0.0, near)}
    at.model = bare.model = SimpleNamespace(settings=PAPER)
    only_err_decides(monkeypatch)
    monkeypatch.setattr(cause_naming, "without", lambda *_, wholly: bare)
    monkeypatch.setattr(cause_naming, "approached", lambda at, *_: nearest[id(at)])
    found = SimpleNamespace(at=at, causes=(proposal_of(PAPER, start),), offer=SERVING)
    setup = evaluation(-80.0, 1.5e-3)
    causes, _ = cause_naming.named(found, setup, {}, (), [start], 0.54e-3, 0.21e-3)
    assert bool(causes) is named


@pytest.mark.parametrize(
    ("beside", "without", "own", "least", "stiffer", "named"),
    [
        (0.5e-3, 0.6e-3, 0.69e-3, 0.05e-3, False, False),
        (0.5e-3, 0.77e-3, 0.69e-3, 0.05e-3, False, True),
        (0.29e-3, 0.35e-3, 0.35e-3, 0.3e-3, False, False),
        (0.29e-3, 0.35e-3, 0.35e-3, 0.3e-3, True, True),
        (0.89e-3, 0.89e-3, 1.2e-3, 0.3e-3, False, False),  # a creep comes no nearer at all
        (0.89e-3, 0.89e-3, 1.2e-3, 0.3e-3, True, True),
    ],
)
def test_what_comes_nearer_than_the_measurement_errs_is_judged_by_what_is_left(
    monkeypatch, beside, without, own, least, stiffer, named
):
    """Friction within a DLO, by 350 of log evidence: steps towards the shapes follow the camera's
    staying error of 0.69 mm, too, to 0.77 mm without the friction and to 0.5 mm with it. Where they
    come as near without it, E / mu may be half as large again all the same.
    """
    start = Start("hysteresis", {"moment": 0.1}, ("moment",), ("moment",), neutral=False)
    at, bare = evaluation(0.0, beside), evaluation(-350.0, without)
    at.model = bare.model = SimpleNamespace(settings=PAPER)
    at.err, bare.err = [np.full(9, beside)], [np.full(9, without)]
    only_err_decides(monkeypatch)
    monkeypatch.setattr(cause_naming, "has_certainly_other_stiffness", lambda *_: stiffer)
    monkeypatch.setattr(cause_naming, "taken_for_plain", lambda model, _: model)
    monkeypatch.setattr(cause_naming, "without", lambda *_, wholly: bare)
    monkeypatch.setattr(cause_naming, "approached", lambda at, *_: at)
    found = SimpleNamespace(at=at, causes=(proposal_of(PAPER, start),), offer=SERVING)
    causes, _ = cause_naming.named(found, bare, {}, (), [start], own, least)
    assert bool(causes) is named


def test_a_fit_without_a_cause_that_explains_less_than_the_set_up_has_gone_astray(monkeypatch):
    start = Start("hysteresis", {"moment": 0.1}, ("moment",), ("moment",), neutral=False)
    at, bare, setup = evaluation(0.0, 1e-3), evaluation(-900.0, 9e-3), evaluation(-40.0, 3e-3)
    at.model = bare.model = setup.model = SimpleNamespace(settings=PAPER)
    only_err_decides(monkeypatch)
    monkeypatch.setattr(cause_naming, "linear_loss", lambda *_, wholly: 40.0)
    monkeypatch.setattr(cause_naming, "without", lambda *_, wholly: bare)
    monkeypatch.setattr(cause_naming, "approached", lambda at, *_: at)
    found = SimpleNamespace(at=at, causes=(proposal_of(PAPER, start),), offer=SERVING)
    (cause,), _ = cause_naming.named(found, setup, {}, (), [start], 0.85e-3, 0.5e-3)
    assert (cause.evidence, cause.err) == (40.0, 3e-3)


def test_what_acts_now_and_then_counts_where_it_acts():
    """A peg that is hit in one of four recordings; a mass acts in all."""
    at, bare = evaluation(0.0, 1e-3), evaluation(0.0, 2e-3)
    at.err = [np.full(9, 1e-3)] * 4
    bare.err = [*at.err[:3], np.full(9, 5e-3)]
    for steady, errs in ((True, (1e-3, 2e-3)), (False, (1e-3, 5e-3))):
        group = SimpleNamespace(from_nothing=steady)
        assert cause_naming._errs_where_it_acts(at, bare, group) == pytest.approx(errs)


@pytest.mark.parametrize(("steady", "named"), [(True, False), (False, True)])
def test_what_acts_in_one_recording_is_named_though_others_lie_farther_off(
    monkeypatch, steady, named
):
    """A wall that is hit in one of three recordings, by 9374 of log evidence: that came from 3.3 to
    0.9 mm, and others, which a fit without it had followed at any price, from 1.7 to 2.8 mm.
    """
    start = Start("wall", {"offset": 0.0, "angle": 0.0}, ("offset",), ("offset",), neutral=False)
    at, bare = evaluation(0.0, 2.44e-3), evaluation(-9374.0, 2.35e-3)
    at.err = [np.full(9, e) for e in (2.8e-3, 0.9e-3, 3.6e-3)]
    bare.err = [np.full(9, e) for e in (1.7e-3, 3.3e-3, 2.0e-3)]
    at.model = bare.model = SimpleNamespace(settings=PAPER)
    monkeypatch.setattr(Proposal, "from_nothing", property(lambda _: steady))
    only_err_decides(monkeypatch)
    monkeypatch.setattr(cause_naming, "without", lambda *_, wholly: bare)
    monkeypatch.setattr(cause_naming, "approached", lambda at, *_: at)
    found = SimpleNamespace(at=at, causes=(proposal_of(PAPER, start),), offer=SERVING)
    causes, _ = cause_naming.named(found, bare, {}, (), [start], 2.1e-3, 0.25e-3)
    assert bool(causes) is named


@pytest.mark.parametrize(("loss", "kept"), [(4.0, False), (12.0, True)])
def test_what_may_or_may_not_act_does_not_stand_for_what_does(monkeypatch, loss, kept):
    starts = [Start(name, {"size": 0.0}, ("size",), ("size",)) for name in ("damping", "creep")]
    causes = tuple(SimpleNamespace(effect=s.effect, label=s.effect, start=s) for s in starts)

    def model(evidence, young_modulus):
        found = evaluation(evidence, 1e-3)
        rod = replace(PAPER.rod, young_modulus=young_modulus)
        found.model = SimpleNamespace(settings=replace(PAPER, rod=rod))
        return found

    both, damping, creep = model(100.0, 1e6), model(100.0 - loss, 2e6), model(97.0, 1e6)
    left = {(id(both), "creep"): damping, (id(both), "damping"): creep}

    def without(at, cause, _, wholly):
        return left.get((id(at), cause.effect), model(0.0, 1e6))

    monkeypatch.setattr(cause_naming, "linear_loss", lambda *_, wholly: 0.0)
    monkeypatch.setattr(cause_naming, "without", without)
    search = cause_search.Search(both, causes, (), None)
    found, bares, shifts = cause_naming.without_needless(search, (), starts, complete=True)
    # Without the creep the damping is needed; with it, either of them is enough.
    assert [c.effect for c in found.causes] == (["creep"] if kept else ["damping"])
    assert found.at is (creep if kept else damping)
    # The fits without single causes are those of the model that is left.
    assert set(bares) <= {c.label for c in found.causes}
    assert all(bare.posterior.evidence < found.at.posterior.evidence for bare in bares.values())
    assert shifts == pytest.approx({"damping": 0.0} if kept else {"creep": np.log(2.0)})


@pytest.mark.parametrize(
    ("near", "loss", "complete", "kept"),
    [
        # Where a law is unknown, an effect does not stay in the model for its evidence alone.
        ({"damping": 1.05e-3, "creep": 1.05e-3}, 60.0, False, []),
        ({"damping": 1.05e-3, "creep": 1.5e-3}, 60.0, False, ["creep"]),
        ({"damping": 1.5e-3, "creep": 1.5e-3}, 60.0, False, ["creep", "damping"]),
        # Each takes less than a tenth away, beside what is left, and both together more.
        ({"damping": 1.09e-3, "creep": 1.18e-3}, 60.0, False, ["creep"]),
        ({"damping": 1.05e-3, "creep": 1.05e-3}, 60.0, True, ["creep", "damping"]),
        # Nor does it leave it for that: a friction came 9.4 mm near, 22 without a guessed damping.
        ({"damping": 2.2e-3, "creep": 1.5e-3}, -5.0, False, ["creep", "damping"]),
    ],
)
def test_in_a_wrong_model_only_what_brings_it_nearer_is_kept(
    monkeypatch, near, loss, complete, kept
):
    start = Start("creep", {"size": 0.0}, ("size",), ("size",))
    creep = SimpleNamespace(effect="creep", label="creep", start=start)
    damping = SimpleNamespace(effect="damping", label="damping", start=None)
    tried = []

    def model(evidence, err, groups):
        found = evaluation(evidence, err)
        found.model = SimpleNamespace(settings=PAPER)
        found.groups = groups
        return found

    def without(at, group, _, wholly):
        tried.append(group.label)
        left = [g for g in at.groups if g != group.label]
        return model(at.posterior.evidence - loss, near[group.label], left)

    monkeypatch.setattr(cause_naming, "linear_loss", lambda *_, wholly: loss)
    monkeypatch.setattr(cause_naming, "without", without)
    monkeypatch.setattr(joint_fit, "approached", lambda at, *_: at)
    monkeypatch.setattr(cause_naming, "_guessed_dampings", lambda _: [damping])
    both = model(100.0, 1e-3, ["creep", "damping"])
    search = cause_search.Search(both, (creep,), (), None)
    found, bares, shifts = cause_naming.without_needless(search, (), [start], complete=complete)
    assert found.at.groups == kept and [c.effect for c in found.causes] == kept[:1]
    assert tried == ([] if complete else ["damping", "creep"])
    assert set(shifts) == {"creep", "damping"} - set(kept)
    assert all(label in kept for label in bares)


@pytest.mark.slow
def test_a_damping_that_is_left_out_has_its_guess_and_keeps_it():
    at, recordings = fitted_set_up()
    (damping,) = [g for g in freed(at.model) if g.effect == "internal_damping"]
    guess = damping.parameters[0].outer(damping.parameters[0].centre)
    assert at.model.settings.damping.relaxation_time != pytest.approx(guess)
    bare = cause_search.without(at, damping, recordings, wholly=True)
    assert bare is not None and "relaxation_time" not in bare.model.names
    assert bare.model.settings.damping.relaxation_time == pytest.approx(guess)
    assert set(bare.model.names) == set(at.model.names) - {"relaxation_time"}


@pytest.mark.slow
def test_a_set_up_is_strained_where_it_leaves_its_tolerance_without_a_cause():
    at, recordings = fitted_set_up()
    tilt = at.model.index("effects.gravity_tilt.angle")

    def tilted(tolerances):
        theta = at.model.theta()
        theta[tilt] = tolerances * at.model.parameters[tilt].std
        return borrowed(at, at.model.at(theta), recordings)

    assert [g.effect for g in strained(tilted(4.0), tilted(0.5))] == ["gravity_tilt"]
    assert not strained(tilted(1.5), tilted(0.0))  # within tolerance
    assert not strained(tilted(4.0), tilted(3.0))  # so it is with the cause


def test_what_was_measured_beforehand_stays_near_its_value():
    weighed = replace(PAPER, rod=replace(PAPER.rod, density_std=0.01 * PAPER.rod.density))
    model = ParametricModel(weighed, material_priors(weighed))
    far = believed(model).at(model.theta() + 1.0).settings.rod
    assert far.density / weighed.rod.density == pytest.approx(np.exp(0.04))
    # A modulus that is only guessed may be anything.
    assert far.young_modulus / weighed.rod.young_modulus == pytest.approx(np.e)


@pytest.mark.parametrize(("near", "kept"), [(1.05e-3, []), (1.5e-3, ["camera_rotation"])])
def test_in_a_wrong_model_the_set_up_stays_within_tolerance(monkeypatch, near, kept):
    """Numbers beyond it that bring the model no nearer would spoil other motions."""
    turned = SimpleNamespace(effect="camera_rotation", label="camera_rotation", start=None)
    at = evaluation(100.0, 1e-3)
    at.model = SimpleNamespace(settings=PAPER)
    within = evaluation(60.0, near)
    within.model = at.model

    def without(_, group, __, wholly):
        assert group is turned and not wholly
        return within

    monkeypatch.setattr(cause_naming, "without", without)
    monkeypatch.setattr(joint_fit, "approached", lambda at, *_: at)
    monkeypatch.setattr(cause_naming, "_guessed_dampings", lambda _: [])
    search = cause_search.Search(at, (turned,), (), None)
    found, bares, _ = cause_naming.without_needless(search, (), [], complete=False)
    assert [c.effect for c in found.causes] == kept
    assert found.at is (at if kept else within)
    assert not bares  # of numbers of the set-up, naming needs fits with all of them at neutral
