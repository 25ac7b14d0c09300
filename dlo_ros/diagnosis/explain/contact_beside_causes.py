# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A peg or wall beside other causes, which hide it as long as they are not known.

Contacts are proposed by the pictures that are wrong in a model which is right before the DLO hits
anything. Where a grip slips, or a creep goes on, the set-up alone is right in none.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from dlo_ros.diagnosis.contact.contact_search import (
    EFFECTS,
    ContactBesideSetUp,
    contacts_beside_set_up,
)
from dlo_ros.diagnosis.explain.candidate_trials import comes_nearer
from dlo_ros.diagnosis.explain.cause_search import Search, leaves_something, search, takes_little
from dlo_ros.diagnosis.explain.contact_trials import Contact, best_contact
from dlo_ros.effects import Start
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import log_bayes_factor
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.thresholds import WORTH
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)


def with_contact(
    found: Search, given: Settings, neutral: ParametricModel, recordings: Sequence[Recording],
    begun: Sequence[Start], enough: float,
) -> tuple[Search, Contact | None]:  # fmt: skip
    """A search that goes on with what the DLO may have hit beside its causes.

    Args:
        found: the result of a search; where it leaves nothing that matters, it stays.
        given: the parameter file.
        neutral, begun, enough: see `cause_search.search`.

    Returns:
        The better result, and what was hit; None where nothing was, or it had been found.
    """
    if not found.causes or EFFECTS & {c.effect for c in found.causes}:
        return found, None
    if not leaves_something(found.at, recordings, enough):
        return found, None
    contact = best_contact(found.at, recordings, _contacts(found, given, recordings))
    if contact is None or takes_little(contact.trial, found.at, recordings):
        return found, None
    at, hit = contact.trial
    causes = (*found.causes, hit)
    more = search(at, neutral, recordings, begun, enough, present=causes)
    gain = log_bayes_factor(more.at, found.at)
    LOG.info("%s beside the causes: %+.1f in evidence", hit.label, gain)
    if gain < WORTH or not comes_nearer(more.at, found.at, recordings):
        return found, None
    return replace(more, trace=(*found.trace, *more.trace)), contact


def _contacts(
    found: Search, given: Settings, recordings: Sequence[Recording]
) -> list[ContactBesideSetUp]:
    """Pegs and walls beside causes that stay what they are in undisturbed pictures."""
    model = found.at.model
    of_causes = {p.name for c in found.causes for p in c.parameters}
    pairs = zip(model.parameters, model.theta(), strict=True)
    held = model.with_prior([p.held(float(x)) for p, x in pairs if p.name in of_causes])
    there = contacts_beside_set_up(recordings, given, held)
    return [replace(c, before=model.at(c.before.theta())) for c in there]
