# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Whether what a cause explains matters."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dlo_ros.diagnosis.explain.cause_search import bears_a_share
from dlo_ros.diagnosis.explain.certainty import (
    beyond,
    has_certainly_other_stiffness,
    is_beyond,
    strained,
)
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal
from dlo_ros.effects import effects
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.joint_fit import approached
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import tells_apart
from dlo_ros.inference.plain_rod import taken_for_plain
from dlo_ros.inference.thresholds import LOWERS, OWN

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Judge:
    """The judgement of single causes of a model.

    Args:
        at: the model with all causes, fitted.
        setup: the set-up without causes, fitted.
        recordings: the recordings that both are fitted to.
        owns, least, exact, complete: see `cause_naming.named`.
    """

    at: Evaluation
    setup: Evaluation
    recordings: Sequence[Recording]
    owns: Sequence[float]
    least: float
    exact: bool
    complete: bool

    @cached_property
    def near(self) -> Evaluation:
        """The model with all causes, nearer to the shapes."""
        return approached(self.at, self.recordings)

    def matters(self, group: Proposal, bare: Evaluation, there: Evaluation) -> bool:
        """Whether what a fit without a cause misses matters; see `cause_naming.named`.

        Args:
            bare: the fit.
            there: the same model, nearer to the shapes.
        """
        # Neither does ERR tell where a plain rod of another E / mu stands for an effect.
        if (
            group.start is not None
            and has_certainly_other_stiffness(bare.model, self.at)
            and has_certainly_other_stiffness(taken_for_plain(self.at.model, group.effect), self.at)
        ):
            return True
        LOG.info("without %s: %.3f mm", group.label, 1e3 * there.mean_err)
        here, without_it, own = self._errs_where_it_acts(self.near, there, group)
        if here > (1.0 - LOWERS) * without_it:
            if self.complete or not _nearer_as_fitted(self.at, bare, group):
                return False
            here, without_it, own = self._errs_where_it_acts(self.at, bare, group)
        if self.exact or (group.start is None and self._lies_beyond(group)):
            return True
        mends = self._mends_a_law(group)
        explained = without_it < OWN * (own if mends else min(own, here))
        needed = self.complete and without_it > OWN * here and not mends
        little = explained or (without_it - here < self.least and not needed)
        return not little or self._bears_a_share(group, bare) or bool(strained(bare, self.at))

    def _lies_beyond(self, group: Proposal) -> bool:
        """Whether numbers of the set-up lie beyond their tolerance.

        Those that have the priors of a set-up are judged only where they do, see `beyond`.
        """
        return all(p.tolerated for p in group.parameters) or is_beyond(self.at, group)

    def _mends_a_law(self, group: Proposal) -> bool:
        """Whether an effect may only mend the law of a number of the set-up beyond tolerance."""
        mends = effects()[group.effect].mends
        return bool(mends) and not mends.isdisjoint(g.effect for g in beyond(self.at))

    def _bears_a_share(self, group: Proposal, bare: Evaluation) -> bool:
        """Whether an added effect is one of several without which much more would be left."""
        if self.complete or group.start is None:
            return False
        return bears_a_share(self.at, bare, self.setup.posterior.evidence)

    def _errs_where_it_acts(
        self, at: Evaluation, bare: Evaluation, group: Proposal
    ) -> tuple[float, float, float]:
        """ERR with and without a cause, and of the measurement alone [m]; of what acts now and
        then, such as a peg that is hit or a yield, in the recording where it takes most.
        """
        if effects()[group.effect].smooth:
            return at.mean_err, bare.mean_err, float(np.mean(self.owns))
        errs = (
            (float(np.mean(a)), float(np.mean(b)), own)
            for a, b, own in zip(at.err, bare.err, self.owns, strict=True)
        )
        return max(errs, key=lambda e: e[1] - e[0])


def _nearer_as_fitted(at: Evaluation, bare: Evaluation, group: Proposal) -> bool:
    """Whether a model lies nearer to the shapes than one without an effect, by more than chance.

    With wrong values of the rest, other laws may come as near to a few shapes at the cost of their
    likelihood. Numbers of the set-up do so for what is missing: of these it tells nothing.
    """
    if group.start is None:
        return False
    return at.mean_err < (1.0 - LOWERS) * bare.mean_err and tells_apart(at, bare)
