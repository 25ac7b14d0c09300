# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A peg or wall beside other causes, which hide it as long as they are not known.

Contacts are proposed by the pictures that are wrong in a model which is right before the DLO hits
anything. Where a grip slips, or a creep goes on, the set-up alone is right in none, and a wall that
no picture has shown, or another cause, may take the place of a peg.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

from dlo_ros.diagnosis.contact.contact_search import (
    EFFECTS,
    ContactBesideSetUp,
    contacts_beside_set_up,
)
from dlo_ros.diagnosis.explain.cause_search import Search, leaves_something, search, takes_little
from dlo_ros.diagnosis.explain.contact_trials import Contact, best_contact
from dlo_ros.diagnosis.explain.left_out import without
from dlo_ros.diagnosis.explain.trials import comes_nearer
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal
from dlo_ros.effects import Start
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.joint_fit import nearest_err
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import log_bayes_factor, tells_apart
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.inference.thresholds import LOWERS, WORTH
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)


def with_contact(
    found: Search, given: Settings, neutral: ParametricModel, recordings: Sequence[Recording],
    begun: Sequence[Start], enough: float, *, shown: bool = False,
) -> tuple[Search, Contact | None]:  # fmt: skip
    """A search that goes on with what the DLO may have hit beside its causes.

    Where something is left beside a peg, a wall may have been hit, too, or a peg beside a wall.

    Args:
        found: the result of a search; with one cause that leaves nothing that matters, it stays.
        given: the parameter file.
        neutral, begun, enough: see `cause_search.search`.
        shown: whether what was hit is what the pictures had shown, before any cause was known.

    Returns:
        The better result, and what was hit; None where nothing was, or it had been found.
    """

    def beside(others: tuple[Proposal, ...], contact: Contact) -> Search:
        at, hit = contact.trial
        return search(at, neutral, recordings, begun, enough, present=(*others, hit))

    hit = _hit(found)
    contact = None
    if hit is None or not shown:
        found, contact = _with_first(found, hit, given, recordings, enough, beside)
    if _hit(found) is None or not leaves_something(found.at, recordings, enough):
        return found, contact
    second = _contact(found.at, None, found.causes, given, recordings)
    if second is not None:
        more = beside(found.causes, second)
        found = _better(more, found, second.trial[1], recordings) or found
    return found, contact


def _hit(found: Search) -> Proposal | None:
    """The peg or the wall among a search's causes; None: none is."""
    return next((c for c in found.causes if c.effect in EFFECTS), None)


def _with_first(
    found: Search, hit: Proposal | None, given: Settings, recordings: Sequence[Recording],
    enough: float, beside: Callable[[tuple[Proposal, ...], Contact], Search],
) -> tuple[Search, Contact | None]:  # fmt: skip
    """A search with what the DLO has hit, or with something else in its place; see `with_contact`.

    Args:
        hit: what it has hit as it is known so far.
        beside: function that goes on with causes and a contact.
    """
    places = [hit] if hit is not None else _places(found, recordings, enough)
    for replaced in places:
        others = tuple(c for c in found.causes if c is not replaced)
        contact = _contact(found.at, replaced, others, given, recordings) if others else None
        if contact is not None:
            break
    else:
        return found, None
    peg = contact.trial[1]
    more = beside(others, contact)
    better = _better(more, found, peg, recordings)
    alike = hit is not None and hit.effect == peg.effect  # and elsewhere
    if better is not None and (not alike or tells_apart(more.at, found.at)):
        return better, contact
    if hit is None or alike:
        return found, None
    near = (1.0 - LOWERS) * nearest_err(more.at, recordings) <= nearest_err(found.at, recordings)
    return found, Contact.of((found.at, hit), (more.at, peg), as_near=near)


def _better(
    more: Search, found: Search, hit: Proposal, recordings: Sequence[Recording]
) -> Search | None:
    """A search with something that was hit, if it explains more than one without it."""
    gain = log_bayes_factor(more.at, found.at)
    LOG.info("%s beside the causes: %+.1f in evidence", hit.label, gain)
    if gain < WORTH or not comes_nearer(more.at, found.at, recordings):
        return None
    return replace(more, trace=(*found.trace, *more.trace))


def _places(
    found: Search, recordings: Sequence[Recording], enough: float
) -> list[Proposal | None]:  # fmt: skip
    """The causes in whose place something may have been hit; None: beside all of them.

    While a peg is not known, the last cause may be what does its work: a stiffer segment does not
    bend around it, either.
    """
    beside: list[Proposal | None] = []
    if leaves_something(found.at, recordings, enough):
        beside.append(None)
    last = next((c for c in reversed(found.causes[1:]) if c.start is not None), None)
    return beside if last is None else [*beside, last]


def _contact(
    at: Evaluation, replaced: Proposal | None, causes: Sequence[Proposal], given: Settings,
    recordings: Sequence[Recording],
) -> Contact | None:  # fmt: skip
    """A peg or wall that the DLO may have hit in the place of a cause of a model; None: nothing.

    Args:
        causes: the others.
    """
    bare = at if replaced is None else without(at, replaced, recordings)
    if bare is None:
        return None
    for model in (_with_causes_held(bare.model, causes), bare.model):
        contacts = _contacts(model, bare.model, given, recordings)
        contact = best_contact(bare, recordings, contacts)
        if contact is not None and not takes_little(contact.trial, bare, recordings):
            return contact
    return None


def _with_causes_held(model: ParametricModel, causes: Sequence[Proposal]) -> ParametricModel:
    """A model whose causes stay what they are in undisturbed pictures."""
    of_causes = {p.name for c in causes for p in c.parameters}
    pairs = zip(model.parameters, model.theta(), strict=True)
    return model.with_prior([p.held(float(x)) for p, x in pairs if p.name in of_causes])


def _contacts(
    beside: ParametricModel, model: ParametricModel, given: Settings,
    recordings: Sequence[Recording],
) -> list[ContactBesideSetUp]:  # fmt: skip
    """Pegs and walls beside the causes of a model.

    Args:
        beside: the model as it is fitted to undisturbed pictures.
    """
    there = contacts_beside_set_up(recordings, given, beside)
    return [replace(c, before=model.at(c.before.theta())) for c in there]
