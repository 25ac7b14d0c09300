# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A search that begins with the cause that gained second most."""

from types import SimpleNamespace

import numpy as np
import pytest
from field import evaluate, generate

from dlo_ros.diagnosis.explain import second_beginning, trials
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.second_beginning import best_of_beginnings

MASS, SEGMENT, PLUG, GIVE = (SimpleNamespace(label=n, effect=n) for n in ("m", "s", "p", "g"))


def evaluation(evidence, err=1e-3):
    return SimpleNamespace(posterior=SimpleNamespace(evidence=evidence), mean_err=err)


SETUP = evaluation(0.0, 9e-3)


def found(evidence, second, causes=(MASS, SEGMENT), of_two=90.0):
    return Search(evaluation(evidence), causes, ("first",), None, second, of_two)


@pytest.mark.parametrize(
    ("of_two", "evidence", "err", "better"),
    [
        (90.0, 140.0, 0.5e-3, True), (75.0, 140.0, 0.5e-3, True),
        (70.0, 140.0, 0.5e-3, False),  # it does not go on
        (90.0, 115.0, 0.5e-3, False), (90.0, 140.0, 3e-3, False),
    ],
)  # fmt: skip
def test_a_search_with_another_first_cause_must_certainly_explain_more_and_come_nearer(
    monkeypatch, of_two, evidence, err, better
):
    begun, half = evaluation(60.0, 2e-3), evaluation(of_two, 1.5e-3)
    asked = []

    def search(at, neutral, recordings, starts, enough, *, present, wanted, most=6):
        asked.append((at, neutral, present))
        assert wanted == pytest.approx(103.0)
        if most == 2:
            return Search(half, (PLUG, SEGMENT), ("second",), None)
        return Search(evaluation(evidence, err), (PLUG, GIVE), ("third",), None)

    monkeypatch.setattr(second_beginning, "leaves_something", lambda *_: False)
    monkeypatch.setattr(second_beginning, "fit", lambda at, *_: at)
    monkeypatch.setattr(second_beginning, "search", search)
    monkeypatch.setattr(
        second_beginning, "tells_apart",
        lambda a, b: a.posterior.evidence > 20.0 + b.posterior.evidence,
    )  # fmt: skip
    monkeypatch.setattr(trials, "own_err", lambda *_: 0.1e-3)
    monkeypatch.setattr(trials, "nearest_err", lambda at, _: at.mean_err)
    result = best_of_beginnings(found(100.0, (begun, PLUG)), SETUP, "neutral", (), (), 1e-4)
    went_on = of_two > 72.0
    assert asked[:1] == [(begun, "neutral", (PLUG,))]
    assert asked[1:] == went_on * [(half, "neutral", (PLUG, SEGMENT))]
    assert result.causes == ((PLUG, GIVE) if better else (MASS, SEGMENT))
    assert result.trace == ("first", "second", "third")[: len(asked) + 1]  # all is told


@pytest.mark.parametrize("complete", [True, False])
def test_where_a_result_leaves_something_the_other_must_leave_nothing(monkeypatch, complete):
    """A single cause that leaves something may be the wrong one, too."""
    left = evaluation(100.0)
    other = Search(evaluation(1000.0, 0.5e-3), (PLUG, GIVE), ("second",), None)
    monkeypatch.setattr(
        second_beginning, "leaves_something", lambda at, *_: at is left or not complete
    )
    monkeypatch.setattr(second_beginning, "fit", lambda at, *_: at)
    monkeypatch.setattr(second_beginning, "search", lambda *_, **__: other)
    monkeypatch.setattr(second_beginning, "tells_apart", lambda *_: True)
    monkeypatch.setattr(second_beginning, "comes_nearer", lambda *_: True)
    first = Search(left, (MASS,), ("first",), None, (evaluation(90.0), PLUG))
    result = best_of_beginnings(first, SETUP, None, (), (), 1e-4)
    assert result.causes == ((PLUG, GIVE) if complete else (MASS,))


def test_nothing_is_searched_where_the_result_is_simple_or_has_that_cause(monkeypatch):
    monkeypatch.setattr(second_beginning, "search", lambda *_, **__: pytest.fail("searched"))
    alone = found(100.0, None)
    assert best_of_beginnings(alone, SETUP, None, (), (), np.inf) is alone
    single = found(100.0, (evaluation(60.0), PLUG), causes=(MASS,))
    monkeypatch.setattr(second_beginning, "leaves_something", lambda *_: False)
    assert best_of_beginnings(single, SETUP, None, (), (), np.inf) is single
    with_it = found(100.0, (evaluation(60.0), PLUG), causes=(MASS, PLUG))
    assert best_of_beginnings(with_it, SETUP, None, (), (), np.inf) is with_it


@pytest.mark.slow
@pytest.mark.long
def test_a_peg_does_not_stay_where_a_wall_explains_all_beside_others(tmp_path):
    """While a quadratic drag and a creep are missing, a peg gains more than the wall."""
    result = evaluate.solve(generate.draw(4940, 3, own_rope=True), tmp_path)
    assert result.verdict == "explained"
    assert {"wall", "quadratic_drag", "viscoelasticity"} <= set(result.named) and not result.wrong
    assert result.share > 0.6
