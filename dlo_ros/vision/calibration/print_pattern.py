# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A calibration pattern as a file to print at true scale: PDF, SVG or PNG."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dlo_ros.errors import InputError
from dlo_ros.files import write_bytes
from dlo_ros.vision.calibration.patterns import Charuco, Pattern

SUFFIXES = (".pdf", ".png", ".svg")
INCH = 0.0254  # [m]
RESOLUTION = 300  # dots per inch of a PNG
MOST_PIXELS = 120_000_000
PAPER = {
    "A4": (0.297, 0.210),
    "A3": (0.420, 0.297),
    "A2": (0.594, 0.420),
    "A1": (0.841, 0.594),
    "A0": (1.189, 0.841),
}
EDGE = 0.005  # [m] that printers leave white
QUIET = 0.5  # of a square: white around the pattern, by which it is found
BAR = 0.1  # [m] of the line to measure
TOLERANCE = 1e-6  # [m], of sums of lengths


def print_pattern(pattern: Pattern, path: Path) -> str:
    """Write the pattern for printing, on the smallest sheet of paper that has room for it.

    Args:
        pattern: the pattern to draw.
        path: path of the file; its suffix chooses PDF, SVG or PNG (which carries its resolution).

    Returns:
        The paper's name, or its size.

    Raises:
        InputError: another suffix, or it cannot be written.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: cannot be drawn; give a name that ends in {', '.join(SUFFIXES)}")
    width, height = pattern.size
    room = 2.0 * max(EDGE, QUIET * pattern.square)
    sheet = next(
        (s for s in PAPER.items() if _has_room(s[1], width + room, height + room)),
        next(
            (
                (name, size[::-1])
                for name, size in PAPER.items()
                if _has_room(size[::-1], width + room, height + room)
            ),
            ("", (width + room + 0.02, height + room + 0.03)),
        ),
    )
    name, (paper_width, paper_height) = sheet
    resolution = min(RESOLUTION, int(np.sqrt(MOST_PIXELS * INCH**2 / (paper_width * paper_height))))
    figure = Figure(figsize=(paper_width / INCH, paper_height / INCH), facecolor="white")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(-0.5 * paper_width, 0.5 * paper_width)
    axes.set_ylim(0.5 * paper_height, -0.5 * paper_height)
    axes.add_collection(
        PatchCollection(
            [Rectangle((x, y), w, h) for x, y, w, h in dark_rectangles(pattern)],
            facecolor="black",
            edgecolor="none",
            antialiased=False,  # else a hairline shows between neighbours
        )
    )
    below = 0.5 * height + 0.5 * pattern.square
    if below + 0.004 < 0.5 * paper_height - EDGE:
        long = min(BAR, width)
        axes.plot([-0.5 * width, long - 0.5 * width], [below, below], color="black", linewidth=0.8)
        axes.text(
            long - 0.5 * width + 0.004,
            below,
            f"{1e3 * long:g} mm: print at 100 % and measure    --pattern {pattern.text}",
            fontsize=8,
            verticalalignment="center",
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # No date, so that the same pattern gives the same file.
        with rc_context({"svg.hashsalt": "dlo_ros"}):
            buffer = io.BytesIO()
            figure.savefig(
                buffer, format=path.suffix[1:].lower(), dpi=resolution, metadata=_metadata(path)
            )
        write_bytes(path, buffer.getvalue())
    except OSError as err:
        raise InputError(f"{path}: cannot be written ({err.strerror})") from err
    return name or f"{1e3 * paper_width:.0f} x {1e3 * paper_height:.0f} mm"


def dark_rectangles(pattern: Pattern) -> list[tuple[float, float, float, float]]:
    """The black rectangles: left, top, width and height in the pattern's frame [m]."""
    width, height = pattern.size
    side = pattern.square
    first = 0
    if isinstance(pattern, Charuco) and pattern.old_layout and pattern.rows % 2 == 1:
        first = 1
    squares = [
        (i * side - 0.5 * width, j * side - 0.5 * height, side, side)
        for j in range(pattern.rows + 1)
        for i in range(pattern.columns + 1)
        if (i + j) % 2 == first
    ]
    if isinstance(pattern, Charuco):
        for number, corners in enumerate(pattern.markers):
            bits = pattern.bits(number)
            cell = pattern.marker / len(bits)
            squares += [
                (corners[0, 0] + i * cell, corners[0, 1] + j * cell, cell, cell)
                for j, i in zip(*np.nonzero(~bits), strict=True)
            ]
    return squares


def _metadata(path: Path) -> dict[str, None]:
    return {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(path.suffix.lower()[1:], {})


def _has_room(paper: tuple[float, float], width: float, height: float) -> bool:
    return width <= paper[0] + TOLERANCE and height <= paper[1] + TOLERANCE
