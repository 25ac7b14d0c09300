"""The experiment that would settle what is still open, in a sentence."""

from __future__ import annotations

from collections.abc import Sequence

from dlo_ros.diagnosis.decide import Decision
from dlo_ros.diagnosis.measured import Recording
from dlo_ros.diagnosis.search import Candidate
from dlo_ros.parameters import Settings


def advise(
    decision: Decision, singles: Sequence[Candidate], pairs: Sequence[Candidate],
    recordings: Sequence[Recording], given: Settings,
) -> str:  # fmt: skip
    """What to do next."""
    if decision.verdict == "adequate":
        return "Nothing is left to explain; the model can be used as it is."
    if decision.verdict == "unexplained":
        return "Repeat one manipulation twice."
    return "Nothing is left open."
