# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The recordings to learn from, and the fit to all of them: where it begins."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cause_fits import evaluation, model_of
from experiment_recordings import moving
from rods import PAPER

from dlo_ros.diagnosis.findings import joint_learning
from dlo_ros.diagnosis.findings.joint_learning import refitted, training_set
from dlo_ros.errors import SimulationError
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.identification.residual_noise import rms, whitened
from dlo_ros.inference.joint import simulate
from dlo_ros.inference.thresholds import IMMATERIAL, OWN


@pytest.mark.parametrize(
    ("of_search", "of_beginnings", "expected"),
    [(40.0, 90.0, 95.0), (40.0, 10.0, 45.0), (40.0, None, 45.0), (None, 90.0, 95.0)],
)
def test_the_last_fit_begins_where_more_is_explained(
    monkeypatch, of_search, of_beginnings, expected
):
    """A fit beside an impact ends where it is; one to the beginnings lay nearer to all."""

    def fit_of(evidence):
        return SimpleNamespace(
            err=(np.ones(4),), mean_err=1e-3, posterior=SimpleNamespace(evidence=evidence)
        )

    def over(at, _):
        if at.posterior.evidence is None:
            raise SimulationError("no static equilibrium")
        return at

    def longer(begun, *_, **__):
        return fit_of(begun.posterior.evidence + 5.0)

    monkeypatch.setattr(joint_learning, "_over", over)
    monkeypatch.setattr(joint_learning, "fit", longer)
    other = fit_of(of_beginnings) if of_beginnings is not None else None
    found = refitted(fit_of(of_search), (object(),), other)
    assert found.posterior.evidence == expected
    lost = fit_of(None)
    assert refitted(lost, (object(),), lost) is lost


@pytest.mark.slow
def test_drafts_are_reliable_for_the_fitted_set_up():
    """The plain model stood for a turned clamp with six times the damping: beside it a draft that
    was right for that erred by 0.7 of the noise, and 120 of log evidence were lost.
    """
    recording, given = moving("simple", {"clamp_angle": {"start": np.radians(1.5)}}, 51)
    begun = begin([recording], given)
    training = training_set(begun, 1, begun.at.model.settings, given)
    (draft,), setup = training.prepared.recordings, training.prepared.setup
    exact = replace(begun.recordings[0], tolerance=1e-5)
    (here,), (there,) = (
        whitened(at, [recording])
        for at, recording in ((setup, draft), (simulate(setup.model, [exact], ()), exact))
    )
    assert rms([here - there]) < IMMATERIAL


def test_of_a_recording_that_foretells_its_end_some_frames_are_neither_learned_nor_foretold(
    monkeypatch,
):
    """Nor does the plain model learn from them, with which the gain is measured."""
    recording, given = moving("simple", {}, 51)
    begun = begin([recording], given)
    training = training_set(begun, 1, begun.at.model.settings, given)
    monkeypatch.setattr(joint_learning, "explain", lambda *_: None)
    monkeypatch.setattr(joint_learning, "_predicting", lambda learned, _: learned)
    learned = joint_learning.learn(training, given, lambda: ())
    ((seen,), (held,)), frames = (learned.seen, learned.masks), len(begun.recordings[0].times)
    assert seen.sum() == len(learned.parts[0].times) < 0.65 * frames
    assert not (seen & held).any() and 0.05 * frames < frames - (seen | held).sum() < 0.15 * frames


@pytest.mark.parametrize(
    ("err", "near", "moved"),
    [
        (0.9e-3, 0.5e-3, False),  # nothing that matters is left
        (1.4e-3, 0.8e-3, False),  # nor where it comes as near as it can
        (9.0e-3, 7.0e-3, True),
        (9.0e-3, 9.0e-3, True),
    ],
)
def test_what_is_not_explained_is_foretold_by_what_lies_nearest(monkeypatch, err, near, moved):
    """A noodle that creeps was foretold to 7.0 mm for 8.0, a cable to 7.3 for 7.9."""
    at, there = evaluation(0.0, err), evaluation(-90.0, near)
    at.model = there.model = model_of(PAPER)
    monkeypatch.setattr(joint_learning, "own_err", lambda *_: 1e-3 / OWN)
    monkeypatch.setattr(joint_learning, "approached", lambda *_: there)
    assert joint_learning.nearest(at, ()) is (there if moved else at)
