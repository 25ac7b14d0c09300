# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Advice: the experiment that tells most after a diagnosis."""

from __future__ import annotations

from dlo_ros.diagnosis.explain.explanation import Explanation
from dlo_ros.diagnosis.findings.diagnosis_outcome import Verdict
from dlo_ros.diagnosis.findings.rest_change import RestChange
from dlo_ros.effects import added_to_damping, effects
from dlo_ros.identification.identifiability import rounded

SETTLED = (
    "No other cause explains these data as well: nothing has to be recorded to tell causes apart."
)
REPEAT = (
    "Repeat one of the manipulations unchanged: where both recordings differ from each other, the "
    "cause changes with time (a draught, a camera or a material that drifts); where they agree, it "
    "belongs to the DLO and its grips."
)
CHANGED = (
    "In {first} and in {second} the DLO is once held alike, so that its shapes should agree to "
    "{expected}, and yet it rests {distance} apart: it, a grip or the camera changed between them, "
    "as a DLO does that creeps or was bent meanwhile. Nothing that is the same in all recordings "
    "explains that. Let the DLO hang as long before each recording, and record both again."
)
SWING = (
    "Record how the DLO swings after a quick motion, too: these recordings do not determine how a "
    "motion dies out, and the model keeps what the parameter file guesses ({})."
)


def advice(verdict: Verdict, found: Explanation, changed: RestChange | None = None) -> str:
    """The next experiment, in a sentence or two.

    Args:
        changed: recordings between which something changed, where nothing explains all.
    """
    open_ = next((c for c in found.causes if c.rivals), None)
    if open_ is not None:
        known = effects()
        names = " and ".join(known[n].called() for n in (open_.effect, *open_.rivals))
        return (
            f"These data do not separate {names}: record another manipulation, one that turns "
            "the clamp or moves a free end; dlo_ros design --report proposes one."
        )
    if verdict == "adequate":
        return "No error is left to explain."
    if verdict == "explained":
        return SETTLED
    kept, again = _kept_guesses(found), REPEAT if changed is None else _told(changed)
    return f"{SWING.format(' and '.join(kept))} {again}" if kept else again


def _told(changed: RestChange) -> str:
    first, second = changed.names
    expected, distance = (f"{rounded(1e3 * x)} mm" for x in (changed.expected, changed.distance))
    return CHANGED.format(first=first, second=second, expected=expected, distance=distance)


def _kept_guesses(found: Explanation) -> list[str]:
    """Keys of the dampings that were left as they are guessed, see `without_needless`."""
    return [
        f"damping.{name}"
        for effect, (name, _) in added_to_damping().items()
        if effect in found.shifts and name not in found.at.model.names
    ]
