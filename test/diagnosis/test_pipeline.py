# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Held-out recordings are only predicted, and no effect is fitted to the simulation's own error."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiment_recordings import moving

from dlo_ros.diagnosis import pipeline
from dlo_ros.diagnosis.pipeline import _learned
from dlo_ros.identification.offline.initial_fit import begin, fitted
from dlo_ros.inference.joint import evaluate, simulate


@pytest.mark.slow
def test_the_plain_model_has_not_seen_what_is_held_out():
    recording, given = moving("simple", {}, 41)
    other, _ = moving("simple", {"gravity_tilt": {"angle": 0.3}}, 42)
    both = begin([recording, replace(other, name="other")], given)
    alone = begin([recording], given)
    found = _learned(both, 1)
    ratio, spoilt, expected = (
        at.model.settings.rod.specific_modulus for at in (found, both.at, alone.at)
    )
    assert abs(spoilt / expected - 1.0) > 0.1
    assert ratio == pytest.approx(expected, rel=6e-3)  # its std is 0.15 %
    # With the time steps that were fine enough for what both leave.
    fitted = simulate(alone.at.model, both.recordings[:1], ())
    assert len(found.fields) == len(found.err) == 1
    assert found.mean_err == pytest.approx(fitted.mean_err, rel=0.05)
    # Nothing is fitted anew where nothing is held out.
    assert _learned(both, 2) is both.at


def test_nothing_is_fitted_to_the_simulation_s_own_error():
    recording, given = moving("simple", {"gravity_tilt": {"angle": 0.3}}, 43)
    fine = begin([recording], given)
    rough = replace(fine, recordings=tuple(replace(r, spans=r.spans - 1) for r in fine.recordings))
    tilted = fine.at.model.settings.with_effects({"gravity_tilt": {"angle": 0.3}})
    near = fitted(replace(fine.at.model, settings=tilted), fine.recordings)

    def learned(at, begun):
        drafts = dict(enumerate(begun.recordings))
        return SimpleNamespace(explanation=SimpleNamespace(at=at), drafts=drafts)

    sharper = pipeline._sharper(fine.at, learned(near, rough), rough)
    assert sharper is not None
    assert sharper.recordings[0].spans >= fine.recordings[0].spans
    assert pipeline._sharper(fine.at, learned(near, sharper), sharper) is None
    # Drafts that differ from it are no finer than it has to be.
    again = pipeline._sharper(fine.at, learned(near, rough), sharper)
    assert again is not None and again.recordings is sharper.recordings
    # The plain model's error is far larger than the simulation's own.
    assert pipeline._sharper(fine.at, learned(fine.at, rough), rough) is None


@pytest.mark.slow
def test_a_plain_model_in_a_wrong_minimum_begins_anew():
    recording, given = moving("simple", {}, 44)
    right = begin([recording], given)
    model = right.at.model
    theta = model.theta()
    theta[0] += np.log(3.0)
    wrong = evaluate(model.at(theta), right.recordings)
    learned = SimpleNamespace(explanation=SimpleNamespace(at=right.at))
    better = pipeline._better_plain_model(wrong, learned, right)
    assert better is not None and better.theta() == pytest.approx(model.theta())
    assert pipeline._better_plain_model(right.at, learned, right) is None
