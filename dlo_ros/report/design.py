# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The report of a design: the manipulations by what they are worth, with reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dlo_ros.report.elements import figure, markup, paragraph, table
from dlo_ros.report.page import Section, page, write_page
from dlo_ros.spline import FloatArray

CLASSES = ("observed", "predicted", "initial")  # curves of a panel: solid, dashed, dotted
PANEL = 260.0  # px of a panel's larger side


@dataclass(frozen=True)
class Panel:
    """One instant.

    Args:
        time: [s].
        curves: x, z [m] of up to three shapes of the DLO, shape (m, 2) each.
    """

    time: float
    curves: tuple[FloatArray, ...]


@dataclass(frozen=True)
class DesignedExperiment:
    """One manipulation.

    Args:
        name: name of the manipulation, for people.
        origin: `given` or `searched`.
        cells: numbers of the ranking, one for each header of the report.
        reason: the reason for its rank.
        panels: instants to show; may be empty.
    """

    name: str
    origin: str
    cells: tuple[str, ...]
    reason: str
    panels: tuple[Panel, ...] = ()


@dataclass(frozen=True)
class DesignReport:
    """The contents of the report.

    Args:
        title: title of the page.
        headline: the result in a sentence.
        headers: headers of the ranking, after those of name and origin.
        experiments: manipulations, the best first.
        caption: caption of the panels.
        remarks: sentences for the reader.
    """

    title: str
    headline: str
    headers: tuple[str, ...]
    experiments: tuple[DesignedExperiment, ...]
    caption: str
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
    rows = [[e.name, e.origin, *e.cells] for e in report.experiments]
    text = "".join(paragraph(r) for r in report.remarks)
    headers = ["manipulation", "origin", *report.headers]
    sections = [Section("Ranking", table(headers, rows) + text)]
    for e in report.experiments:
        body = paragraph(e.reason)
        if e.panels:
            body += figure(shapes_picture(e.panels), report.caption)
        sections.append(Section(e.name, body))
    return page(report.title, summary, sections)


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
        for name, curve in zip(CLASSES, panel.curves, strict=False):
            x = left + 0.5 * PANEL + scale * (curve[:, 0] - centre[0])
            y = 24.0 + 0.5 * (height - 24.0) - scale * (curve[:, 1] - centre[1])
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
            parts.append(f'<polyline class="curve {name}" points="{points}"/>')
    width = len(panels) * (PANEL + 10.0)
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" '
        f'aria-label="shapes of the DLO">{"".join(parts)}</svg>'
    )
