# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The search for causes: what is added, and why the others are not."""

from types import SimpleNamespace

import numpy as np
import pytest
from experiment_recordings import fitted_set_up
from rods import PAPER

from dlo_ros.diagnosis.explain import (
    candidate_trials,
    cause_search,
    joint_explanation,
)
from dlo_ros.diagnosis.proposals.linear_evidence import (
    PredictedGain,
    columns,
    predicted_gains,
    proposal_of,
    with_proposals,
)
from dlo_ros.effects import Start
from dlo_ros.inference import joint_fit
from dlo_ros.inference.joint import evaluate, simulate
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.priors import material_priors


def evaluation(evidence, err):
    return SimpleNamespace(posterior=SimpleNamespace(evidence=evidence), mean_err=err)


def best_of(monkeypatch, fits, ends=None, promised=None, least=np.inf, near=None):
    """The cause that is added, and what became of each, by name.

    Args:
        fits: evidence and ERR [m] of short fits.
        ends: the same of those that are fitted to the end, where that is not where they began.
        promised: predicted gains, of which the first come nearest; default: all gain alike.
        least: see `best_trial`.
        near: ERR [m] to which fits can come, by their evidence; default: that of the fits.
    """
    promised = promised or dict.fromkeys(fits, 10.0)
    promises = [
        SimpleNamespace(
            proposal=SimpleNamespace(label=name, start=object(), effect=name.partition(" (")[0]),
            gain=gain,
            model=name,
        )
        for name, gain in promised.items()
    ]
    names = list(promised)

    def checked(_, predicted, __):
        return 1e-3 + 1e-6 * names.index(predicted.model), predicted

    def short(model, *_, **__):
        return evaluation(*fits[model])

    def long(found, *_, **__):
        name = next(n for n, (gain, _) in fits.items() if gain == found.posterior.evidence)
        return evaluation(*(ends or {}).get(name, fits[name]))

    def approached(at, _):
        evidence = at.posterior.evidence
        return evaluation(evidence, (near or {}).get(evidence, at.mean_err))

    monkeypatch.setattr(joint_fit, "approached", approached)
    monkeypatch.setattr(candidate_trials, "_checked", checked)
    monkeypatch.setattr(candidate_trials, "fitted", short)
    monkeypatch.setattr(candidate_trials, "fit", long)
    at = evaluation(0.0, 2e-3)
    best, trace = candidate_trials.best_trial(1, at, [(at, promises)], (), least)
    return best and best[1].label, {step.name: step.outcome for step in trace}


def test_what_gains_most_is_added(monkeypatch):
    added, told = best_of(monkeypatch, {"mass": (9.0, 1e-3), "tilt": (20.0, 1.5e-3)})
    assert added == "tilt"
    assert told == {"tilt": "added", "mass": "fitted, but another gains more"}


def test_of_what_gains_alike_the_nearest_to_the_shapes_is_added(monkeypatch):
    fits = {"creep": (1000.0, 1.5e-3), "damping": (995.0, 1.0e-3), "segment": (950.0, 0.5e-3)}
    assert best_of(monkeypatch, fits)[0] == "damping"


def test_what_moves_predictions_away_from_the_shapes_is_not(monkeypatch):
    added, told = best_of(monkeypatch, {"mass": (9.0, 1e-3), "tilt": (20.0, 4e-3)})
    assert added == "mass"
    assert told == {"tilt": "makes matters worse", "mass": "added"}
    added, told = best_of(monkeypatch, {"tilt": (20.0, 4e-3)})
    assert added is None and told == {"tilt": "makes matters worse"}


def test_a_fit_that_can_come_nearer_to_the_shapes_may_have_left_them(monkeypatch):
    """While other causes are missing, it holds slow errors for noise."""
    fits = {"hysteresis": (9.0, 1e-3), "creep": (500.0, 2.5e-3)}
    assert best_of(monkeypatch, fits, near={500.0: 1.5e-3, 0.0: 1.9e-3})[0] == "creep"
    assert best_of(monkeypatch, fits, near={500.0: 1.95e-3, 0.0: 1.9e-3})[0] == "hysteresis"


def test_a_fit_that_has_only_begun_may_lie_farther_from_the_shapes(monkeypatch):
    fits = {"mass": (9.0, 1e-3), "friction": (20.0, 2.1e-3)}
    added, told = best_of(monkeypatch, fits, {"friction": (24.0, 0.7e-3)})
    assert added == "friction"
    assert told == {"friction": "added", "mass": "fitted, but another gains more"}


def test_one_trial_is_that_of_the_largest_predicted_gain(monkeypatch):
    fits = {f"mass {k}": (9.0 + k, 1e-3) for k in range(4)} | {"friction": (20.0, 1e-3)}
    promised = dict.fromkeys(fits, 60.0) | {"friction": 190.0}
    added, told = best_of(monkeypatch, fits, promised=promised)
    assert added == "friction"
    near = {"mass 2": "others come nearer", "mass 3": "others come nearer"}
    assert near.items() <= told.items() and len(told) == len(fits)


def test_trials_are_those_of_different_effects(monkeypatch):
    """Starts of one effect that come near do not leave another one untried."""
    creep = {f"creep ({k})": (20.0 + k, 1e-3) for k in range(3)}
    added, told = best_of(monkeypatch, creep | {"friction": (90.0, 1e-3)})
    assert added == "friction"
    assert told["creep (2)"] == "others come nearer"


def test_a_small_gain_is_no_cause(monkeypatch):
    added, told = best_of(monkeypatch, {"mass": (2.0, 1e-3)})
    assert added is None and told == {"mass": "gains too little"}


def test_nothing_is_fitted_where_no_proposal_comes_near_enough(monkeypatch):
    fits = {"mass": (9.0, 1e-3), "tilt": (20.0, 1e-3)}
    assert best_of(monkeypatch, fits, least=1e-3)[0] == "tilt"  # the first steps lead to 1 mm
    added, told = best_of(monkeypatch, fits, least=0.9e-3)
    assert added is None
    assert told == dict.fromkeys(fits, "takes too little")
    # E depends on what gains so much, as on a creep, however little of ERR it takes.
    assert best_of(monkeypatch, fits, promised={"mass": 10.0, "tilt": 80.0}, least=0.9e-3)[0]


def test_the_best_start_of_each_effect_is_simulated(monkeypatch):
    """A creep is predicted to gain too little: it acts otherwise when it is large."""
    fits = {f"slip ({k})": (20.0, 1e-3) for k in range(12)} | {"creep": (90.0, 1e-3)}
    promised = {name: 100.0 - k for k, name in enumerate(fits)} | {"creep": 5.0}
    added, told = best_of(monkeypatch, fits, promised=promised)
    assert added == "creep"
    less = {name for name, outcome in told.items() if outcome == "predicted to gain less"}
    assert less == {"slip (9)", "slip (10)", "slip (11)"}


@pytest.mark.parametrize(("own", "least"), [(0.5e-3, 0.54e-3), (0.4e-3, np.inf)])
def test_where_nothing_matters_a_further_cause_must_come_nearer_at_once(monkeypatch, own, least):
    mass = SimpleNamespace(label="mass", effect="mass", start=object())
    asked = []
    without_simulations(monkeypatch, own)

    def best_trial(number, at, offers, recordings, least):
        asked.append(least)
        return ((evaluation(40.0, 0.6e-3), mass) if number == 1 else None), []

    monkeypatch.setattr(cause_search, "best_trial", best_trial)
    found = cause_search.search(evaluation(0.0, 2e-3), None, (), (), 0.1e-3)
    assert [c.label for c in found.causes] == ["mass"]
    assert asked == [np.inf, pytest.approx(least)]


def without_simulations(monkeypatch, own_err):
    """A search in which nothing is simulated and every cause is needed, with an own ERR [m]."""
    monkeypatch.setattr(cause_search, "offered", lambda *_: object())
    monkeypatch.setattr(cause_search, "ranked_proposals", lambda *_: [])
    monkeypatch.setattr(cause_search, "linear_loss", lambda *_: 1e3)
    monkeypatch.setattr(cause_search, "own_err", lambda *_: own_err)
    monkeypatch.setattr(joint_fit, "approached", lambda at, *_: at)
    monkeypatch.setattr(cause_search, "_strained", lambda *_: [])
    monkeypatch.setattr(cause_search, "_offers_beside", lambda *_: [])


def test_the_search_ends_with_a_cause_that_takes_too_little_away_to_be_named(monkeypatch):
    starts = [Start(f"effect {k}", {"size": 0.0}, ("size",), ("size",)) for k in range(4)]
    offers = [SimpleNamespace(label=s.effect, effect=s.effect, start=s) for s in starts]
    # The first one's laws compensate for no other's.
    left = [1.9e-3, 0.6e-3, 0.58e-3, 0.3e-3]
    without_simulations(monkeypatch, 1e-3)
    monkeypatch.setattr(
        cause_search, "best_trial",
        lambda number, *_: ((evaluation(40.0 * number, left[number - 1]), offers[number - 1]), []),
    )  # fmt: skip
    found = cause_search.search(evaluation(0.0, 2e-3), None, (), starts, 0.1e-3)
    assert [c.label for c in found.causes] == ["effect 0", "effect 1", "effect 2"]
    assert found.at.mean_err == left[2]


@pytest.mark.parametrize(("evidence", "first"), [(30.0, "wall"), (50.0, "peg"), (None, "peg")])
def test_what_was_hit_competes_with_the_other_causes(monkeypatch, evidence, first):
    """A peg in the way does much of what a table does that the DLO is laid down on."""
    peg, wall, delay = (
        SimpleNamespace(label=n, effect=n, start=object()) for n in ("peg", "wall", "delay")
    )
    others = iter([wall if evidence else None, delay])
    without_simulations(monkeypatch, 1e-3)

    def best_trial(number, at, *_):
        other = next(others)
        return (other and (evaluation(40.0 * number, 0.5e-3 / number), other)), []

    monkeypatch.setattr(cause_search, "best_trial", best_trial)
    hit = (evaluation(evidence or 1e3, 0.5e-3), peg)
    found = cause_search.search(evaluation(0.0, 2e-3), None, (), (), 0.3e-3, hit)
    assert [c.label for c in found.causes] == [first, "delay"]
    outcome = "added" if first == "peg" else "fitted, but another gains more"
    assert [s.outcome for s in found.trace if s.name == "peg"] == [outcome]


def test_a_contact_that_explains_all_that_matters_competes_as_well(monkeypatch):
    """A peg explained all where the model lacked a kink, and was named for it."""
    without_simulations(monkeypatch, 1e-3)
    peg, kink = (SimpleNamespace(label=n, effect=n, start=object()) for n in ("peg", "kink"))
    trials = iter([(evaluation(90.0, 0.2e-3), kink), None])
    monkeypatch.setattr(cause_search, "best_trial", lambda *_: (next(trials), []))
    hit = (evaluation(50.0, 0.2e-3), peg)
    found = cause_search.search(evaluation(0.0, 2e-3), None, (), (), 0.3e-3, hit)
    assert [c.label for c in found.causes] == ["kink"]
    assert [(s.name, s.outcome) for s in found.trace] == [("peg", "fitted, but another gains more")]


@pytest.mark.parametrize(
    ("instead", "causes", "left"),
    [
        ([0.5e-3], ["gradient", "yield"], 0.5e-3),
        ([1.95e-3, 0.5e-3], ["clamp", "yield"], 0.5e-3),
        # No more than two are tried.
        ([1.95e-3, None, 0.5e-3], ["clamp", "gradient", "creep"], 1.9e-3),
    ],
)
def test_a_strained_set_up_makes_way_for_the_effect_whose_work_it_does(
    monkeypatch, instead, causes, left
):
    def proposal(label, start=None):
        return SimpleNamespace(label=label, effect=label, start=start)

    added = iter([proposal("clamp"), proposal("gradient"), proposal("creep", object())])
    errs = iter([4e-3, 2e-3, 1.9e-3])
    strained = [proposal("clamp"), proposal("gradient"), proposal("camera")]
    tried = iter(instead)

    def exchange(*_):
        err = next(tried)
        yields = proposal("yield", object())
        return (None if err is None else (evaluation(90.0, err), yields)), []

    without_simulations(monkeypatch, 0.4e-3)
    monkeypatch.setattr(
        cause_search, "_strained",
        lambda at, causes, known: [g for g in strained if g.label not in known],
    )  # fmt: skip
    monkeypatch.setattr(cause_search, "_exchange", exchange)
    monkeypatch.setattr(
        cause_search, "best_trial", lambda *_: ((evaluation(50.0, next(errs)), next(added)), [])
    )
    at = evaluation(0.0, 8e-3)
    found = cause_search.search(at, None, (), (), 0.55e-3)
    assert [c.label for c in found.causes] == causes
    assert found.at.mean_err == left


def test_the_size_of_what_begins_at_a_finite_one_is_looked_for(monkeypatch):
    """A yield at one and a half times the curvature from which it is looked for."""
    keys = ("yield_curvature", "hardening")
    start = Start("plasticity", {keys[0]: 4.0, keys[1]: 0.35}, keys, keys, neutral=False)
    begin, _ = with_proposals(
        ParametricModel(PAPER, material_priors(PAPER)), [proposal := proposal_of(PAPER, start)]
    )

    def simulate(model, *_):
        off = np.log(model.settings.effects["plasticity"]["yield_curvature"] / 6.0)
        return SimpleNamespace(mean_err=1e-3 * (1.0 + off**2))

    monkeypatch.setattr(candidate_trials, "simulate", simulate)
    promise = PredictedGain(proposal, 10.0, begin, begin)
    found = candidate_trials._nearest_size(promise, ()).settings.effects["plasticity"]
    assert found["yield_curvature"] == pytest.approx(6.0, rel=0.05)
    assert found["hardening"] == 0.35


def test_the_place_of_what_the_dlo_hits_is_looked_for(monkeypatch):
    """A table that leans, 2 cm above where it is looked for."""
    keys = ("offset", "angle")
    start = Start("wall", {keys[0]: -0.20, keys[1]: 0.0}, keys, keys, neutral=False, form="table")
    begin, _ = with_proposals(
        ParametricModel(PAPER, material_priors(PAPER)), [proposal := proposal_of(PAPER, start)]
    )

    def simulate(model, *_):
        wall = model.settings.effects["wall"]
        off = (wall["offset"] + 0.18) / 0.05, (wall["angle"] - 0.04) / 0.1
        return SimpleNamespace(mean_err=1e-3 * (1.0 + np.hypot(*off)))

    monkeypatch.setattr(candidate_trials, "simulate", simulate)
    found = candidate_trials._nearest_size(PredictedGain(proposal, 10.0, begin, begin), ())
    wall = found.settings.effects["wall"]
    assert wall["offset"] == pytest.approx(-0.18, abs=5e-3)
    assert wall["angle"] == pytest.approx(0.04, abs=0.01)


def test_what_has_no_size_is_simulated_where_it_is_promised():
    peg = {"x": 0.1, "z": -0.1, "radius": 0.01}
    for start in (
        Start("obstacle", peg, (), tuple(peg), neutral=False),
        Start("wall", {"offset": -0.2, "angle": 0.0}, ("offset",), ("offset",), neutral=False),
        Start("point_mass", {"mass": 0.0}, ("mass",), ("mass",)),
    ):
        assert candidate_trials._size(proposal_of(PAPER, start)) is None


@pytest.mark.parametrize(
    ("far", "bare", "expected"),
    [
        (None, None, ("set-up", None)),
        (60.0, 20.0, ("set-up", "heavy")),
        (60.0, 59.0, ("other minimum", None)),  # the mass was but the way there
        (60.0, None, ("set-up", "heavy")),
    ],
)
def test_a_search_begins_with_what_lies_far_off_where_it_is_needed(
    monkeypatch, far, bare, expected
):
    setup, heavy, minimum = (
        evaluation(e or 0.0, err) for e, err in ((0.0, 9e-3), (far, 2e-3), (bare, 2e-3))
    )
    trial = None if far is None else (heavy, "heavy")
    found = None if bare is None else minimum
    monkeypatch.setattr(joint_explanation, "best_far_start", lambda *_: trial)
    monkeypatch.setattr(joint_explanation, "without", lambda *_: found)
    prepared = SimpleNamespace(setup=setup, recordings=(), meant=None, plain_err=1.0)
    there, first = joint_explanation._beginning(prepared, (), None, 1e-3)
    assert (there, first and first[1]) == (
        {"set-up": setup, "other minimum": minimum}[expected[0]], expected[1]
    )  # fmt: skip
    assert joint_explanation._beginning(prepared, (), None, 1e-2) == (setup, None)


def test_where_the_set_up_is_strained_causes_are_looked_for_beside_a_neutral_one(monkeypatch):
    offers = []

    def best_trial(number, at, given, recordings, _):
        offers.append([e for e, _ in given])
        return None, []

    without_simulations(monkeypatch, 1e-3)
    monkeypatch.setattr(cause_search, "best_trial", best_trial)
    monkeypatch.setattr(cause_search, "_offers_beside", lambda neutral, *_: [(neutral, [])])
    at = evaluation(0.0, 2e-3)
    cause_search.search(at, "neutral", (), (), 0.1e-3)
    monkeypatch.setattr(cause_search, "_strained", lambda _, __, known: [] if known else ["tilt"])
    monkeypatch.setattr(cause_search, "EXCHANGES", 0)
    cause_search.search(at, "neutral", (), (), 0.1e-3)
    cause_search.search(evaluation(0.0, 1e-3), "neutral", (), (), 0.1e-3)  # it does not matter
    assert offers == [[at], [at, "neutral"], [offers[2][0]]]


def test_a_proposal_with_boundless_derivatives_is_left_out():
    at, _ = fitted_set_up()
    both = Start("constant_force", {"x": 0.0, "z": 0.0}, ("x", "z"), ("x", "z"))
    one = Start("point_mass", {"mass": 0.0, "position": 0.2}, ("mass",), ("mass",))
    force, mass = (proposal_of(at.model.settings, start) for start in (both, one))
    frames = [len(r) for r, _ in at.fields]
    numbers = at.fields[0][0].shape[1]
    extra = {
        id(force): tuple(np.full((count, 2, numbers), 1e30) for count in frames),
        id(mass): tuple(np.ones((count, 1, numbers)) for count in frames),
    }
    assert [p.proposal for p in predicted_gains(at, [force, mass], extra)] == [mass]


def test_a_number_without_a_derivative_stays_until_there_is_one():
    """A slip of no length has no moment: its prior would put it in the middle of a minute."""
    near, recordings = fitted_set_up()
    at = evaluate(near.model.stiffened(1.5), recordings)
    start = Start("clamp_slip", {"length": 0.0, "onset": 0.5}, ("length",), ("length", "onset"))
    proposal = proposal_of(at.model.settings, start)
    model, names = with_proposals(at.model, [proposal])
    extra = {
        id(proposal): columns(at, [proposal], simulate(model, recordings, names))[id(proposal)]
    }
    predicted = predicted_gains(at, [proposal], extra)[0]
    err, begun = candidate_trials._checked(at, predicted, recordings)
    slip = begun.model.settings.effects["clamp_slip"]
    assert slip["onset"] == 0.5 and slip["length"] != 0.0
    assert begun.model.parameters == model.parameters  # with their priors
    assert err < 0.5 * at.mean_err
