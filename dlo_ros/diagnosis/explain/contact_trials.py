# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fits with something that the DLO may have hit: a peg, or a wall in its place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dlo_ros.diagnosis.contact.contact_search import PegBesideSetUp, wall_instead
from dlo_ros.diagnosis.explain.candidate_trials import LOWERS, Trial, best_gain, fitted, gains
from dlo_ros.diagnosis.proposals.linear_evidence import proposal_of, with_proposals
from dlo_ros.effects.start import Block
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.measured import Recording

Rivals = Mapping[str, Block]
"""Effects that explain the data as well in the place of a cause, with the values of their keys."""


@dataclass(frozen=True)
class Contact:
    """A peg or a wall that the DLO may have hit.

    Args:
        trial: the fit with it.
        rivals: what it may have hit instead.
    """

    trial: Trial
    rivals: Rivals


def best_contact(
    at: Evaluation, recordings: Sequence[Recording], pegs: Sequence[PegBesideSetUp]
) -> Contact | None:
    """The fit with the peg that explains most, or with a wall in its place that explains more.

    Each peg starts from the fit before the impact, the wall from that with the peg. Fits to
    impacts end at kinks, where their evidence is not that of an optimum: one that comes as near to
    the shapes is a rival, whatever its evidence.

    Args:
        at: the joint model without a peg, fitted to the same recordings, perhaps in another
            minimum.
        pegs: candidates, with the model as it was before the impact.
    """
    found: list[Trial] = []
    for candidate in pegs:
        proposal = proposal_of(candidate.before.settings, candidate.peg)
        model, _ = with_proposals(candidate.before, [proposal])
        here = fitted(model, recordings)
        if here is not None:
            found.append((here, proposal))
    best = best_gain(found, at)
    if best is None:
        return None
    flat = _with_wall(best, recordings)
    if flat is None:
        return Contact(best, {})
    first, second = (flat, best) if gains(flat, best[0]) else (best, flat)
    if (1.0 - LOWERS) * second[0].mean_err > first[0].mean_err:
        return Contact(first, {})
    effect = second[1].effect
    return Contact(first, {effect: second[0].model.settings.effects[effect]})


def _with_wall(pegged: Trial, recordings: Sequence[Recording]) -> Trial | None:
    """The fit with a wall in place of a peg; None where the DLO reaches behind it."""
    there, peg = pegged
    start = wall_instead(there.model, [r.observed for r in recordings])
    if start is None:
        return None
    bare = there.model.without([p.name for p in peg.parameters])
    proposal = proposal_of(bare.settings, start)
    found = fitted(with_proposals(bare, [proposal])[0], recordings)
    return None if found is None else (found, proposal)
