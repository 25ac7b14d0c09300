# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The search for causes: what is added, and why the others are not."""

from types import SimpleNamespace

import numpy as np
import pytest
from experiment_recordings import fitted_set_up

from dlo_ros.diagnosis.explain import (
    cause_search,
    far_starts,
    joint_explanation,
    trials,
)
from dlo_ros.diagnosis.explain.trial_beginnings import beginning
from dlo_ros.diagnosis.proposals.linear_evidence import (
    columns,
    predicted_gains,
    proposal_of,
    with_proposals,
)
from dlo_ros.effects import Start
from dlo_ros.inference import joint_fit
from dlo_ros.inference.joint import evaluate, simulate


def evaluation(evidence, err):
    return SimpleNamespace(posterior=SimpleNamespace(evidence=evidence), mean_err=err)


@pytest.mark.parametrize(("own", "least"), [(0.5e-3, 0.54e-3), (0.4e-3, np.inf)])
def test_where_nothing_matters_a_further_cause_must_come_nearer_at_once(monkeypatch, own, least):
    mass = SimpleNamespace(label="mass", effect="mass", start=object())
    asked = []
    without_simulations(monkeypatch, own)

    def best_trials(number, at, offers, recordings, least, begun):
        assert not begun
        asked.append(least)
        return ([(evaluation(40.0, 0.6e-3), mass)] if number == 1 else []), []

    monkeypatch.setattr(cause_search, "best_trials", best_trials)
    found = cause_search.search(evaluation(0.0, 2e-3), None, (), (), 0.1e-3)
    assert [c.label for c in found.causes] == ["mass"]
    assert asked == [np.inf, pytest.approx(least)]


def without_simulations(monkeypatch, own_err):
    """A search in which nothing is simulated and every cause is needed, with an own ERR [m]."""
    monkeypatch.setattr(cause_search, "offered", lambda *_: object())
    monkeypatch.setattr(cause_search, "ranked_proposals", lambda *_: [])
    for module in (cause_search, far_starts):
        monkeypatch.setattr(module, "begun_instead", lambda *_: [])
    monkeypatch.setattr(cause_search, "linear_loss", lambda *_: 1e3)
    for module in (cause_search, trials):
        monkeypatch.setattr(module, "own_err", lambda *_: own_err)
    monkeypatch.setattr(joint_fit, "approached", lambda at, *_: at)
    monkeypatch.setattr(cause_search, "_strained", lambda *_: [])
    monkeypatch.setattr(cause_search, "_offers_beside", lambda *_: [])
    monkeypatch.setattr(cause_search, "_far_beside", lambda *_: None)
    monkeypatch.setattr(cause_search, "with_best_in_place", lambda at, causes, *_: (at, causes))


def test_the_search_ends_with_a_cause_that_takes_too_little_away_to_be_named(monkeypatch):
    starts = [Start(f"effect {k}", {"size": 0.0}, ("size",), ("size",)) for k in range(4)]
    offers = [SimpleNamespace(label=s.effect, effect=s.effect, start=s) for s in starts]
    # The first one's laws compensate for no other's.
    left = [1.9e-3, 0.6e-3, 0.58e-3, 0.3e-3]
    without_simulations(monkeypatch, 1e-3)
    monkeypatch.setattr(
        cause_search, "best_trials",
        lambda number, *_: (
            [(evaluation(40.0 * number, left[number - 1]), offers[number - 1])], []
        ),
    )  # fmt: skip
    found = cause_search.search(evaluation(0.0, 2e-3), None, (), starts, 0.1e-3)
    assert [c.label for c in found.causes] == ["effect 0", "effect 1", "effect 2"]
    assert found.at.mean_err == left[2]


@pytest.mark.parametrize(("wanted", "steps"), [(-np.inf, 4), (201.0, 2), (121.0, 3), (119.0, 4)])
def test_a_search_ends_where_its_evidence_can_hardly_be_enough(monkeypatch, wanted, steps):
    """The second of at most six causes raises the log evidence by 40, each further cause by 20."""
    gains, left = [20.0, 40.0, 60.0, 80.0], [1.6e-3, 1.2e-3, 0.9e-3, 0.6e-3]
    offers = [SimpleNamespace(label=f"e{k}", effect=f"e{k}", start=object()) for k in range(4)]
    without_simulations(monkeypatch, 0.1e-3)

    def best_trials(number, *_):
        if number > len(offers):
            return [], []
        return [(evaluation(gains[number - 1], left[number - 1]), offers[number - 1])], []

    monkeypatch.setattr(cause_search, "best_trials", best_trials)
    found = cause_search.search(
        evaluation(0.0, 2e-3), None, (), (), 0.1e-3, present=offers[:1], wanted=wanted
    )
    assert [c.label for c in found.causes] == [o.label for o in offers[:steps]]


@pytest.mark.parametrize(("evidence", "first"), [(30.0, "wall"), (50.0, "peg"), (None, "peg")])
def test_what_was_hit_competes_with_the_other_causes(monkeypatch, evidence, first):
    """A peg in the way does much of what a table does that the DLO is laid down on."""
    peg, wall, delay = (
        SimpleNamespace(label=n, effect=n, start=object()) for n in ("peg", "wall", "delay")
    )
    others = iter([wall if evidence else None, delay])
    without_simulations(monkeypatch, 1e-3)

    def best_trials(number, at, *_):
        other = next(others)
        return ([(evaluation(40.0 * number, 0.5e-3 / number), other)] if other else []), []

    monkeypatch.setattr(cause_search, "best_trials", best_trials)
    hit = (evaluation(evidence or 1e3, 0.5e-3), peg)
    found = cause_search.search(evaluation(0.0, 2e-3), None, (), (), 0.3e-3, hit)
    assert [c.label for c in found.causes] == [first, "delay"]
    outcome = "added" if first == "peg" else "fitted, but another gains more"
    assert [s.outcome for s in found.trace if s.name == "peg"] == [outcome]


@pytest.mark.parametrize(("left", "causes"), [(2e-3, ["wall", "plug"]), (0.4e-3, ["wall"])])
def test_what_begins_far_away_is_looked_for_beside_a_first_cause(monkeypatch, left, causes):
    """Where that leaves something, and once."""
    without_simulations(monkeypatch, 1e-3)
    wall, plug = (SimpleNamespace(label=n, effect=n, start=object()) for n in ("wall", "plug"))
    trials = iter([[(evaluation(90.0, left), wall)], [], []])
    monkeypatch.setattr(cause_search, "best_trials", lambda *_: (next(trials), []))
    beside = iter([(evaluation(150.0, 1.5e-3), plug)])
    monkeypatch.setattr(cause_search, "_far_beside", lambda *_: next(beside))
    found = cause_search.search(evaluation(0.0, 9e-3), None, (), (), 0.5e-3)
    assert [c.label for c in found.causes] == causes
    assert [s.name for s in found.trace] == causes[1:]


@pytest.mark.parametrize(("most", "of_two"), [(6, 60.0), (2, 60.0), (1, np.inf)])
def test_a_search_ends_with_a_number_of_causes_and_knows_what_the_first_two_gained(
    monkeypatch, most, of_two
):
    without_simulations(monkeypatch, 0.1e-3)
    offers = [SimpleNamespace(label=f"e{k}", effect=f"e{k}", start=object()) for k in range(3)]
    added = [(evaluation(30.0 * (k + 1), 1e-3 / 2**k), offer) for k, offer in enumerate(offers)]
    monkeypatch.setattr(
        cause_search, "best_trials",
        lambda number, *_: (added[number - 1 : number], []),
    )  # fmt: skip
    found = cause_search.search(evaluation(0.0, 2e-3), None, (), (), 0.1e-3, most=most)
    assert [c.label for c in found.causes] == ["e0", "e1", "e2"][:most]
    assert found.of_two == of_two


@pytest.mark.parametrize(
    ("gains", "second"),
    [
        ({"mass": 100.0, "plug": 85.0, "creep": 20.0}, "plug"),
        ({"mass": 100.0, "plug": 75.0}, None),  # clearly less
        ({"mass": 100.0, "mass elsewhere": 95.0, "tilt": 90.0}, None),  # no other effect
        ({"mass": 100.0}, None),
    ],
)
def test_the_second_first_cause_is_known_where_it_gains_nearly_as_much(monkeypatch, gains, second):
    without_simulations(monkeypatch, 1e-3)
    first = [
        (
            evaluation(gain, 0.2e-3),
            SimpleNamespace(
                label=n, effect=n.split()[0], start=None if n == "tilt" else object()
            ),
        )
        for n, gain in gains.items()
    ]  # fmt: skip
    trials = iter([first, []])
    monkeypatch.setattr(cause_search, "best_trials", lambda *_: (next(trials), []))
    found = cause_search.search(evaluation(0.0, 2e-3), None, (), (), 0.1e-3)
    assert [c.label for c in found.causes] == ["mass"]
    assert (found.second[1].label if found.second else None) == second


@pytest.mark.parametrize(
    ("gain", "stiffness", "left", "named"),
    [
        (90.0, True, 0.2e-3, ["friction"]), (90.0, False, 0.2e-3, []), (15.0, True, 0.2e-3, []),
        (90.0, True, 0.5e-3, []),  # it is one of those that are looked for anyway
    ],
)  # fmt: skip
def test_where_nothing_is_left_an_effect_may_have_done_the_work_of_another_stiffness(
    monkeypatch, gain, stiffness, left, named
):
    """A friction within the DLO left 0.23 mm with E / mu 50 % off, and gained 1995."""
    without_simulations(monkeypatch, 0.2e-3)
    friction = SimpleNamespace(label="friction", effect="hysteresis", start=object())
    trial = evaluation(gain, 0.1e-3)
    trial.model = None
    monkeypatch.setattr(far_starts, "begun_instead", lambda *_: [(trial, friction)])
    monkeypatch.setattr(cause_search, "best_trials", lambda *_: ([], []))
    monkeypatch.setattr(far_starts, "has_other_stiffness", lambda *_: stiffness)
    monkeypatch.setattr(
        far_starts, "tells_apart", lambda a, b: a.posterior.evidence > 20.0
    )  # fmt: skip
    found = cause_search.search(evaluation(0.0, left), None, (), (), 0.3e-3)
    assert [c.label for c in found.causes] == named


def test_nothing_begins_far_away_beside_what_has_begun_so_itself():
    afar = Start("point_mass", {"mass": 0.01}, (), ("mass",), neutral=False)
    mass = SimpleNamespace(start=afar, parameters=())
    assert cause_search._far_beside(None, mass, (), [afar]) is None


def test_a_contact_that_explains_all_that_matters_competes_as_well(monkeypatch):
    """A peg explained all where the model lacked a kink, and was named for it."""
    without_simulations(monkeypatch, 1e-3)
    peg, kink = (SimpleNamespace(label=n, effect=n, start=object()) for n in ("peg", "kink"))
    trials = iter([[(evaluation(90.0, 0.2e-3), kink)], []])
    monkeypatch.setattr(cause_search, "best_trials", lambda *_: (next(trials), []))
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
        cause_search, "best_trials", lambda *_: ([(evaluation(50.0, next(errs)), next(added))], [])
    )
    at = evaluation(0.0, 8e-3)
    found = cause_search.search(at, None, (), (), 0.55e-3)
    assert [c.label for c in found.causes] == causes
    assert found.at.mean_err == left


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

    def best_trials(number, at, given, recordings, *_):
        offers.append([e for e, _ in given])
        return [], []

    without_simulations(monkeypatch, 1e-3)
    monkeypatch.setattr(cause_search, "best_trials", best_trials)
    monkeypatch.setattr(cause_search, "_offers_beside", lambda neutral, *_: [(neutral, [])])
    at = evaluation(0.0, 2e-3)
    cause_search.search(at, "neutral", (), (), 0.1e-3)
    monkeypatch.setattr(cause_search, "_strained", lambda _, __, known: [] if known else ["tilt"])
    monkeypatch.setattr(cause_search, "SET_UP_EXCHANGES", 0)
    cause_search.search(at, "neutral", (), (), 0.1e-3)
    cause_search.search(evaluation(0.0, 1e-3), "neutral", (), (), 0.1e-3)  # it does not matter
    assert offers == [[at], [at, "neutral"], [offers[2][0]]]


@pytest.mark.slow
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
    found = beginning(at, predicted, recordings)
    begun = found.predicted
    slip = begun.model.settings.effects["clamp_slip"]
    assert slip["onset"] == 0.5 and slip["length"] != 0.0
    assert begun.model.parameters == model.parameters  # with their priors
    assert found.err < 0.5 * at.mean_err
