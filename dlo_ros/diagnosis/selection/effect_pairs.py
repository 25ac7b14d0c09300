# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pairs of effects: first effects beside which a second is searched, and other sizes of pegs."""

from __future__ import annotations

from collections.abc import Sequence

from dlo_ros.diagnosis.fitting.worker_processes import Workers
from dlo_ros.diagnosis.selection import verdict
from dlo_ros.diagnosis.selection.effect_search import Candidate, resized
from dlo_ros.effects.physics.obstacle import Obstacle

BASES = 3
"""Best single effects to which a second one is added."""
FIRST_SHARE = 0.9
"""Root autocovariance over that without the effect, below which an effect may be one of a pair."""


def other_pegs(
    team: Workers, decision: verdict.Decision, known: Sequence[Candidate]
) -> list[Candidate]:
    """The explanation with pegs of other sizes, which show how well its numbers are known."""
    chosen = decision.chosen
    if chosen is None or len(chosen.effects) < 2:
        return []
    model = chosen.candidate.at.model
    if model.without(Obstacle.name).free == model.free:
        return []
    alike = [c for c in known if set(c.at.model.effects) == set(chosen.effects)]
    if any(c.form.startswith("radius") for c in alike):
        return []
    return resized(team, chosen.candidate)


def bases(singles: Sequence[Candidate], before: float) -> list[Candidate]:
    """The best effects, each in the form with the smallest residual, as first effects of pairs."""
    result: dict[str, Candidate] = {}
    for c in singles:
        if c.root_autocovariance < FIRST_SHARE * before:
            known = result.setdefault(c.effect, c)
            if c.root_autocovariance < known.root_autocovariance:
                result[c.effect] = c
    return list(result.values())[:BASES]
