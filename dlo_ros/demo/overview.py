# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One picture of a run, for the README: overlay, ERR and E/mu over time."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dlo_ros.files import write_bytes
from dlo_ros.report import IdentificationReport, ParameterTrack, Photograph, ShapeFrame
from dlo_ros.report.elements import typeset
from dlo_ros.report.plots import COLOURS, STYLE
from dlo_ros.report.shape_player import CURVES


def write_overview(path: Path, report: IdentificationReport) -> None:
    """Write a PNG of the last photograph with its curves, ERR and the last parameter's track."""
    frames = [f for r in report.recordings for f in r.frames]
    pictured = [f for f in frames if f.photograph is not None and f.predicted is not None]
    with rc_context(STYLE):
        figure = Figure(figsize=(10.0, 4.2), layout="constrained", dpi=110)
        if pictured:
            left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.1), squeeze=True)
            last = pictured[-1]
            assert last.photograph is not None
            draw_photograph(left, last.photograph, f"camera image at {last.time:.1f} s")
            grid = right.get_subplotspec().subgridspec(2, 1)
            right.remove()
            upper, lower = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
        else:
            upper, lower = figure.subplots(2, 1)
        draw_course(upper, lower, report)
        save(path, figure)


def save(path: Path, figure: Figure) -> None:
    """Write a figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    write_bytes(path, buffer.getvalue())


def draw_course(upper: Axes, lower: Axes, report: IdentificationReport) -> None:
    """Draw ERR, and below it the last parameter, over time."""
    frames = [f for r in report.recordings for f in r.frames]
    _draw_err(upper, frames)
    if report.tracks:
        _draw_track(lower, report.tracks[-1])
    end = max(f.time for f in frames)
    for axes in (upper, lower):
        axes.set_xlim(0.0, end)


def draw_photograph(axes: Axes, photograph: Photograph, title: str) -> None:
    """Draw a camera's picture with the curves that are known in it."""
    picture = cv2.imdecode(np.frombuffer(photograph.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    axes.imshow(picture[:, :, ::-1])
    for name, colour, style in (
        ("observed", "observed", "-"),
        ("predicted", "predicted", "--"),
        ("initial", "other", ":"),
    ):
        curve = getattr(photograph, name)
        if curve is not None:
            axes.plot(
                curve[:, 0], curve[:, 1], style, color=COLOURS[colour], lw=1.8, label=CURVES[name]
            )
    axes.set_axis_off()
    axes.set_title(title, fontsize=10)
    axes.legend(loc="lower right", frameon=True, fontsize=9)


def _draw_err(axes: Axes, frames: list[ShapeFrame]) -> None:
    known = [(f.time, 1e3 * f.err) for f in frames if f.err is not None]
    axes.plot(*zip(*known, strict=True), color=COLOURS["observed"])
    axes.set_ylabel("ERR [mm]")
    axes.set_ylim(bottom=0.0)
    axes.tick_params(labelbottom=False)


def _draw_track(axes: Axes, track: ParameterTrack) -> None:
    relative = np.clip(track.std / np.abs(track.values), 0.0, 50.0)
    low, high = track.values * np.exp(-relative), track.values * np.exp(relative)
    axes.set_yscale("log")
    axes.plot(track.times, track.values, color=COLOURS["observed"], label="estimate, 1 std")
    limits = axes.get_ylim()
    axes.fill_between(track.times, low, high, color=COLOURS["observed"], alpha=0.2, linewidth=0)
    if track.true is not None:
        axes.axhline(track.true, color=COLOURS["true"], linestyle="--", label="true value")
        limits = min(limits[0], 0.8 * track.true), max(limits[1], 1.25 * track.true)
    axes.set_ylim(*limits)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(typeset(f"{track.name} [{track.unit}]"))
    axes.legend(fontsize=9)
