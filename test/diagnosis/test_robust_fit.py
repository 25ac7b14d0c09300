# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The fit to those pictures that a model can explain."""

from dataclasses import replace

import numpy as np
import pytest
from measured import swing
from rods import KNOWN, PAPER

from dlo_ros.diagnosis.contact.robust_fit import (
    consensus_fit,
    outlier_frames,
    robust_loss,
)
from dlo_ros.identification.material_model import material_model
from dlo_ros.identification.offline.initial_fit import whitened
from dlo_ros.identification.offline.recording_noise import with_noise
from dlo_ros.inference.joint import evaluate, simulate
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.losses import WHITE
from dlo_ros.inference.measured import measured
from dlo_ros.inference.thresholds import CERTAIN


def pushed_aside(first, far=0.03):
    """A swing whose tip is far from where it would be from a share of it on; a model too stiff."""
    one = swing(PAPER, seconds=1.2)
    aside = np.zeros((PAPER.rod.control_points, 4))
    aside[:, 2] = far * np.linspace(0.0, 1.0, len(aside)) ** 2
    seen = list(one.observations)
    for k in range(int(first * len(seen)), len(seen)):
        seen[k] = replace(seen[k], control_points=seen[k].control_points + aside)
    recording = measured(replace(one, observations=tuple(seen)), KNOWN)
    begun = simulate(material_model(KNOWN, KNOWN), [recording], ())
    recordings = (with_noise(recording, begun.predicted[0], KNOWN),)
    theta = material_model(KNOWN, KNOWN).theta()
    theta[0] += 0.2
    start = evaluate(material_model(KNOWN, KNOWN).at(theta), recordings)
    return recordings, start


@pytest.fixture(scope="module")
def hit():
    return pushed_aside(2.0 / 3.0)


def modulus(at):
    return at.model.settings.rod.young_modulus / PAPER.rod.young_modulus


def test_what_was_hit_does_not_bend_the_fit(hit):
    recordings, start = hit
    together = fit(start, recordings, 8, loss=WHITE)
    found = fit(start, recordings, 8, loss=robust_loss(recordings))
    assert abs(modulus(together) - 1.0) > 0.02
    assert modulus(found) == pytest.approx(1.0, abs=0.005)
    power = [np.mean(whitened(at, recordings)[0] ** 2, axis=1) for at in (together, found)]
    half = len(power[0]) // 2
    assert np.mean(power[1][:half]) < 2.0 < np.mean(power[0][:half])


@pytest.mark.slow
def test_what_was_right_before_tells_of_what_was_wrong_nearly_always():
    """Most pictures are off: only those before tell what the DLO was."""
    recordings, start = pushed_aside(0.3, 0.1)
    together = fit(start, recordings, 8, loss=WHITE)
    found = consensus_fit(recordings, together)
    assert found is not None
    at, scale = found
    assert scale >= CERTAIN
    assert abs(modulus(together) - 1.0) > 0.02
    assert modulus(at) == pytest.approx(1.0, abs=0.01)
    strict = robust_loss(recordings, scale, redescending=True)
    assert strict.of_pictures(at) < strict.of_pictures(together)
    (wrong,) = outlier_frames(at, recordings, scale)
    assert not wrong[: int(0.25 * len(wrong))].any()
    assert wrong[int(0.35 * len(wrong)) :].all()


@pytest.mark.slow
def test_where_all_is_wrong_what_is_typical_is_more(hit):
    recordings, start = hit
    bent = tuple(replace(r, observed=r.observed + np.array([0.0, 0.0, 0.02])) for r in recordings)
    found = consensus_fit(bent, evaluate(start.model, bent))
    assert found is not None
    assert found[1] > 2.0 * CERTAIN
