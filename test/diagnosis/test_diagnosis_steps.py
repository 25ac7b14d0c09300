# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Steps of the diagnosis: coarse trials, refinement, fits that end, walls."""

from dataclasses import replace

import numpy as np
import pytest
from measured import swing
from rods import KNOWN, PAPER

from dlo_ros.diagnosis.findings import joint_learning
from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.errors import SimulationError
from dlo_ros.identification.offline import initial_fit
from dlo_ros.identification.offline.drafts import drafts
from dlo_ros.identification.offline.initial_fit import begin, finer, fitted
from dlo_ros.identification.residual_noise import rms, whitened
from dlo_ros.inference import joint_fit
from dlo_ros.inference.joint import simulate
from dlo_ros.inference.losses import WhiteLoss

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def beginning():
    return begin([swing(PAPER, seconds=1.0), swing(PAPER, seconds=0.6, seed=1)], KNOWN)


def test_a_coarse_trial_agrees_where_it_begins(beginning, monkeypatch):
    monkeypatch.setattr("dlo_ros.identification.offline.drafts.IMMATERIAL", 50.0)
    at = beginning.at
    tried = drafts(beginning.recordings, at)
    coarse = whitened(simulate(at.model, tried, ()), tried)
    for draft, fine, here, there in zip(
        tried, beginning.recordings, coarse, whitened(at, beginning.recordings), strict=True
    ):
        assert draft.tolerance > fine.tolerance
        assert not np.allclose(draft.observed, fine.observed, rtol=0.0, atol=1e-6)
        assert here == pytest.approx(there, abs=1e-6)


def test_a_draft_has_the_longest_steps_that_are_reliable(beginning, monkeypatch):
    """Steps between those of a first draft and the recording's own, where they do."""
    monkeypatch.setattr("dlo_ros.identification.offline.drafts.DRAFT_TOLERANCE", 1e-1)
    monkeypatch.setattr("dlo_ros.identification.offline.drafts.LONGEST", 1e-1)
    fine = [replace(r, tolerance=1e-6) for r in beginning.recordings]
    at = simulate(beginning.at.model, fine, ())
    for draft, recording in zip(drafts(fine, at), fine, strict=True):
        assert 1e-6 < draft.tolerance < 1e-1
        longer = replace(recording, tolerance=10.0 * draft.tolerance, spans=draft.spans)
        there = whitened(simulate(at.model, [longer], ()), [longer])
        here = whitened(simulate(at.model, [recording], ()), [recording])
        assert rms([there[0] - here[0]]) > 0.3


def test_drafts_may_do_wrong_what_they_do_wrong_with_a_model_beside(beginning, monkeypatch):
    """They are coarser then, and right to the noise between both models and a little farther on."""
    monkeypatch.setattr("dlo_ros.identification.offline.drafts.IMMATERIAL", 0.0)
    monkeypatch.setattr("dlo_ros.identification.offline.drafts.DRAFT_SPANS", 1)
    fine = [replace(r, spans=56, tolerance=1e-5) for r in beginning.recordings]
    at = simulate(beginning.at.model, fine, ())
    beside = simulate(at.model.stiffened(1.1), fine, ())
    right, rough = drafts(fine, at), drafts(fine, at, beside)
    for draft, exact in zip(rough, right, strict=True):
        assert draft.spans < exact.spans or draft.tolerance > exact.tolerance
    for factor in (1.0, 1.05, 1.2):
        model = at.model.stiffened(factor)
        there = whitened(simulate(model, fine, ()), fine)
        here = whitened(simulate(model, rough, ()), rough)
        changed = rms([x - y for x, y in zip(there, whitened(at, fine), strict=True)])
        off = rms([x - y[: len(x)] for x, y in zip(here, there, strict=True)])
        assert off < 0.05 * changed + 1e-6


def test_a_recording_of_unknown_fineness_has_drafts(beginning, monkeypatch):
    monkeypatch.setattr("dlo_ros.identification.offline.drafts.IMMATERIAL", 50.0)
    open_ = [replace(r, spans=None) for r in beginning.recordings]
    for draft in drafts(open_, beginning.at):
        assert draft.spans == 14


def test_long_recordings_are_tried_in_part(beginning, monkeypatch):
    monkeypatch.setattr("dlo_ros.identification.offline.drafts.DRAFT_FRAMES", 20)
    monkeypatch.setattr("dlo_ros.identification.offline.drafts.LEAST_FRAMES", 5)
    at = beginning.at
    tried = drafts(beginning.recordings, at)
    residuals = whitened(at, beginning.recordings)
    for draft, whole, residual in zip(tried, beginning.recordings, residuals, strict=True):
        count = len(draft.times)
        assert 10 <= count < len(whole.times) == len(residual)
        assert len(draft.manipulation.observations) == len(draft.observed) == count
        shown = np.sum(residual[:count] ** 2) / np.sum(residual**2)
        assert shown >= 0.25


def test_a_simulation_is_refined_for_a_model_that_comes_near(beginning):
    fine = dict(enumerate(beginning.recordings))
    assert finer(beginning, beginning.at.model, fine) is None
    rough = tuple(replace(r, spans=7, tolerance=5e-3) for r in beginning.recordings)
    sharper = finer(replace(beginning, recordings=rough), beginning.at.model, fine)
    assert sharper is not None
    assert all(r.tolerance < 5e-3 for r in sharper.recordings)
    assert sharper.near.model.settings == beginning.at.model.settings
    assert sharper.at.mean_err < simulate(beginning.at.model, rough, ()).mean_err


def test_a_simulation_that_is_fine_enough_is_simulated_once_more(beginning, monkeypatch):
    """How fine it should be is looked for where the next finer one tells another thing alone."""

    def looked_for(*_):
        raise AssertionError("a resolution was looked for")

    monkeypatch.setattr(initial_fit, "_finer", looked_for)
    assert finer(beginning, beginning.at.model, {}) is None
    rough = tuple(replace(r, spans=7, tolerance=5e-3) for r in beginning.recordings)
    with pytest.raises(AssertionError, match="looked for"):
        finer(replace(beginning, recordings=rough), beginning.at.model, {})


def test_a_model_that_cannot_be_simulated_as_it_is_may_be_with_finer_steps(beginning, monkeypatch):
    def not_as_it_is(model, recordings, *words):
        if recordings is beginning.recordings and model is near:
            raise SimulationError("does not converge")
        return simulate(model, recordings, *words)

    near = replace(beginning.at.model)
    monkeypatch.setattr(initial_fit, "simulate", not_as_it_is)
    sharper = finer(beginning, near, {})
    assert sharper is not None and sharper.near is not None
    assert sharper.near.model is near
    assert all(r.tolerance < 1e-2 for r in sharper.recordings)

    def not_at_all(*_):
        raise SimulationError("does not converge")

    monkeypatch.setattr(initial_fit, "simulate", not_at_all)
    with pytest.raises(SimulationError):
        finer(beginning, near, {})


@pytest.mark.parametrize(
    ("errors", "begun"),
    [
        ((9, 8, 7, 6, 5, 4, 3, 2, 1), [1]),
        ((9, 8, 2, 6, 5, 3, 1, 7, 8), [1, 2]),
        ((2, 8, None, 3, None, 8, 1, 7, 5), [1, 2]),
    ],
)
def test_one_fit_begins_in_each_minimum_that_starts_show(beginning, monkeypatch, errors, begun):
    """Not where twice as much is left as from the best one, nor where nothing can be simulated."""
    at, tried = beginning.at, []
    left = iter(errors)

    def simulated(model, *_):
        err = next(left)
        if err is None:
            raise SimulationError("diverges")
        return replace(at, model=model, err=(np.full(3, float(err)),))

    monkeypatch.setattr(initial_fit, "simulate", simulated)
    monkeypatch.setattr(initial_fit, "_with_noise", lambda recordings, _: recordings)
    monkeypatch.setattr(initial_fit, "_fitted_to_most", lambda at, _: tried.append(at.mean_err))
    found = initial_fit._best_start(beginning.recordings, at.model)
    assert tried == begun
    assert found.mean_err == 1.0


def test_drafts_are_made_for_the_model_that_comes_near(beginning, monkeypatch):
    """With drafts that agree with the plain model's simulation alone, causes would be mended."""
    monkeypatch.setattr(joint_learning, "_with_reliable_drafts", lambda prepared, _: prepared)
    coarse = {1: replace(beginning.recordings[1], spans=7, tolerance=5e-3)}
    sharper = finer(beginning, beginning.at.model, coarse)
    assert sharper is not None and sharper.recordings == beginning.recordings
    heavy = beginning.at.model.theta()
    heavy[0] += 0.3
    near = simulate(beginning.at.model.at(heavy), beginning.recordings, ())
    training = training_set(replace(beginning, near=near), 2, beginning.at.model.settings, KNOWN)
    rough = training.prepared.recordings
    there = whitened(simulate(near.model, rough, ()), rough)
    for draft, fine in zip(there, whitened(near, beginning.recordings), strict=True):
        assert draft == pytest.approx(fine[: len(draft)], abs=1e-6)


def test_what_starts_in_motion_is_refined_without_equilibria(monkeypatch):
    def at_rest(*words, **more):
        raise AssertionError("an equilibrium was asked for")

    monkeypatch.setattr("dlo_ros.identification.offline.initial_fit.forecast", at_rest)
    moving = replace(KNOWN, simulation=replace(KNOWN.simulation, start="moving"))
    begun = begin([swing(PAPER, seconds=0.5)], moving)
    assert begun.recordings[0].spans > 7
    assert 0.0 < begun.error < 1e-4 * PAPER.rod.length
    assert begun.at.err[0].mean() < 5e-3 * PAPER.rod.length


def test_a_fit_ends_where_nothing_is_promised(beginning, monkeypatch):
    at = fitted(beginning.at.model, beginning.recordings)

    def simulated(*words, **more):
        raise AssertionError("simulated although nothing is to be gained")

    monkeypatch.setattr(joint_fit, "borrowed", simulated)
    loss = WhiteLoss([r.noise for r in beginning.recordings])
    assert joint_fit.fit(at, beginning.recordings, 3, loss=loss) is at
