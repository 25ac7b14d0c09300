# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A finding: its subject, its level, and the remedy."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

WIDTH = 100
"""Columns of the page."""


class Level(IntEnum):
    """The level of a finding."""

    OK = 0
    WARNING = 1
    WRONG = 2


WORDS = {Level.OK: "ok", Level.WARNING: "warning", Level.WRONG: "WRONG"}
MARGIN = 2 + max(map(len, WORDS.values())) + 2


@dataclass(frozen=True)
class Finding:
    """One line of the page.

    Args:
        level: level of the finding.
        text: observation in a sentence.
        remedy: advice on what to do about it; empty where nothing is to be done.
    """

    level: Level
    text: str
    remedy: str = ""


def ok(text: str) -> Finding:
    """All is well."""
    return Finding(Level.OK, text)


def warning(text: str, remedy: str = "") -> Finding:
    """It works, maybe not as intended."""
    return Finding(Level.WARNING, text, remedy)


def wrong(text: str, remedy: str) -> Finding:
    """It does not work; the remedy says how it would."""
    return Finding(Level.WRONG, text, remedy)


def worst(findings: Iterable[Finding]) -> Level:
    """The worst level among findings; OK where there are none."""
    return max((f.level for f in findings), default=Level.OK)


def page(title: str, sections: Mapping[str, Sequence[Finding]]) -> str:
    """The findings as text, a section each, and how many are bad.

    Args:
        title: first line.
        sections: findings by the section's name; a section without any is left out.
    """
    lines = [title]
    for name, findings in sections.items():
        if findings:
            lines += ["", name]
        for finding in findings:
            lines += _wrapped(f"  {WORDS[finding.level]:<{MARGIN - 2}}", finding.text)
            if finding.remedy:
                lines += _wrapped(" " * MARGIN + "-> ", finding.remedy)
    return "\n".join([*lines, "", _summary([f for s in sections.values() for f in s])])


def _wrapped(start: str, text: str) -> list[str]:
    words = " ".join(text.split())
    return textwrap.wrap(
        words, WIDTH, initial_indent=start, subsequent_indent=" " * len(start),
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def _summary(findings: Sequence[Finding]) -> str:
    count = {level: sum(f.level == level for f in findings) for level in Level}
    bad, doubtful = count[Level.WRONG], count[Level.WARNING]
    warnings = f", {doubtful} warning{'s' * (doubtful != 1)}" if doubtful else ""
    if not bad:
        return f"nothing is wrong{warnings}"
    return f"{bad} {'thing is' if bad == 1 else 'things are'} wrong{warnings}"
