# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Remarks of the report beside the verdict, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from dlo_ros.diagnosis.fitting.initial_fit import Beginning
from dlo_ros.diagnosis.residuals import residual_autocovariance
from dlo_ros.diagnosis.selection.effect_search import Candidate
from dlo_ros.diagnosis.selection.verdict import Decision

SHOWN_SUSPECTS = 5
"""Suspects that a remark tells."""


def remarks(
    plain: Candidate, best: Candidate, suspects: Sequence[Candidate], decision: Decision
) -> tuple[str, ...]:
    """Further remarks for the reader.

    Args:
        plain, best: the model without and with what is named.
        suspects: models that come nearest where nothing explains the data, best first.
    """
    said = []
    if decision.chosen is not None:
        rods = best.at.model.settings.rod, plain.at.model.settings.rod
        change = rods[1].specific_modulus / rods[0].specific_modulus - 1.0
        said.append(
            f"Without the named causes E/mu would be {abs(100.0 * change):.2g} % too "
            f"{'large' if change > 0.0 else 'small'}: the stiffness had absorbed that much of them."
        )
        border = best.at.model.at_border()
        if border:
            said.append(f"At the border of the range that is searched: {', '.join(border)}.")
        known = {*decision.chosen.effects, *plain.at.model.effects}
        beside = [n.replace("_", " ") for n in best.at.model.effects if n not in known]
        if beside:
            said.append(
                f"The extended model also contains {' and '.join(beside)}: it predicts best with "
                "that, but other causes may take its place."
            )
    if decision.verdict == "unexplained":
        shown = suspects[0] if suspects else best
        said.append(_nearest(plain, suspects))
        said.append(residual_autocovariance.description(shown.at))
    return tuple(said)


def left_out(beginning: Beginning) -> tuple[str, ...]:
    """Sentence on the pictures that were not used."""
    return tuple(
        f"{r.name}: {number} of {number + len(r.times)} pictures {'is' if number == 1 else 'are'} "
        "left out as outliers: the observed shape is grossly wrong there."
        for r, number in zip(beginning.recordings, beginning.left_out, strict=False)
        if number
    )


def _nearest(plain: Candidate, suspects: Sequence[Candidate]) -> str:
    """The effects that come nearest to data which no effect explains."""
    lines = [
        f"{' and '.join(c.at.model.effects)}, which leaves "
        f"{c.root_autocovariance:.2g} times the noise"
        for c in suspects[:SHOWN_SUSPECTS]
    ]
    text = "No effect in the library brings the residual down to the noise."
    if not lines:
        return text
    share = max(0.0, 1.0 - (suspects[0].root_autocovariance / plain.root_autocovariance) ** 2)
    text += (
        f" The nearest one is {lines[0]} and removes {100.0 * share:.0f} % of the residual's "
        "variance; it is a suspect, no finding."
    )
    if lines[1:]:
        text += f" Not excluded beside it: {'; '.join(lines[1:])}."
    return text
