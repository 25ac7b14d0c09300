# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The experiment that would settle what is still open, in a sentence."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.diagnosis.findings.standard_manipulations import Standard, simulated, standard
from dlo_ros.diagnosis.fitting.evaluation import evaluate
from dlo_ros.diagnosis.fitting.levenberg_marquardt import Normal, normal, total
from dlo_ros.diagnosis.selection.effect_search import Candidate
from dlo_ros.diagnosis.selection.verdict import Decision
from dlo_ros.effects import effects
from dlo_ros.errors import DloError
from dlo_ros.identification.identifiability import rounded
from dlo_ros.inference.measured import Recording, measured
from dlo_ros.parameters import Settings

LOG = logging.getLogger(__name__)

CLEAR = 3.0
"""Distance of two predictions in units of the noise, root of the sum, that settles the question."""
SETTLED = "No question is left open: no other cause explains these data as well."
REPEAT = (
    "Repeat one of the manipulations unchanged: where both recordings differ from each other, the "
    "cause changes with time (a draught, a camera or a material that drifts); where they agree, it "
    "belongs to the DLO and its grips."
)


@dataclass(frozen=True)
class Separation:
    """How far two explanations are apart in a manipulation, in standard deviations."""

    words: str
    deviations: float


def advise(
    decision: Decision,
    candidates: Sequence[Candidate],
    recordings: Sequence[Recording],
    given: Settings,
) -> str:
    """The next experiment, in a sentence."""
    if decision.verdict == "adequate":
        return "No error is left to explain: these data need no further cause."
    names = [n for rivals in decision.rivals for n in rivals]
    if decision.chosen is None or (decision.verdict == "unexplained" and not names):
        return REPEAT
    if not names:
        return SETTLED
    best = decision.chosen.candidate
    rival = next(
        (c for c in candidates if c is not best and names[0] in c.at.model.effects
         and len(c.at.model.effects) <= len(best.at.model.effects)), None,
    )  # fmt: skip
    found = separations(best, rival, recordings, given) if rival is not None else []
    if not found or found[0].deviations < CLEAR:
        return (
            f"No standard manipulation separates {_words(decision.chosen.effects[0])} from "
            f"{_words(names[0])}: it makes no difference which is named until one of them is "
            "measured by itself."
        )
    first = found[0]
    causes = ", ".join(_words(n) for n in (*decision.chosen.effects, *dict.fromkeys(names)))
    return (
        f"To separate {causes}: {first.words}; there the predictions differ by "
        f"{rounded(first.deviations)} times the measurement's noise."
    )


def _words(name: str) -> str:
    known = effects().get(name)
    return known.called() if known else name.replace("_", " ")


def separations(
    a: Candidate, b: Candidate, recordings: Sequence[Recording], given: Settings
) -> list[Separation]:
    """Standard manipulations, the most telling first.

    What b predicts is compared with what a predicts after b has used the freedom that the present
    data leave it.
    """
    level = float(np.mean([np.sqrt(np.mean(r.noise**2)) for r in recordings]))
    present = total(b.at, given)
    found = []
    for made in standard(given, recordings):
        try:
            found.append(Separation(made.words, _apart(made, a, b, level, present, given)))
        except DloError as err:
            LOG.info("%s: %s", made.words, err)
    return sorted(found, key=lambda s: -s.deviations)


def _apart(
    made: Standard, a: Candidate, b: Candidate, level: float, present: Normal, given: Settings
) -> float:
    plain = replace(given, simulation=replace(given.simulation, start="equilibrium"))
    settings = replace(a.at.model.settings, simulation=plain.simulation)
    recording = measured(simulated(made, settings), settings)
    recording = replace(recording, noise=np.full(len(recording.noise), level))
    other = replace(b.at.model, settings=replace(b.at.model.settings, simulation=plain.simulation))
    at = evaluate(other, [recording], given)
    assert at.jacobians is not None
    new = normal(at.residuals[0], at.jacobians[0])
    # The present fit is at its minimum: only its curvature counts.
    _, left = (new + Normal(present.hessian, 0.0 * present.gradient, 0.0)).minimum()
    return float(np.sqrt(max(left, 0.0)))
