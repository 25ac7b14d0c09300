# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The explanation of recordings: a model with its causes, and effects that may act beside them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace

from dlo_ros.diagnosis.explain.candidate_trials import Step
from dlo_ros.diagnosis.explain.cause_naming import Cause, Shifts
from dlo_ros.diagnosis.explain.certainty import SCALES, beyond, beyond_for_certain, certain
from dlo_ros.diagnosis.explain.contact_trials import Contact
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, freed
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.thresholds import FAR
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class Explanation:
    """The recordings explained by the joint model.

    Args:
        setup: the set-up within tolerance, fitted.
        at: the same with all causes.
        causes: the causes that are certain.
        own_err: ERR that the measurement alone has [m].
        material_err: ERR [m] below which nothing is left to explain.
        nameable_err: ERR [m] that an effect which has been added must take away to be named.
        proposals: all that the search has added or freed, certain or not.
        trace: every candidate of every step.
        shifts: changes of the other numbers where an added effect is left out, or a damping has its
            guess, or a rival stands in a cause's place.
        exact: whether the set-up is as precise as the data tell, see `exact_setup`.
        contact: what may have been hit; None: nothing.
        naming: function that gives the explanation with its causes, where they are not known yet:
            see `with_names`.
        uncertain: causes that what was learned from shows, but all that may be learned from does
            not show for certain, see `still_certain`.
    """

    setup: Evaluation
    at: Evaluation
    causes: tuple[Cause, ...]
    own_err: float
    material_err: float
    nameable_err: float
    proposals: tuple[Proposal, ...]
    trace: tuple[Step, ...]
    shifts: Shifts = field(default_factory=dict)
    exact: bool = False
    contact: Contact | None = None
    naming: Callable[[], Explanation] | None = None
    uncertain: tuple[Cause, ...] = ()

    def with_names(self) -> Explanation:
        """The explanation with its causes, which take many fits to be certain of.

        It is another one where a rival of a cause explains the data better. An explanation that is
        only the way to another one needs no names.
        """
        return self if self.naming is None else self.naming()

    @property
    def doubts(self) -> tuple[Mapping[str, float], ...]:
        """The shifts by what may or may not act: what the model contains although it is no certain
        cause, what was left out of it, and rivals of causes.
        """
        named = {c.effect for c in self.causes}
        return tuple(changes for effect, changes in self.shifts.items() if effect not in named)


def still_certain(found: Explanation, final: Evaluation, covariance: FloatArray) -> Explanation:
    """The explanation with those causes alone that a fit to more data shows for certain, too.

    What only compensated for another law in the recordings learned from, others may deny. It takes
    little of ERR away; of an added effect that takes most, they only deny the numbers.

    Args:
        final: the model with all causes, fitted to all recordings.
        covariance: that is reported of its parameters, shape (P, P).
    """
    groups = [*found.proposals, *freed(final.model)]
    may_be = {g.label for g in (found.proposals if found.exact else beyond(final, covariance))}
    sure = {p.name for g in groups if _still(final, g, covariance, may_be) for p in g.parameters}
    added = {g.effect for g in found.proposals if g.start is not None}
    most = {c.effect for c in found.causes if c.near < FAR * c.err} & added
    kept = tuple(c for c in found.causes if sure & set(c.names) or c.effect in most)
    return replace(found, causes=kept, uncertain=tuple(c for c in found.causes if c not in kept))


def _still(
    final: Evaluation, group: Proposal, covariance: FloatArray, may_be: Collection[str]
) -> bool:
    """Whether a group is a cause with the values of a fit to more data, and their uncertainty.

    Args:
        may_be: labels of groups of the set-up that may be causes.
    """
    if group.start is None and beyond_for_certain(final, group, covariance):
        return True
    tolerated = group.start is None and all(p.effect for p in group.parameters)
    if tolerated and group.label not in may_be:
        return False
    # No number of the set-up is proportional to E or mu, as the size of an effect may be.
    return certain(final, group, () if group.start is None else SCALES, covariance)
