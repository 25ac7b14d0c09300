# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects that begin far from neutral, with a stiffness of their own, beside a neutral set-up.

A mass that outweighs the DLO goes with a Young's modulus that no derivative finds from the plain
model's, and while it is missing, the set-up is strained until it does a part of its work.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

from dlo_ros.diagnosis.explain.candidate_trials import Trial, best_gain
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal, proposal_of, with_proposals
from dlo_ros.effects import Start
from dlo_ros.errors import SimulationError
from dlo_ros.inference.joint import Evaluation, evaluate, simulate
from dlo_ros.inference.joint_fit import settled
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.parameter import ParametricModel

LOG = logging.getLogger(__name__)

FACTORS = (0.3, 1.0, 3.0, 10.0)
"""Multiples of the plain model's Young's modulus with which an effect begins."""
FITTED = 2
"""Beginnings that are fitted, those that come nearest."""


def best_far_start(
    at: Evaluation, meant: ParametricModel, recordings: Sequence[Recording],
    begun: Sequence[Start], plain_err: float,
) -> Trial | None:  # fmt: skip
    """The best fit from far away, if it is worth it.

    Args:
        at: the set-up within its tolerances, fitted, over which it must gain.
        meant: the same with the set-up at neutral, and the plain model's material.
        begun: effects that might be added; those that begin far away are tried.
        plain_err: ERR of the plain model [m], beside the same neutral set-up: what is no nearer
            with the effect is not fitted.
    """
    there: list[tuple[float, ParametricModel, Proposal]] = []
    for start in (s for s in begun if s.afar):
        proposal = proposal_of(meant.settings, start)
        model, _ = with_proposals(meant, [proposal])
        for factor in FACTORS:
            begins = model.stiffened(factor)
            try:
                err = simulate(begins, recordings, ()).mean_err
            except SimulationError as reason:
                LOG.info("%s: %s", proposal.label, reason)
                continue
            if err < plain_err:
                there.append((err, begins, proposal))
    there.sort(key=lambda row: row[0])
    found: list[Trial] = []
    for _, begins, proposal in there[:FITTED]:
        try:
            found.append((settled(evaluate(begins, recordings), recordings), proposal))
        except SimulationError as reason:
            LOG.info("%s: %s", proposal.label, reason)
    return best_gain(found, at, recordings)
