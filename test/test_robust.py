# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The fit to those pictures that a model can explain."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_candidates import KNOWN
from measured import swing
from rods import PAPER

from dlo_ros.diagnosis.fitting import evaluate, fit
from dlo_ros.diagnosis.measured import measured
from dlo_ros.diagnosis.model import baseline
from dlo_ros.diagnosis.robust import hits, robust
from dlo_ros.diagnosis.workers import Problem

NAMES = ("start",)


@pytest.fixture(scope="module")
def hit():
    """A swing whose last third is far from where it would be, and a model that is too stiff."""
    one = swing(PAPER, seconds=1.2)
    off = np.zeros((PAPER.rod.control_points, 4))
    off[:, 2] = np.linspace(0.0, 0.03, len(off)) ** 2 / 0.03
    seen = list(one.observations)
    for k in range(2 * len(seen) // 3, len(seen)):
        seen[k] = replace(seen[k], control_points=seen[k].control_points + off)
    recording = measured(replace(one, observations=tuple(seen)), KNOWN)
    begun = evaluate(baseline(KNOWN), [recording], KNOWN, derivatives=False)
    recordings = (recording.with_noise(begun.predicted[0], KNOWN),)
    theta = baseline(KNOWN).theta()
    theta[0] += 0.2
    start = evaluate(baseline(KNOWN).at(theta), recordings, KNOWN)
    return recordings, start


def modulus(at):
    return at.model.settings.rod.young_modulus / PAPER.rod.young_modulus


def test_what_was_hit_does_not_bend_the_fit(hit):
    recordings, start = hit
    together = fit(start, recordings, KNOWN, 8)
    calm = robust(start, recordings, KNOWN)
    assert abs(modulus(together) - 1.0) > 0.02
    assert modulus(calm) == pytest.approx(1.0, abs=0.005)
    power = [np.mean(at.residuals[0] ** 2, axis=1) for at in (together, calm)]
    half = len(power[0]) // 2
    assert np.mean(power[1][:half]) < 2.0 < np.mean(power[0][:half])


def test_what_may_have_been_hit_begins_at_that_fit(hit):
    recordings, start = hit
    together = fit(start, recordings, KNOWN, 8)
    problem = Problem(recordings, KNOWN, recordings)
    found = hits(problem, together, NAMES, ())
    assert found and {s.effect for s in found} == {"obstacle"}
    calm = robust(together, recordings, KNOWN)
    for s in found:
        np.testing.assert_allclose(s.own, calm.model.theta() - together.model.theta(), rtol=1e-6)
    # Where that fit tells nothing new, nothing new is begun.
    assert hits(problem, calm, NAMES, ()) == []
