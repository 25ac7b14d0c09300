# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Which of the causes that a search has found are named."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cause_fits import evaluation, model_of, more_evidence
from experiment_recordings import fitted_set_up
from rods import PAPER

from dlo_ros.diagnosis.explain import cause_judge, cause_naming, cause_search
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.certainty import SCALES, certain, strained
from dlo_ros.diagnosis.explain.explanation import Explanation
from dlo_ros.diagnosis.explain.rivals import Rival
from dlo_ros.diagnosis.proposals.linear_evidence import proposal_of
from dlo_ros.effects import Start
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.inference.joint import borrowed
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import believed, material_priors

SERVING = SimpleNamespace(serves=lambda _: True, beside=lambda _: None)
"""An offer that no model is too far from."""


def other_stiffness(told):
    """Largest change of ln(E / mu) by what may or may not act."""
    return max((abs(d["young_modulus"] - d["density"]) for d in told.doubts), default=0.0)


def stand_in(monkeypatch, name, replacement):
    """Put something in the place of a function that the naming uses."""
    users = [module for module in (cause_naming, cause_judge) if hasattr(module, name)]
    assert users, name
    for module in users:
        monkeypatch.setattr(module, name, replacement)
    if name == "approached":
        monkeypatch.setattr(cause_naming, "nearest_err", lambda *x: replacement(*x).mean_err)


def only_err_decides(monkeypatch):
    """A single cause, certain, which neither the set-up nor a plain rod stands for."""
    stand_in(monkeypatch, "certain", lambda *_: True)
    stand_in(monkeypatch, "beyond", lambda *_: [])
    stand_in(monkeypatch, "rivals_of", lambda *_, **__: {})
    stand_in(monkeypatch, "strained", lambda *_: [])
    stand_in(monkeypatch, "has_certainly_other_stiffness", lambda *_: False)


def is_named(monkeypatch, start, at, bare, owns, least, *, setup=None, complete=True):
    """Whether the one cause of a model is named, of fits that cannot come nearer to the shapes."""
    stand_in(monkeypatch, "without", lambda *_, wholly: bare)
    stand_in(monkeypatch, "approached", lambda at, *_: at)
    found = SimpleNamespace(at=at, causes=(proposal_of(PAPER, start),), offer=SERVING, passed=())
    causes, *_ = cause_naming.named(
        found, setup or bare, {}, (), [start], owns, least, complete=complete
    )
    return bool(causes)


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
        (40.0, 40.0, 1.12e-3, False, False),  # no more than another's law asks for
        (40.0, 40.0, 1.12e-3, True, True),  # the set-up does its work beyond its tolerance
        (40.0, 40.0, 1.2e-3, False, True),  # no more, but a fourth of all
        (40.0, 40.0, 1.05e-3, True, True),  # all of it
        (40.0, 40.0, 0.9e-3, True, True),  # as near as the cause
        (40.0, 40.0, 0.9e-3, False, False),
    ],
)
def test_a_cause_matters_or_is_not_named(monkeypatch, linear, loss, without, strained, named):
    start = Start("point_mass", {"mass": 0.0}, ("mass",), ("mass",))
    others = [replace(start, effect=f"effect {k}") for k in range(15)]
    only_err_decides(monkeypatch)
    stand_in(monkeypatch, "linear_loss", lambda *_, wholly: linear)
    tilt = proposal_of(PAPER, Start("gravity_tilt", {"angle": 0.0}, ("angle",), ("angle",)))
    twins = [proposal_of(PAPER, start), tilt] * strained  # the first is the same effect elsewhere
    stand_in(monkeypatch, "strained", lambda *_: twins)
    stand_in(monkeypatch, "approached", lambda at, *_: at)
    softer = replace(PAPER.rod, young_modulus=0.5 * PAPER.rod.young_modulus)
    bare = evaluation(-loss, without)
    effects = {"gravity_tilt": {"angle": 0.3}, "point_mass": {"mass": 0.1, "position": 0.2}}
    bare.model = model_of(replace(PAPER, rod=softer).with_effects(effects))
    neither = evaluation(-90.0, 5e-3)

    def without_some(_, group, *__, wholly):
        return bare if len(group.parameters) == 1 else neither

    stand_in(monkeypatch, "without", without_some)
    at = evaluation(0.0, 0.9e-3)
    at.model = model_of(PAPER)
    found = SimpleNamespace(at=at, causes=(proposal_of(PAPER, start),), offer=SERVING, passed=())
    setup = evaluation(-50.0, 2e-3)
    setup.model = at.model
    causes, shifts, _ = cause_naming.named(
        found, setup, {}, (), [start, *others], [0.85e-3], 0.5e-3
    )
    assert [c.effect for c in causes] == (["point_mass"] if named else [])
    if named and without <= at.mean_err:  # one of the two acts: without both shapes are far off
        assert causes[0].rivals == {"gravity_tilt": {"angle": 0.3}}
        assert causes[0].err == neither.mean_err
    told = Explanation(at, at, causes, 0.0, 0.0, 0.0, (), (), shifts)
    # A cause that is not named may act or not, and a rival may act in its place: E / mu may be that
    # with it or without.
    known = named and not causes[0].rivals
    assert other_stiffness(told) == pytest.approx(0.0 if known else np.log(2.0))


@pytest.mark.parametrize("acts", [True, False])
def test_the_stiffness_beside_a_rival_is_doubtful(monkeypatch, acts):
    """E / mu beside a rival that acts just as well is a third of that beside the cause."""
    mass = Start("point_mass", {"mass": 0.0}, ("mass",), ("mass",))
    only_err_decides(monkeypatch)
    softer = replace(PAPER.rod, young_modulus=PAPER.rod.young_modulus / 3.0)
    at, bare, other = (evaluation(*x) for x in ((0.0, 0.9e-3), (-40.0, 2e-3), (-1.0, 0.9e-3)))
    at.model = bare.model = model_of(PAPER)
    other.model = model_of(replace(PAPER, rod=softer))
    force = proposal_of(PAPER, Start("constant_force", {"x": 0.0}, ("x",), ("x",)))
    rivals = {force.effect: Rival(other, force, {"x": 0.3})} if acts else {}
    stand_in(monkeypatch, "rivals_of", lambda *_, **__: rivals)
    stand_in(monkeypatch, "approached", lambda at, *_: at)
    bares = {proposal_of(PAPER, mass).label: bare}
    found = SimpleNamespace(at=at, causes=(proposal_of(PAPER, mass),), offer=SERVING, passed=())
    setup = evaluation(-50.0, 2e-3)
    setup.model = at.model
    causes, shifts, _ = cause_naming.named(found, setup, bares, (), [mass], [0.85e-3], 0.5e-3)
    assert causes[0].rivals == ({"constant_force": {"x": 0.3}} if acts else {})
    told = Explanation(at, at, causes, 0.0, 0.0, 0.0, (), (), shifts)
    assert other_stiffness(told) == pytest.approx(np.log(3.0) if acts else 0.0)


@pytest.mark.parametrize(
    ("gain", "err", "complete", "taken"),
    [
        (40.0, 0.95e-3, True, True),
        (2.0, 0.8e-3, True, False),  # as good a rival
        (40.0, 0.8e-3, False, True),
        (40.0, 0.85e-3, False, False),  # evidence tells little while another cause is missing
    ],
)
@pytest.mark.parametrize(("added", "twin"), [(True, False), (False, False), (False, True)])
def test_a_rival_that_explains_more_takes_a_cause_s_place(
    monkeypatch, gain, err, complete, taken, added, twin
):
    """Unless it does the same to first order, as an even force does what a tilt does."""
    only_err_decides(monkeypatch)
    mass = proposal_of(PAPER, Start("point_mass", {"mass": 0.0}, ("mass",), ("mass",)))
    force = proposal_of(PAPER, Start("constant_force", {"x": 0.0}, ("x",), ("x",)))
    turn = Start("clamp_angle", {"start": 0.0}, ("start",), ("start",))
    cause = mass if added else replace(proposal_of(PAPER, turn), start=None)
    at, bare, other = (evaluation(*x) for x in ((0.0, 0.9e-3), (-40.0, 5e-3), (gain, err)))
    for fit in (at, bare, other):
        fit.model = model_of(PAPER)
    rival = Rival(other, force, {"x": 0.3}, twin)
    stand_in(monkeypatch, "rivals_of", lambda *_, **__: {force.effect: rival})
    stand_in(monkeypatch, "beyond", lambda *_: [] if added else [cause])
    stand_in(monkeypatch, "is_beyond", lambda *_: True)
    stand_in(monkeypatch, "linear_loss", lambda *_, **__: 40.0)
    stand_in(monkeypatch, "without", lambda *_, **__: bare)
    for name in ("approached", "best_known"):
        stand_in(monkeypatch, name, lambda at, *x: x[1] if len(x) > 1 else at)
    monkeypatch.setattr(cause_search, "nearest_err", lambda at, _: at.mean_err)
    stand_in(monkeypatch, "tells_apart", more_evidence)
    found = Search(at, (cause,) if added else (), (), SERVING)
    words = found, bare, {}, (), [mass.start], [0.85e-3], 0.5e-3
    names, _, better = cause_naming.named(*words, complete=complete, exchange=True)
    assert (better is not None) is (taken and not twin)
    if better is not None:
        assert names == () and better.at is other and better.causes == (force,)
    names, _, better = cause_naming.named(*words, complete=complete)
    assert better is None and names[0].effect == cause.effect


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
        fit.model = model_of(PAPER.with_effects(values))
    setup = evaluation(-5000.0, alone)
    setup.model = model_of(PAPER)
    only_err_decides(monkeypatch)
    stand_in(monkeypatch, "without", lambda _, group, *__, wholly: bare[group.effect])
    stand_in(monkeypatch, "approached", lambda at, *_: at)
    found = SimpleNamespace(at=at, causes=causes, offer=SERVING, passed=())
    told, *_ = cause_naming.named(found, setup, {}, (), [friction, creep], [0.9e-3], 0.05e-3)
    assert [c.effect for c in told] == named
    assert not named or told[0].rivals == {"viscoelasticity": {"share": 0.3}}


@pytest.mark.parametrize(
    ("near", "complete", "named"),
    [(0.82e-3, True, False), (1.9e-3, True, True), (0.67e-3, True, False), (0.67e-3, False, True)],
)
def test_a_fit_without_a_cause_that_has_only_drifted_does_not_tell_of_it(
    monkeypatch, near, complete, named
):
    """Without a hundredth of the mass at its tip, a fit lay twice as far from the shapes as that
    model can come. Where something is left unexplained, that counts if it is less likely by more
    than chance.
    """
    start = Start("point_mass", {"mass": 0.0}, ("mass",), ("mass",))
    at, bare = evaluation(0.0, 1.14e-3), evaluation(-40.0, 1.89e-3)
    nearest = {id(at): evaluation(0.0, 0.65e-3), id(bare): evaluation(0.0, near)}
    at.model = bare.model = model_of(PAPER)
    only_err_decides(monkeypatch)
    stand_in(monkeypatch, "without", lambda *_, wholly: bare)
    stand_in(monkeypatch, "approached", lambda at, *_: nearest[id(at)])
    stand_in(monkeypatch, "tells_apart", more_evidence)
    found = SimpleNamespace(at=at, causes=(proposal_of(PAPER, start),), offer=SERVING, passed=())
    setup = evaluation(-80.0, 1.5e-3)
    setup.model = at.model
    causes, *_ = cause_naming.named(
        found, setup, {}, (), [start], [0.54e-3], 0.21e-3, complete=complete
    )
    assert bool(causes) is named
    assert all(c.err == near for c in causes)  # of which its share is told


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
    at.model = bare.model = model_of(PAPER)
    at.err, bare.err = [np.full(9, beside)], [np.full(9, without)]
    only_err_decides(monkeypatch)
    stand_in(monkeypatch, "has_certainly_other_stiffness", lambda *_: stiffer)
    stand_in(monkeypatch, "taken_for_plain", lambda model, _: model)
    assert is_named(monkeypatch, start, at, bare, [own], least) is named


@pytest.mark.parametrize("passed", [False, True])
def test_a_fit_without_a_cause_that_explains_less_than_one_that_is_known_has_gone_astray(
    monkeypatch, passed
):
    start = Start("hysteresis", {"moment": 0.1}, ("moment",), ("moment",), neutral=False)
    at, bare, known = evaluation(0.0, 1e-3), evaluation(-900.0, 9e-3), evaluation(-40.0, 3e-3)
    at.model = bare.model = known.model = model_of(PAPER)
    only_err_decides(monkeypatch)
    stand_in(monkeypatch, "linear_loss", lambda *_, wholly: 40.0)
    stand_in(monkeypatch, "without", lambda *_, wholly: bare)
    stand_in(monkeypatch, "approached", lambda at, *_: at)
    found = SimpleNamespace(
        at=at, causes=(proposal_of(PAPER, start),), offer=SERVING, passed=(bare, known) * passed
    )
    setup = bare if passed else known
    (cause,), *_ = cause_naming.named(found, setup, {}, (), [start], [0.85e-3], 0.5e-3)
    assert (cause.evidence, cause.err) == (40.0, 3e-3)


@pytest.mark.parametrize(("smooth", "named"), [(True, False), (False, True)])
def test_what_acts_in_one_recording_is_named_though_others_lie_farther_off(
    monkeypatch, smooth, named
):
    """A wall that is hit in one of three recordings, by 9374 of log evidence: that came from 3.3 to
    0.9 mm, and others, which a fit without it had followed at any price, from 1.7 to 2.8 mm.
    """
    start = Start("wall", {"offset": 0.0, "angle": 0.0}, ("offset",), ("offset",), neutral=False)
    at, bare = evaluation(0.0, 2.44e-3), evaluation(-9374.0, 2.35e-3)
    at.err = [np.full(9, e) for e in (2.8e-3, 0.9e-3, 3.6e-3)]
    bare.err = [np.full(9, e) for e in (1.7e-3, 3.3e-3, 2.0e-3)]
    at.model = bare.model = model_of(PAPER)
    monkeypatch.setattr(StraightWall, "smooth", smooth)
    only_err_decides(monkeypatch)
    assert is_named(monkeypatch, start, at, bare, [2.1e-3] * 3, 0.25e-3) is named


@pytest.mark.parametrize(
    ("lost", "complete", "named"),
    [(23.0, False, True), (11.0, False, False), (23.0, True, False)],
)
def test_a_cause_among_several_is_named_for_its_share_of_what_they_gain(
    monkeypatch, lost, complete, named
):
    """A hung weight on a cable with a lasting bend and a softer stretch: 23 of 123 of log evidence,
    and 3.3 mm for 3.7.
    """
    start = Start("point_mass", {"mass": 0.1, "position": 0.4}, ("mass",), ("mass",), neutral=False)
    at, bare = evaluation(123.0, 3.3e-3), evaluation(123.0 - lost, 3.7e-3)
    setup = evaluation(0.0, 7e-3)
    at.model = bare.model = setup.model = model_of(PAPER)
    only_err_decides(monkeypatch)
    words = {"setup": setup, "complete": complete}
    assert is_named(monkeypatch, start, at, bare, [0.7e-3], 0.6e-3, **words) is named


@pytest.mark.parametrize(
    ("loss", "complete", "named"), [(934.0, True, True), (20.0, True, False), (934.0, False, False)]
)
def test_what_is_indispensable_is_named_though_its_size_is_not_known(
    monkeypatch, loss, complete, named
):
    """A segment that is eleven times as stiff, or twenty times: it hardly bends."""
    start = Start("stiff_segment", {"ratio": 2.0}, ("ratio",), ("ratio",), neutral=False)
    at, bare = evaluation(0.0, 0.42e-3), evaluation(-loss, 1.8e-3)
    at.model = bare.model = model_of(PAPER)
    only_err_decides(monkeypatch)
    stand_in(monkeypatch, "certain", lambda *_: False)
    told = is_named(monkeypatch, start, at, bare, [0.72e-3], 0.48e-3, complete=complete)
    assert told is named


@pytest.mark.parametrize(
    ("complete", "far", "own", "least", "named"),
    [
        (True, False, 0.18e-3, 0.5e-3, True), (False, False, 0.18e-3, 0.5e-3, False),
        (True, True, 0.18e-3, 0.5e-3, False),
        (True, False, 0.35e-3, 0.1e-3, True), (True, True, 0.35e-3, 0.1e-3, False),
    ],
)  # fmt: skip
def test_what_mends_another_s_law_is_no_cause(monkeypatch, complete, far, own, least, named):
    """A softer part beside a gradient of another course: 0.2 mm for 0.4 of 11 mm.

    Where nothing is left it is one, but for beside a gradient that is far beyond its tolerance:
    there it is none either where all that it takes away is the measurement's own error.
    """
    gradient = proposal_of(PAPER, Start("stiffness_gradient", {"change": 0.0}, (), ("change",)))
    start = Start("stiff_segment", {"ratio": 2.0}, ("ratio",), ("ratio",), neutral=False)
    at, bare, setup = evaluation(9e3, 0.2e-3), evaluation(8.9e3, 0.4e-3), evaluation(0.0, 2e-3)
    at.model = bare.model = setup.model = model_of(PAPER)
    only_err_decides(monkeypatch)
    stand_in(monkeypatch, "beyond", lambda *_: [replace(gradient, start=None)] * far)
    stand_in(monkeypatch, "certain", lambda _, g, *__: g.effect == start.effect)
    words = {"setup": setup, "complete": complete}
    assert is_named(monkeypatch, start, at, bare, [own], least, **words) is named


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
