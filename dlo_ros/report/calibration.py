# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The report of a calibration: the camera, its views, what is missing, and where the board is."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from dlo_ros.report.elements import UNKNOWN, figure, markup, number, paragraph, table
from dlo_ros.report.page import Section, page, write_page
from dlo_ros.spline import FloatArray

BAR_HEIGHT, BAR_WIDTH, VALUE_WIDTH = 18, 340, 110
LETTER = 7  # about the width of a letter of the bars' names
LONGEST_NAME = 26


@dataclass(frozen=True, eq=False)
class CalibrationView:
    """One picture of the pattern.

    Args:
        name: name of the picture.
        used: whether the camera rests on it.
        reason: the reason why the pattern was not found.
        error: root mean square reprojection error [px]; NaN where there is none.
        distance: distance of the pattern from the camera [m]; NaN where it is not known.
        tilt: tilt of the pattern against the line of sight [deg]; NaN where it is not known.
        pixels: the pattern's corners [px], shape (n, 2); may be empty.
        dropped: number of corners left out.
    """

    name: str
    used: bool
    reason: str
    error: float
    distance: float
    tilt: float
    pixels: FloatArray
    dropped: int = 0


@dataclass(frozen=True)
class BoardPicture:
    """The board as the camera sees it.

    Args:
        jpeg: the picture with the board frame drawn in.
        rows: results, each as name and value.
        hints: advice on what to be careful about.
    """

    jpeg: bytes
    rows: tuple[tuple[str, str], ...]
    hints: tuple[str, ...] = ()


@dataclass(frozen=True)
class CalibrationReport:
    """The contents of the report.

    Args:
        headline: the result in one line.
        width, height: size of the images [px].
        rows: the camera's numbers, names and values.
        views: views in the order of the input; may be empty.
        lenses: model, its error in cross-validation [px], and what was decided; may be empty.
        hints: advice: which views are missing, and what to be careful about.
        board: None where it was not asked for.
    """

    headline: str
    width: int
    height: int
    rows: tuple[tuple[str, str], ...]
    views: tuple[CalibrationView, ...] = ()
    lenses: tuple[tuple[str, float, str], ...] = ()
    hints: tuple[str, ...] = ()
    board: BoardPicture | None = None


def write_calibration_report(path: Path | str, report: CalibrationReport) -> None:
    """Write a report as one HTML file that needs nothing else.

    Raises:
        OSError: the file cannot be written.
    """
    write_page(path, calibration_page(report))


def calibration_page(report: CalibrationReport) -> str:
    """The report as an HTML document."""
    sections = [Section("The camera", table(["quantity", "value"], report.rows))]
    if report.hints:
        sections.append(Section("What would help", _list(report.hints)))
    if any(len(v.pixels) for v in report.views):
        sections.append(Section("Where the pattern was seen", _coverage(report)))
    if report.views:
        sections.append(Section("Views", _errors(report.views) + _views(report.views)))
    if report.lenses:
        sections.append(Section("Lens model", _lenses(report)))
    if report.board is not None:
        sections.append(Section("The board", _board(report.board)))
    summary = f'<p class="headline">{markup(report.headline)}</p>'
    return page("Camera calibration", summary, sections)


def _list(lines: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{markup(line)}</li>' for line in lines)}</ul>"


def _coverage(report: CalibrationReport) -> str:
    """The image's area with all corners in it."""
    width, height = report.width, report.height
    radius = width / 260.0
    dots = []
    for used, colour in ((True, "observed"), (False, "predicted")):
        circles = "".join(
            f'<circle cx="{x + 0.5:.1f}" cy="{y + 0.5:.1f}" r="{radius:.2f}"/>'
            for view in report.views
            if view.used is used
            for x, y in view.pixels
        )
        dots.append(f'<g style="fill:var(--{colour});fill-opacity:.6">{circles}</g>')
    lines = "".join(
        f'<path d="M{width * k / 4:.1f} 0V{height}M0 {height * k / 4:.1f}H{width}"/>'
        for k in range(1, 4)
    )
    svg = (
        f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="corners in the image">'
        f'<rect width="{width}" height="{height}" style="fill:var(--raised)"/>'
        f'<g style="stroke:var(--grid);stroke-width:{width / 800:.2f}">{lines}</g>'
        f"{''.join(dots)}"
        f'<rect width="{width}" height="{height}" style="fill:none;stroke:var(--quiet);'
        f'stroke-width:{width / 400:.2f}"/></svg>'
    )
    return figure(
        svg,
        "Each dot is a corner of the pattern in the image; blue: used, orange: in a view that was "
        "left out. Where there are none, the lens's distortion is only extrapolated.",
    )


def _errors(views: Sequence[CalibrationView]) -> str:
    """A bar for each view's reprojection error."""
    shown = [v for v in views if math.isfinite(v.error)]
    if not shown:
        return ""
    used = [v.error for v in shown if v.used]
    # Outliers would squeeze what matters.
    longest = max(max(used, default=0.0) * 2.0, 1e-6) if used else max(v.error for v in shown)
    start = LETTER * max(len(_short(v.name)) for v in shown) + 8
    bars = []
    for k, view in enumerate(shown):
        y = k * BAR_HEIGHT
        length = BAR_WIDTH * min(view.error / longest, 1.0)
        colour = "observed" if view.used else "predicted"
        bars.append(
            f'<text x="{start - 6}" y="{y + 13}" text-anchor="end">'
            f"{escape(_short(view.name))}</text>"
            f'<rect x="{start}" y="{y + 3}" width="{length:.1f}" height="{BAR_HEIGHT - 6}" '
            f'style="fill:var(--{colour})"/>'
            f'<text x="{start + length + 6:.1f}" y="{y + 13}">{view.error:.3f}'
            f"{'' if view.used else ' left out'}</text>"
        )
    size = f"{start + BAR_WIDTH + VALUE_WIDTH} {len(shown) * BAR_HEIGHT + 4}"
    svg = (
        f'<svg viewBox="0 0 {size}" role="img" aria-label="reprojection error of each view">'
        f'<g style="fill:var(--ink);font-size:11px">{"".join(bars)}</g></svg>'
    )
    return figure(
        svg,
        "Reprojection error [px] of each view: root mean square distance of its corners from where "
        "the calibrated camera would see them. Orange: left out; a view that does not fit the "
        "others shows a pattern that moved or is bent, or comes from another camera or zoom.",
    )


def _views(views: Sequence[CalibrationView]) -> str:
    rows = []
    for view in views:
        remark = view.reason
        if view.dropped and not remark:
            remark = f"{view.dropped} of its corners left out"
        rows.append(
            (
                view.name,
                "yes" if view.used else "no",
                f"{view.error:.3f} px" if math.isfinite(view.error) else UNKNOWN,
                number(view.distance, "m"),
                f"{view.tilt:.0f} deg" if math.isfinite(view.tilt) else UNKNOWN,
                remark,
            )
        )
    return table(["view", "used", "error", "distance", "tilt", "remark"], rows)


def _lenses(report: CalibrationReport) -> str:
    rows = [(name, number(error, "px", 4), verdict) for name, error, verdict in report.lenses]
    text = (
        "Each model was fitted to a part of the views and asked to predict the others. The one "
        "with fewest coefficients is taken whose prediction is not worse than the best by more "
        "than the uncertainty of that comparison."
    )
    return table(["distortion", "error in prediction", ""], rows) + paragraph(text)


def _board(board: BoardPicture) -> str:
    data = base64.b64encode(board.jpeg).decode("ascii")
    picture = (
        f'<img alt="the board with its frame" style="max-width:100%" '
        f'src="data:image/jpeg;base64,{data}">'
    )
    caption = (
        "The board frame as the camera sees it: x (red) to the right along the board, z (blue) "
        "up, y away from the camera; the green ring is the pattern's centre. If up is not up, "
        "give --up."
    )
    hints = _list(board.hints) if board.hints else ""
    return table(["quantity", "value"], board.rows) + hints + figure(picture, caption)


def _short(name: str) -> str:
    if len(name) <= LONGEST_NAME:
        return name
    return f"\N{HORIZONTAL ELLIPSIS}{name[1 - LONGEST_NAME :]}"
