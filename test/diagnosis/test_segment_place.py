# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A segment whose fit began at the wrong place, in a recording of the discrete rod."""

from dataclasses import replace

import pytest
from experiment_recordings import moving

from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.segment_place import CENTRE, with_segment_elsewhere
from dlo_ros.diagnosis.explain.trials import fitted
from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.diagnosis.proposals.linear_evidence import proposal_of, with_proposals
from dlo_ros.effects import Start, starts
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.inference.parameter import value_of

pytestmark = pytest.mark.long

PLACE = 0.12  # of the segment's middle [m]


@pytest.fixture(scope="module")
def prepared():
    hidden = {"stiff_segment": {"centre": PLACE, "extent": 0.08, "ratio": 3.0}}
    recording, given = moving("c_shape", hidden, 12)
    begun = begin([recording], given)
    return training_set(begun, 1, begun.at.model.settings, given).prepared


@pytest.fixture(scope="module")
def places(prepared):
    return [s for s in starts(prepared.scene) if s.effect == "stiff_segment"]


def fitted_with(prepared, start):
    """The set-up fitted with a segment that begins somewhere."""
    segment = proposal_of(prepared.setup.model.settings, start)
    model, _ = with_proposals(prepared.setup.model, [segment])
    return Search(fitted(model, prepared.recordings), (segment,), (), None)


@pytest.mark.slow
def test_a_soft_segment_elsewhere_becomes_the_stiff_one_and_stays(prepared, places):
    soft = replace(places[2], block={**places[2].block, "ratio": 0.4})
    wrong = fitted_with(prepared, soft)
    assert abs(value_of(wrong.at.model.settings, CENTRE) - PLACE) > 0.05
    found = with_segment_elsewhere(wrong, prepared.recordings, places)
    settings = found.at.model.settings
    assert value_of(settings, CENTRE) == pytest.approx(PLACE, abs=5e-3)
    assert settings.effects["stiff_segment"]["ratio"] > 2.5
    assert found.at.mean_err < 0.1 * wrong.at.mean_err
    assert [c.label for c in found.causes] == [proposal_of(settings, places[1]).label]
    assert with_segment_elsewhere(found, prepared.recordings, places) is found


def test_what_contains_no_segment_stays(prepared, places):
    force = Start("constant_force", {"x": 0.0, "z": 0.0}, ("x", "z"), ("x", "z"))
    found = fitted_with(prepared, force)
    assert with_segment_elsewhere(found, prepared.recordings, places) is found
