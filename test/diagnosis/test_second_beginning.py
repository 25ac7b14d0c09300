# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A search that begins with the cause that gained second most."""

from types import SimpleNamespace

import numpy as np
import pytest

from dlo_ros.diagnosis.explain import candidate_trials, second_beginning
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.second_beginning import best_of_beginnings

MASS, SEGMENT, PLUG, GIVE = (SimpleNamespace(label=n, effect=n) for n in ("m", "s", "p", "g"))


def evaluation(evidence, err=1e-3):
    return SimpleNamespace(posterior=SimpleNamespace(evidence=evidence), mean_err=err)


def found(evidence, second, causes=(MASS, SEGMENT)):
    return Search(evaluation(evidence), causes, ("first",), None, second)


@pytest.mark.parametrize(
    ("evidence", "err", "better"),
    [(140.0, 0.5e-3, True), (115.0, 0.5e-3, False), (140.0, 3e-3, False)],
)
def test_a_search_with_another_first_cause_must_certainly_explain_more_and_come_nearer(
    monkeypatch, evidence, err, better
):
    begun = evaluation(60.0, 2e-3)
    asked = []

    def search(at, neutral, recordings, starts, enough, *, present, wanted):
        asked.append((at, neutral, present))
        assert wanted == pytest.approx(103.0)
        return Search(evaluation(evidence, err), (PLUG, GIVE), ("second",), None)

    monkeypatch.setattr(second_beginning, "fit", lambda at, *_: at)
    monkeypatch.setattr(second_beginning, "search", search)
    monkeypatch.setattr(
        second_beginning, "tells_apart",
        lambda a, b: a.posterior.evidence > 20.0 + b.posterior.evidence,
    )  # fmt: skip
    monkeypatch.setattr(candidate_trials, "own_err", lambda *_: 0.1e-3)
    monkeypatch.setattr(candidate_trials, "nearest_err", lambda at, _: at.mean_err)
    result = best_of_beginnings(found(100.0, (begun, PLUG)), "neutral", (), (), 1e-4)
    assert asked == [(begun, "neutral", (PLUG,))]
    assert result.causes == ((PLUG, GIVE) if better else (MASS, SEGMENT))
    assert result.trace == ("first", "second")  # both are told


def test_nothing_is_searched_where_the_result_is_as_simple_as_can_be_or_has_that_cause(monkeypatch):
    monkeypatch.setattr(second_beginning, "search", lambda *_, **__: pytest.fail("searched"))
    alone = found(100.0, None)
    assert best_of_beginnings(alone, None, (), (), np.inf) is alone
    single = found(100.0, (evaluation(60.0), PLUG), causes=(MASS,))
    monkeypatch.setattr(second_beginning, "leaves_something", lambda *_: False)
    assert best_of_beginnings(single, None, (), (), np.inf) is single
    with_it = found(100.0, (evaluation(60.0), PLUG), causes=(MASS, PLUG))
    assert best_of_beginnings(with_it, None, (), (), np.inf) is with_it
