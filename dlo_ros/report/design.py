# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The report of a design: the manipulations by their expected information, with reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dlo_ros.report.elements import figure, markup, number, paragraph, table
from dlo_ros.report.page import Section, page, write_page
from dlo_ros.spline import FloatArray

CLASSES = ("observed", "predicted", "initial")  # curves of a softer, the given and a stiffer DLO
PANEL = 260.0  # px of a panel's larger side


@dataclass(frozen=True)
class Panel:
    """One instant.

    Args:
        time: [s].
        curves: x, z [m] of a softer, the given and a stiffer DLO, shape (m, 2) each.
    """

    time: float
    curves: tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True)
class DesignedExperiment:
    """One manipulation.

    Args:
        name: name of the manipulation, for people.
        origin: `given` or `searched`.
        gain: expected information about E and mu [bit].
        std: relative standard deviations of E, mu and E/mu after it; None where it is unknown.
        response: mean displacement for 1 % of E/mu [m].
        reason: the reason for its rank.
        panels: instants to show; may be empty.
    """

    name: str
    origin: str
    gain: float
    std: tuple[float | None, float | None, float | None]
    response: float
    reason: str
    panels: tuple[Panel, ...] = ()


@dataclass(frozen=True)
class DesignReport:
    """The contents of the report; experiments with the best first."""

    headline: str
    experiments: tuple[DesignedExperiment, ...]
    remarks: tuple[str, ...] = ()


def write_design_report(path: Path | str, report: DesignReport) -> None:
    """Write a report as one HTML file that needs nothing else.

    Raises:
        OSError: the file cannot be written.
    """
    write_page(path, design_page(report))


def design_page(report: DesignReport) -> str:
    """The report as an HTML document."""
    summary = f'<p class="headline">{markup(report.headline)}</p>'
    rows = [
        [e.name, e.origin, f"{e.gain:.1f}", f"{1e3 * e.response:.3f} mm", *map(_percent, e.std)]
        for e in report.experiments
    ]
    headers = [
        "manipulation", "origin", "information [bit]", "moves for 1 % of E/mu", "std of E",
        "std of mu", "std of E/mu",
    ]  # fmt: skip
    text = "".join(paragraph(r) for r in report.remarks)
    sections = [Section("Ranking", table(headers, rows) + text)]
    for e in report.experiments:
        body = paragraph(e.reason)
        if e.panels:
            caption = (
                "Solid: half of E/mu; dashed: as given; dotted: twice of it. Curves that lie far "
                "apart determine E/mu."
            )
            body += figure(shapes_picture(e.panels), caption)
        sections.append(Section(e.name, body))
    return page("The most informative manipulation", summary, sections)


def _percent(std: float | None) -> str:
    return "not determined" if std is None else number(100.0 * std, "%", 2)


def shapes_picture(panels: Sequence[Panel]) -> str:
    """Panels side by side at one scale, as SVG."""
    everything = np.concatenate([c for p in panels for c in p.curves])
    low, high = everything.min(axis=0), everything.max(axis=0)
    centre, size = 0.5 * (low + high), 1.1 * max(float((high - low).max()), 1e-6)
    scale = PANEL / size
    height = scale * 1.1 * max(float(high[1] - low[1]), 0.1 * size) + 24.0
    parts = []
    for k, panel in enumerate(panels):
        left = k * (PANEL + 10.0)
        parts.append(
            f'<text class="tick" x="{left + 4:.0f}" y="16" font-size="14">'
            f"t = {panel.time:.2f} s</text>"
        )
        for name, curve in zip(CLASSES, panel.curves, strict=True):
            x = left + 0.5 * PANEL + scale * (curve[:, 0] - centre[0])
            y = 24.0 + 0.5 * (height - 24.0) - scale * (curve[:, 1] - centre[1])
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
            parts.append(f'<polyline class="curve {name}" points="{points}"/>')
    width = len(panels) * (PANEL + 10.0)
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" '
        f'aria-label="shapes of a softer, the given and a stiffer DLO">{"".join(parts)}</svg>'
    )
