# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Calibration patterns: their squares, and the coordinates of their corners.

A pattern has a frame of its own: origin at its centre, x along its columns, y along its rows (to
the right and down where it is read like a page), so that its z axis points away from the reader.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import InputError
from dlo_ros.spline import FloatArray

SYNTAX = (
    "chessboard:COLSxROWS:SQUARE such as chessboard:9x6:0.025, or "
    "charuco:COLSxROWS:SQUARE:MARKER:DICT such as charuco:9x6:0.025:0.018:4X4_50"
)
LEAST_SIDE, MOST_SIDE = 1e-4, 10.0  # [m] of a square; millimetres given by mistake are refused
MOST_CORNERS = 100  # along a side
LEAST_MARKER, MOST_MARKER = 0.3, 0.95  # of the square's side


@dataclass(frozen=True)
class Pattern:
    """A chessboard, named by its inner corners.

    Args:
        columns, rows: inner corners (where four squares meet) along x and along y.
        square: side of a square [m].
    """

    columns: int
    rows: int
    square: float

    @cached_property
    def points(self) -> FloatArray:
        """Inner corners in the pattern's frame [m], row by row, shape (columns * rows, 3)."""
        j, i = np.mgrid[: self.rows, : self.columns]
        x = (i - 0.5 * (self.columns - 1)) * self.square
        y = (j - 0.5 * (self.rows - 1)) * self.square
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of all its squares [m]."""
        return (self.columns + 1) * self.square, (self.rows + 1) * self.square

    @property
    def text(self) -> str:
        """The pattern as `parse_pattern` reads it."""
        return f"chessboard:{self.columns}x{self.rows}:{self.square:g}"

    @property
    def kind(self) -> str:
        """The kind of pattern in words."""
        return f"chessboard of {self.columns} x {self.rows} inner corners"


@dataclass(frozen=True)
class Charuco(Pattern):
    """A chessboard with an ArUco marker in each white square; parts of it suffice.

    The square at the top left is black. `old_layout` is that of OpenCV before 4.6, which has a
    white one there where the number of squares along y is even.

    Args:
        marker: side of a marker [m].
        dictionary: name of the markers' dictionary without DICT_, such as 4X4_50.
    """

    marker: float
    dictionary: str
    old_layout: bool = False

    @property
    def text(self) -> str:
        """The pattern as `parse_pattern` reads it."""
        grid = f"{self.columns}x{self.rows}"
        end = ":old" if self.old_layout and self.rows % 2 == 1 else ""  # else they are the same
        return f"charuco:{grid}:{self.square:g}:{self.marker:g}:{self.dictionary}{end}"

    @property
    def kind(self) -> str:
        """The kind of pattern in words."""
        return f"ChArUco board of {self.columns} x {self.rows} inner corners ({self.dictionary})"

    @cached_property
    def markers(self) -> FloatArray:
        """Corners of marker k = 0, 1, ... in the pattern's frame [m], shape (m, 4, 2).

        Clockwise from the marker's own top left, as OpenCV finds them.
        """
        white = 1 if not self.old_layout or self.rows % 2 == 0 else 0
        squares = [
            (i, j)
            for j in range(self.rows + 1)
            for i in range(self.columns + 1)
            if (i + j) % 2 == white
        ]
        width, height = self.size
        centres = (np.array(squares) + 0.5) * self.square - 0.5 * np.array([width, height])
        half = 0.5 * self.marker * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return np.asarray(centres[:, None, :] + half)

    def bits(self, marker: int) -> NDArray[np.bool_]:
        """Cells of one marker, True where it is white, its black frame included, shape (k, k)."""
        cells = marker_dictionary(self.dictionary).markerSize + 2
        aruco: Any = cv2.aruco
        draw = (
            aruco.generateImageMarker if hasattr(aruco, "generateImageMarker") else aruco.drawMarker
        )
        return np.asarray(draw(marker_dictionary(self.dictionary), marker, cells) > 0)


def parse_pattern(text: str) -> Pattern:
    """The pattern that a command line names.

    Args:
        text: see `SYNTAX`; COLS and ROWS count inner corners, lengths are in metres.

    Raises:
        InputError: it is malformed; the message says what would be right.
    """
    kind, *fields = text.strip().split(":")
    if kind not in ("chessboard", "charuco"):
        raise InputError(f"--pattern '{text}': no such kind; give {SYNTAX}")
    old = kind == "charuco" and fields[-1:] == ["old"]
    fields = fields[:-1] if old else fields
    wanted = 2 if kind == "chessboard" else 4
    if len(fields) != wanted:
        raise InputError(
            f"--pattern '{text}': {len(fields)} fields after '{kind}', {wanted} are needed; "
            f"give {SYNTAX}"
        )
    columns, rows = _grid(text, fields[0])
    square = _length(text, fields[1])
    if kind == "chessboard":
        return Pattern(columns, rows, square)
    marker = _length(text, fields[2])
    if not LEAST_MARKER <= marker / square <= MOST_MARKER:
        raise InputError(
            f"--pattern '{text}': a marker of {marker:g} m in a square of {square:g} m; "
            f"it must be {LEAST_MARKER:g} to {MOST_MARKER:g} times as long"
        )
    name = fields[3].upper().removeprefix("DICT_")
    board = Charuco(columns, rows, square, marker, name, old)
    known = len(marker_dictionary(name).bytesList)
    if len(board.markers) > known:
        raise InputError(
            f"--pattern '{text}': needs {len(board.markers)} markers; {name} has {known}"
        )
    return board


def marker_dictionary(name: str) -> Any:
    """OpenCV's dictionary of ArUco markers.

    Raises:
        InputError: there is none of that name.
    """
    number = getattr(cv2.aruco, f"DICT_{name}", None)
    if number is None:
        known = sorted(n[5:] for n in dir(cv2.aruco) if n.startswith("DICT_"))
        raise InputError(f"--pattern: no marker dictionary '{name}'; known are {', '.join(known)}")
    return cv2.aruco.getPredefinedDictionary(number)


def _grid(text: str, field: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,4})[xX](\d{1,4})", field)
    if found is None:
        raise InputError(f"--pattern '{text}': '{field}' is no grid such as 9x6; give {SYNTAX}")
    columns, rows = int(found[1]), int(found[2])
    if not (min(columns, rows) >= 3 and max(columns, rows) <= MOST_CORNERS):
        raise InputError(
            f"--pattern '{text}': {columns} x {rows} inner corners; 3 to {MOST_CORNERS} along "
            "each side can be used"
        )
    return columns, rows


def _length(text: str, field: str) -> float:
    try:
        value = float(field)
    except ValueError:
        raise InputError(
            f"--pattern '{text}': '{field}' is no length in metres; give {SYNTAX}"
        ) from None
    if not LEAST_SIDE <= value <= MOST_SIDE:
        raise InputError(
            f"--pattern '{text}': a length of {field} m; it is given in metres, "
            f"{LEAST_SIDE:g} to {MOST_SIDE:g}"
        )
    return value
