# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fits with something that the DLO may have hit: a peg or a wall."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from dlo_ros.diagnosis.contact.contact_search import ContactBesideSetUp
from dlo_ros.diagnosis.explain.trials import FIRST_ITERATIONS, Trial, best_gain, fitted, gains
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, proposal_of, with_proposals
from dlo_ros.effects import Start
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.effects.start import Block
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.thresholds import LOWERS

Rivals = Mapping[str, Block]
"""Effects that explain the data as well in the place of a cause, with the values of their keys."""


@dataclass(frozen=True)
class Contact:
    """A peg or a wall that the DLO may have hit.

    Args:
        trial: the fit with it.
        rivals: what it may have hit instead.
        farther: what does worse in its place; where the model lacks something, that may be why.
    """

    trial: Trial
    rivals: Rivals
    farther: Rivals = field(default_factory=dict)

    @classmethod
    def of(cls, first: Trial, second: Trial, *, as_near: bool) -> Contact:
        """A contact with the other of peg and wall beside it, as a rival or as what does worse.

        Args:
            as_near: whether the second comes as near to the shapes.
        """
        at, proposal = second
        other = {proposal.effect: at.model.settings.effects[proposal.effect]}
        return cls(first, other) if as_near else cls(first, {}, other)

    def instead(self, *, complete: bool) -> Rivals:
        """The rivals of what was hit, beside a model that is complete or lacks something."""
        return self.rivals if complete else {**self.farther, **self.rivals}


def best_contact(
    at: Evaluation, recordings: Sequence[Recording], contacts: Sequence[ContactBesideSetUp]
) -> Contact | None:
    """The fit with the peg that explains most, or with the wall that explains more.

    Each starts from the fit before the impact. Fits to impacts end at kinks, where their evidence
    is not that of an optimum: one that comes as near to the shapes is a rival, whatever its
    evidence.

    Args:
        at: the joint model without a contact, fitted to the same recordings, perhaps in another
            minimum.
        contacts: candidates, with the model as it was before the impact.
    """
    found: list[Trial] = []
    for candidate in contacts:
        proposal = proposal_of(candidate.before.settings, candidate.start)
        model, _ = with_proposals(candidate.before, [proposal])
        here = fitted(model, recordings)
        if here is not None:
            found.append((here, proposal))
    flat = best_gain([f for f in found if f[1].effect == StraightWall.name], at, recordings)
    round_ = best_gain([f for f in found if f[1].effect != StraightWall.name], at, recordings)
    if flat is None or round_ is None:
        only = flat or round_
        return None if only is None else Contact(only, {})
    first, second = (flat, round_) if gains(flat, round_[0]) else (round_, flat)
    as_near = (1.0 - LOWERS) * second[0].mean_err <= first[0].mean_err
    return Contact.of(first, second, as_near=as_near)


def begun_in_place(
    at: Evaluation, wall: Proposal, start: Start, recordings: Sequence[Recording]
) -> Trial | None:
    """The first steps of a fit with something else that is hit in the place of a wall.

    Args:
        at: a fit with the wall.
        wall: the wall, of which all is left out.
        start: what is hit instead.

    Returns:
        None where that cannot be simulated.
    """
    bare = at.model.without([p.name for p in wall.parameters])
    proposal = proposal_of(bare.settings, start)
    model, _ = with_proposals(bare, [proposal])
    begun = fitted(model, recordings, FIRST_ITERATIONS, draft=True)
    return None if begun is None else (begun, proposal)
