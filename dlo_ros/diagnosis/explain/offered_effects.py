# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that might be added to a model, each simulated where it is looked for, and ranked."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.proposals.linear_evidence import (
    Extra,
    PredictedGain,
    Proposal,
    added,
    columns,
    freed,
    is_present,
    predicted_gains,
    simulated_together,
    with_proposals,
)
from dlo_ros.effects import Start
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, Simulated, differences, simulate
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.rod.compiled_rod import is_linear
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

SHAPES_ALIKE = 0.005
"""Mean distance of the shapes of two models over the length, up to which the derivatives by what
might be added to one of them serve the other: the tolerance of a clamp's place moves them as far.
With ten times as much a plug beside a softening was taken for a mass and a stiff segment."""


@dataclass(frozen=True)
class Offer:
    """Effects that might be added to a model, each simulated where it is looked for.

    Args:
        at: the simulation of the model.
        proposals: proposals of effects that the model does not contain.
        extra: derivatives of the shapes by what each proposal adds, see `linear_evidence.columns`.
    """

    at: Simulated
    proposals: tuple[Proposal, ...]
    extra: Extra

    def serves(self, other: Simulated) -> bool:
        """Whether these derivatives serve another model, too, since its shapes are near."""
        pairs = zip(self.at.predicted, other.predicted, strict=True)
        apart = [np.linalg.norm((a - b)[..., :3], axis=2).mean() for a, b in pairs]
        return float(np.mean(apart)) < SHAPES_ALIKE * other.model.settings.rod.length

    def beside(self, model: ParametricModel) -> Offer:
        """The offer of effects that another model does not contain."""
        absent = (p for p in self.proposals if p.start and not is_present(model, p.start))
        return replace(self, proposals=tuple(absent))


def offered(
    at: Evaluation, recordings: Sequence[Recording], begun: Sequence[Start],
    known: Offer | None = None,
) -> Offer:  # fmt: skip
    """Simulate every effect that might be added to a model.

    Args:
        begun: effects that might be added, at their starting values.
        known: an offer for another model, which may serve this one.
    """
    if known is not None and known.serves(at):
        return known.beside(at.model)
    proposals = added(at.model, begun)
    extra: Extra = {}
    for together in simulated_together(at.model.settings, proposals):
        extra |= _derivatives(at, together, recordings)
    return Offer(at, tuple(p for p in proposals if id(p) in extra), extra)


def _derivatives(
    at: Evaluation, together: Sequence[Proposal], recordings: Sequence[Recording]
) -> Extra:
    """Derivatives by what effects add, of those that can be simulated.

    Where they cannot be simulated together, halves of them are: one of them may have to be left
    out, and not the others.
    """
    model, names = with_proposals(at.model, together)
    try:
        if names and is_linear(at.model.settings) and not is_linear(model.settings):
            return {id(p): _differences(at, p, recordings) for p in together}
        return columns(at, together, simulate(model, recordings, names))
    except SimulationError as err:
        LOG.info("%s: %s", ", ".join(p.label for p in together), err)
    half = len(together) // 2
    parts = (together[:half], together[half:]) if half else ()
    found = [_derivatives(at, part, recordings) for part in parts]
    return {proposal: slopes for part in found for proposal, slopes in part.items()}


def _differences(
    at: Evaluation, proposal: Proposal, recordings: Sequence[Recording]
) -> tuple[FloatArray, ...]:
    """Derivatives by what an effect adds beside which the rod is no longer linear.

    A run without derivatives for each of its numbers costs less than one with them.
    """
    model, names = with_proposals(at.model, [proposal])
    pairs = zip(recordings, at.fields, strict=True)
    return tuple(differences(model, r, names, residual) for r, (residual, _) in pairs)


def ranked_proposals(at: Evaluation, offer: Offer) -> list[PredictedGain]:
    """The predictions of all proposals, best first.

    Args:
        offer: offer of the same model, or of one whose shapes differ by little.
    """
    proposals = [*freed(at.model), *offer.proposals]
    known = [p for p in predicted_gains(at, proposals, offer.extra) if np.isfinite(p.gain)]
    return sorted(known, key=lambda p: -p.gain)
