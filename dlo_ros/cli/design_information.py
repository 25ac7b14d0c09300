# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Manipulations by their expected information about E and mu."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.cli.design_purpose import Presentation, PresentedExperiment, panels
from dlo_ros.cli.results import QUANTITIES
from dlo_ros.identification.design.design_reason import length_over_scale, reason
from dlo_ros.identification.design.expected_information import Noise, Outlook, Plan, outlook
from dlo_ros.identification.identifiability import rounded
from dlo_ros.parameters import Settings
from dlo_ros.report.elements import number
from dlo_ros.spline import FloatArray

FACTORS = (0.5, 1.0, 2.0)
"""Factors of E/mu in the report's pictures."""
KNOWN_STD = 0.5
"""Relative standard deviation above which a number is no knowledge."""


@dataclass(frozen=True)
class Information:
    """The purpose to determine E and mu.

    Args:
        settings: settings of the rod.
        noise: measurement noise of the observer.
        known: see `expected_information.outlook`.
    """

    settings: Settings
    noise: Noise
    known: FloatArray | None

    what = "the most informative manipulation for E and mu"
    finalists = 1

    def judge(self, plan: Plan, spans: int | None) -> Outlook:
        """See `Purpose`."""
        return outlook(plan, self.settings, self.noise, known=self.known, spans=spans)

    def presented(self, ranking: Sequence[Outlook]) -> Presentation:
        """See `Purpose`."""
        best, weakest = ranking[0], ranking[-1]
        shown = tuple(self._experiment(o, weakest) for o in ranking)
        width = max(len(e.name) for e in shown)
        lines = ["Expected information of each experiment, the largest first:"]
        for o in ranking:
            std = _determined(o)[-1]
            words = "nothing of E/mu" if std is None else f"E/mu to {rounded(100 * std)} %"
            lines.append(f"  {o.plan.name:<{width}}  {words} (information {o.gain:.1f} bit)")
        ratio = length_over_scale(self.settings)
        general = (
            f"The DLO is {rounded(ratio)} times as long as l = (B/w)^(1/3), over which its weight "
            "bends it. Standard deviations hold for E as given; information is averaged over "
            "half, the given and twice the given E/mu, without changes of shape that a slightly "
            "tilted board or a slight bend at rest would cause as well."
        )
        return Presentation(
            shown, f"{best.plan.name}: {shown[0].reason}", tuple(lines),
            "The most informative manipulation",
            ("information [bit]", "moves for 1 % of E/mu", "std of E", "std of mu", "std of E/mu"),
            "Solid: half of E/mu; dashed: as given; dotted: twice of it. Curves that lie far "
            "apart determine E/mu.",
            (general,), {"length_over_scale": ratio},
        )  # fmt: skip

    def _experiment(self, o: Outlook, weakest: Outlook) -> PresentedExperiment:
        std = _determined(o)
        rod = self.settings.rod
        numbers = {
            "information": o.gain,
            "std": {name: s for (name, _, _), s in zip(QUANTITIES, std, strict=True)},
            "response": o.response,
        }
        cells = (f"{o.gain:.1f}", f"{10.0 * o.response * rod.length:.3f} mm", *map(_percent, std))
        sets = [self.settings.with_material(f * rod.young_modulus, rod.density) for f in FACTORS]
        return PresentedExperiment(
            o.plan.name, numbers, cells, reason(o, weakest, self.settings), panels(o.plan, sets)
        )


def _percent(std: float | None) -> str:
    return "not determined" if std is None else number(100.0 * std, "%", 2)


def _determined(o: Outlook) -> tuple[float | None, float | None, float | None]:
    # E and mu that only a guess fixes are not determined by the manipulation.
    # By eigenvalues: what is known very well and not at all stands side by side in it.
    known, modes = np.linalg.eigh(0.5 * (o.information + o.information.T))
    free = (modes**2 / (np.maximum(known, 0.0) + 1e-6)).sum(axis=1)
    alone = (math.sqrt(free[0]), math.sqrt(free[1]), 0.0)
    values = (o.std[name] for name, _, _ in QUANTITIES)
    young, density, ratio = (
        v if v < KNOWN_STD and a < 10.0 else None for v, a in zip(values, alone, strict=True)
    )
    return young, density, ratio
