# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A segment at another place: a soft one there may do most of the work of a stiff one here.

E and a gradient make up for the rest, so that a fit which began at the wrong place, while other
causes were missing, ends in a valley of its own. Shapes tell stiffness by ratios alone; no other
effect has such a complement.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.left_out import without
from dlo_ros.diagnosis.explain.offered_effects import offered, ranked_proposals
from dlo_ros.diagnosis.explain.trials import FIRST_ITERATIONS, FIT_ITERATIONS, best_gain, fitted
from dlo_ros.diagnosis.proposals.linear_evidence import PredictedGain
from dlo_ros.effects import Start
from dlo_ros.effects.physics.stiff_segment import StiffSegment
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel, value_of
from dlo_ros.inference.thresholds import CLEARLY_LESS

LOG = logging.getLogger(__name__)

CENTRE, EXTENT = (StiffSegment.parameter(key) for key in ("centre", "extent"))


def with_segment_elsewhere(
    found: Search, recordings: Sequence[Recording], begun: Sequence[Start]
) -> Search:
    """A search's result with its segment at another place, where one explains more.

    That is tried beside all other causes, if derivatives without a segment promise about as much of
    it as of one where the present one lies.

    Args:
        begun: effects that might be added, at their starting values.
    """
    segment = found.cause_of(StiffSegment.name)
    bare = without(found.at, segment, recordings) if segment else None
    if segment is None or bare is None:
        return found
    offer = offered(bare, recordings, [s for s in begun if s.effect == segment.effect])
    ranked = [p for p in ranked_proposals(bare, offer) if p.proposal.effect == segment.effect]
    here = max((p.gain for p in ranked if not _apart(p, found.at.model)), default=0.0)
    there = next((p for p in ranked if _apart(p, found.at.model)), None)
    if there is None or there.gain < CLEARLY_LESS * here:
        return found
    at = fitted(there.model, recordings, FIRST_ITERATIONS, far=True, draft=True)
    trials = [] if at is None else [(fit(at, recordings, FIT_ITERATIONS), there.proposal)]
    better = best_gain(trials, found.at, recordings)
    if better is None:
        return found
    LOG.info("%s, instead of %s", there.proposal.label, segment.label)
    return found.exchanged(segment, better)


def _apart(predicted: PredictedGain, model: ParametricModel) -> bool:
    """Whether a segment is predicted with its middle beyond that of a model."""
    centre, extent = (value_of(model.settings, name) for name in (CENTRE, EXTENT))
    return abs(value_of(predicted.model.settings, CENTRE) - centre) > 0.5 * extent
