# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A search that begins with the cause that gained second most.

Of several causes the wrong one may explain most while the others are missing: a mass at the end
does most of what a plug does whose grip gives. No later step leads from the one to the other where
what stands beside it has to change, too.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from dlo_ros.diagnosis.explain.cause_search import Search, leaves_something, search
from dlo_ros.diagnosis.explain.trials import FIT_ITERATIONS, comes_nearer
from dlo_ros.effects import Start
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import log_bayes_factor, tells_apart
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.thresholds import CLEARLY_LESS, WORTH

LOG = logging.getLogger(__name__)


def best_of_beginnings(
    found: Search, setup: Evaluation, neutral: ParametricModel, recordings: Sequence[Recording],
    begun: Sequence[Start], enough: float,
) -> Search:  # fmt: skip
    """A search's result, or that of one from its second cause if that certainly explains more.

    It goes on beyond two causes where these gain nearly as much as the first two of the result.

    Args:
        found: the result; it stays where the second cause is part of it, or where a single cause
            leaves nothing that matters. Where it leaves something, evidence is that of a wrong
            model, and any beginning may seem the better one: the other one must leave nothing.
        setup: the set-up without causes, fitted.
        neutral, begun, enough: see `cause_search.search`.
    """
    if found.second is None or found.second[1].effect in {c.effect for c in found.causes}:
        return found
    left = leaves_something(found.at, recordings, enough)
    if len(found.causes) == 1 and not left:
        return found
    at, cause = found.second
    there = fit(at, recordings, FIT_ITERATIONS)
    wanted = found.at.posterior.evidence + WORTH
    other = search(
        there, neutral, recordings, begun, enough, present=(cause,), wanted=wanted, most=2
    )
    least = setup.posterior.evidence
    enough_of_two = CLEARLY_LESS * (min(found.of_two, wanted) - least)
    if other.at.posterior.evidence - least >= enough_of_two:
        more = search(
            other.at, neutral, recordings, begun, enough, present=other.causes, wanted=wanted
        )
        other = replace(more, trace=(*other.trace, *more.trace))
    gain = log_bayes_factor(other.at, found.at)
    LOG.info("begun with %s: %+.1f in evidence", cause.label, gain)
    better = tells_apart(other.at, found.at) and comes_nearer(other.at, found.at, recordings)
    if better and left:
        better = not leaves_something(other.at, recordings, enough)
    return replace(other if better else found, trace=(*found.trace, *other.trace))
