# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What is held out is only predicted: no number of the plain model comes from it."""

from dataclasses import replace

import pytest
from experiment_recordings import moving

from dlo_ros.diagnosis.fitting.initial_fit import begin
from dlo_ros.diagnosis.pipeline import _learned


def test_the_plain_model_has_not_seen_what_is_held_out():
    recording, given = moving("simple", {}, 41)
    other, _ = moving("simple", {"gravity_tilt": {"angle": 0.3}}, 42)
    both = begin([recording, replace(other, name="other")], given)
    alone = begin([recording], given)
    found = _learned(both, 1, given)
    ratio, spoilt, expected = (
        at.model.settings.rod.specific_modulus for at in (found, both.at, alone.at)
    )
    assert abs(spoilt / expected - 1.0) > 0.1
    assert ratio == pytest.approx(expected, rel=4.5e-3)  # its std is 0.15 %
    assert found.cost < 1.01 * alone.at.cost
    assert len(found.residuals) == len(found.err) == 1
    assert float(found.err[0].mean()) == pytest.approx(float(alone.at.err[0].mean()), rel=0.02)
    # Nothing is fitted anew where nothing is held out.
    assert _learned(both, 2, given) is both.at
