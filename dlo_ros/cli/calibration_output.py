# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The output of `calibrate`: files, report and terminal."""

from __future__ import annotations

import io
import logging
import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dlo_ros.files import write_text
from dlo_ros.recordings.images import Image
from dlo_ros.report.calibration import (
    BoardPicture,
    CalibrationReport,
    CalibrationView,
    write_calibration_report,
)
from dlo_ros.report.elements import measured, number
from dlo_ros.vision.calibration.board_pose import BoardPose, draw_board
from dlo_ros.vision.calibration.camera_calibration import Calibration, ViewResult
from dlo_ros.vision.calibration.camera_file import board_file, camera_file
from dlo_ros.vision.calibration.camera_fit import Intrinsics
from dlo_ros.vision.calibration.patterns import Pattern
from dlo_ros.vision.calibration.view_collection import Skipped

LOG = logging.getLogger(__name__)

WIDTH = 120  # of the table where there is no terminal
PICTURE = 1280  # [px] larger side of the board's picture in the report
FAILURES_SHOWN = 8
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def write_results(
    output: Path,
    camera_name: str,
    pattern: Pattern,
    found: Calibration,
    skipped: Sequence[Skipped],
    board: BoardPose | None,
    picture: Image | None,
) -> list[str]:
    """Write camera_info.yaml, board.yaml and report.html into a folder; returns their names.

    Args:
        output: the folder.
        camera_name: the camera's name, as its driver knows it.
        pattern: the calibration pattern in the views.
        found: the camera.
        skipped: pictures that gave no view.
        board: the board's pose, None where it was not asked for.
        picture: the picture of the board.

    Raises:
        OSError: the folder cannot be written.
    """
    names = ["camera_info.yaml", "report.html"]
    comment = f"Written by dlo_ros calibrate, pattern {pattern.text}."
    if found.std is not None:
        comment += f"\nReprojection error {found.rms:.3f} px over {len(found.used)} views."
        comment += "\nStandard deviations of fx, fy, cx, cy [px]: "
        comment += ", ".join(f"{s:.2g}" for s in found.std)
    text = camera_file(found.intrinsics, camera_name, comment)
    write_text(output / "camera_info.yaml", text)
    shown = None
    if board is not None and picture is not None:
        names.insert(1, "board.yaml")
        where = "Pose of the frame board in the camera's optical frame, found by dlo_ros calibrate."
        use = "Copy the block into the parameter file, or give a node both files."
        write_text(output / "board.yaml", board_file(board, f"{where}\n{use}"))
        shown = _board_picture(board, picture, pattern, found.intrinsics)
    elif (output / "board.yaml").exists():
        LOG.warning("%s: is left as it was; no --board was given", output / "board.yaml")
    report = CalibrationReport(
        headline=_headline(found, board),
        width=found.intrinsics.width,
        height=found.intrinsics.height,
        rows=tuple(_rows(found)),
        views=tuple(_report_views(found, skipped)),
        lenses=tuple(_lens_rows(found)),
        hints=found.hints,
        board=shown,
    )
    write_calibration_report(output / "report.html", report)
    return names


def _headline(found: Calibration, board: BoardPose | None) -> str:
    k = found.intrinsics.matrix
    parts = []
    if found.std is not None:
        fx, fy = (measured(float(k[i, i]), float(found.std[i]), "px") for i in range(2))
        parts.append(f"fx {fx}, fy {fy}")
    if found.used:
        parts.append(
            f"reprojection error {found.rms:.3f} px over {len(found.used)} of "
            f"{len(found.views)} views"
        )
    if board is not None:
        distance = float(np.linalg.norm(board.found.translation))
        parts.append(
            f"pattern on the board at {distance:.3f} m, fitted within {board.found.rms:.2f} px"
        )
    return "; ".join(parts)


def _rows(found: Calibration) -> list[tuple[str, str]]:
    camera, k = found.intrinsics, found.intrinsics.matrix
    std = [None] * 4 if found.std is None else [float(s) for s in found.std]
    values = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
    rows = [("image", f"{camera.width} x {camera.height} px")]
    for (name, value), s in zip(values.items(), std, strict=True):
        plain = number(float(value), "px", 5) if s is None else measured(float(value), s, "px")
        rows.append((name, plain))
    angle = 2.0 * math.degrees(math.atan(0.5 * camera.width / k[0, 0]))
    rows.append(("angle of view", f"{angle:.1f} deg horizontally"))
    rows.append(("distortion model", camera.model))
    for name, value in zip(COEFFICIENTS, camera.distortion, strict=False):
        if value or found.lens is None:
            rows.append((name, number(value, "", 4)))
    return rows


def _report_views(found: Calibration, skipped: Sequence[Skipped]) -> list[CalibrationView]:
    views = [
        CalibrationView(
            v.view.name,
            v.used,
            v.reason,
            v.rms,
            math.nan if v.pose is None else float(np.linalg.norm(v.pose.translation)),
            math.nan if v.pose is None else math.degrees(v.pose.tilt),
            v.view.pixels,
            v.dropped,
        )
        for v in found.views
    ]
    nothing = np.zeros((0, 2))
    views += [
        CalibrationView(s.name, False, s.reason, math.nan, math.nan, math.nan, nothing)
        for s in skipped
    ]
    return views


def _lens_rows(found: Calibration) -> list[tuple[str, float, str]]:
    return [
        (
            s.lens.name,
            s.rms if math.isfinite(s.rms) else math.nan,
            "chosen" * (s.lens == found.lens),
        )
        for s in found.lenses
    ]


def _board_rows(board: BoardPose) -> list[tuple[str, str]]:
    std = ", ".join(f"{1e3 * s:.2f}" for s in board.std_translation)
    turn = ", ".join(f"{math.degrees(s):.3f}" for s in board.std_rotation)
    degrees = math.degrees(board.found.tilt)
    return [
        ("translation", f"[{', '.join(f'{v:.5f}' for v in board.pose.translation)}] m"),
        ("rotation x y z w", f"[{', '.join(f'{v:.6f}' for v in board.pose.rotation)}]"),
        ("reprojection error", number(board.found.rms, "px")),
        ("standard deviation, translation", f"{std} mm"),
        ("standard deviation, rotation", f"{turn} deg, of the corners alone, in the optical frame"),
        ("optical axis against the board's normal", f"{degrees:.1f} deg"),
        ("pattern's centre in the board frame", f"{list(board.pattern_at)} m"),
    ]


def _board_picture(
    board: BoardPose, picture: Image, pattern: Pattern, intrinsics: Intrinsics
) -> BoardPicture:
    drawn = draw_board(picture, intrinsics.camera(board.pose), pattern, board.pattern_at)
    scale = PICTURE / max(drawn.shape[:2])
    if scale < 1.0:
        drawn = cv2.resize(drawn, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return BoardPicture(data.tobytes(), tuple(_board_rows(board)), board.hints)


def summary(found: Calibration, skipped: Sequence[Skipped], board: BoardPose | None) -> str:
    """The result for the terminal, the most important at the end."""
    lines = []
    if found.views:
        lines.append(_table(found.views))
    lines += [f"{s.name}: {s.reason}" for s in skipped[:FAILURES_SHOWN]]
    if len(skipped) > FAILURES_SHOWN:
        lines.append(f"... and {len(skipped) - FAILURES_SHOWN} more images without a view")
    lines += [f"  {name}: {value}" for name, value in _rows(found)]
    lines += [f"hint: {hint}" for hint in found.hints]
    if board is not None:
        lines += [f"  board, {name}: {value}" for name, value in _board_rows(board)]
        lines += [f"hint: {hint}" for hint in board.hints]
    lines.append(_headline(found, board))
    return "\n".join(lines)


def _table(views: Sequence[ViewResult]) -> str:
    table = Table(box=None, pad_edge=False)
    for name in ("view", "error [px]", "distance [m]", "tilt [deg]", "edges [px]"):
        table.add_column(escape(name), justify="left" if name == "view" else "right", no_wrap=True)
    table.add_column("remark")
    for v in views:
        distance, tilt = "", ""
        if v.pose is not None:
            distance = f"{np.linalg.norm(v.pose.translation):.3f}"
            tilt = f"{math.degrees(v.pose.tilt):.0f}"
        remark = "" if v.used else f"left out, {v.reason}"
        if v.used and v.dropped:
            remark = f"{v.dropped} of its corners left out"
        error = f"{v.rms:.3f}" if math.isfinite(v.rms) else ""
        table.add_row(
            escape(v.view.name), error, distance, tilt, f"{v.view.edge_width:.1f}", remark
        )
    terminal = Console(highlight=False)
    width = terminal.width if terminal.is_terminal else WIDTH
    console = Console(file=io.StringIO(), width=width, highlight=False)
    console.print(table)
    assert isinstance(console.file, io.StringIO)
    return "\n".join(line.rstrip() for line in console.file.getvalue().splitlines())
