# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One picture of a run in space: the cameras' overlays, the DLO in space, ERR and E/mu in time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dlo_ros.command import NANOSECONDS, Motion
from dlo_ros.demo.overview import draw_course, draw_photograph, save
from dlo_ros.report import IdentificationReport, Photograph, ShapeFrame
from dlo_ros.report.plots import COLOURS, STYLE
from dlo_ros.report.shape_player import CURVES
from dlo_ros.spline import FloatArray, SplineBasis

POINTS = 80
"""Points along a curve that is drawn."""

TICKS = 4
"""Marks on an axis at most, so that they do not overlap in a small panel."""

VIEW = (18.0, -62.0)
"""Elevation and azimuth of the view in space [degrees]: from the cameras' side, from the right."""

LINES = (("initial", "other", ":"), ("observed", "observed", "-"), ("predicted", "predicted", "--"))

Views = Mapping[str, Mapping[int, Photograph]]
"""Pictures by the camera's name and the stamp of the observed spline [ns]."""


def write_space_overview(
    path: Path, report: IdentificationReport, views: Views, motion: Motion, start: int
) -> None:
    """Write a PNG of the last instant with pictures of all cameras, and of the run's course.

    Args:
        path: path of the picture.
        report: report about one recording.
        views: views of every camera; empty: no pictures were played.
        motion: motion of the clamps.
        start: stamp of the first observed spline [ns].
    """
    recording = report.recordings[0]
    frame, shown = _instant(recording.frames, views, start)
    with rc_context(STYLE):
        figure = Figure(figsize=(10.0, 6.4), layout="constrained", dpi=90)
        rows: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.1))
        upper, lower = rows
        if shown:
            panels = upper.subplots(1, len(shown), squeeze=False)[0]
            for axes, (name, photograph) in zip(panels, shown.items(), strict=True):
                draw_photograph(axes, photograph, f"camera '{name}' at {frame.time:.1f} s")
        left, right = lower.subfigures(1, 2)
        space = left.add_subplot(projection="3d", computed_zorder=False)
        _draw_space(space, frame, recording.length, motion, start)
        err, track = right.subplots(2, 1)
        draw_course(err, track, report)
        save(path, figure)


def _instant(
    frames: tuple[ShapeFrame, ...], views: Views, start: int
) -> tuple[ShapeFrame, dict[str, Photograph]]:
    """The last frame with pictures of all cameras and a prediction, and these pictures."""
    stamps = [start + round(frame.time * NANOSECONDS) for frame in frames]
    for frame, stamp in reversed(list(zip(frames, stamps, strict=True))):
        seen = {name: each[stamp] for name, each in views.items() if stamp in each}
        if frame.predicted is not None and seen and len(seen) == len(views):
            return frame, seen
    known = [frame for frame in frames if frame.predicted is not None]
    return (known or list(frames))[-1], {}


def _draw_space(axes: Any, frame: ShapeFrame, length: float, motion: Motion, start: int) -> None:
    """Draw the curves of an instant and the clamps' ways up to it; lengths in mm."""
    u = np.linspace(0.0, length, POINTS)
    drawn = []
    for name, colour, style in LINES:
        shape = getattr(frame, name)
        if shape is not None:
            curve = 1e3 * SplineBasis(len(shape), length).evaluate(shape[:, :3], u)
            axes.plot(*curve.T, style, color=COLOURS[colour], lw=1.8, label=CURVES[name])
            drawn.append(curve)
    for way in _ways(motion, start, start + round(frame.time * NANOSECONDS)):
        axes.plot(*(1e3 * way).T, color="0.6", lw=1.0)
        axes.plot(*(1e3 * way[-1:]).T, "s", color="0.3", ms=5)
        drawn.append(1e3 * way)
    every = np.concatenate(drawn)
    low, high = every.min(axis=0), every.max(axis=0)
    axes.set_box_aspect(np.maximum(high - low, 20.0), zoom=0.95)
    for axis, name in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        axis.set_label_text(f"{name} [mm]", fontsize=8)
        axis.set_tick_params(labelsize=7)
        axis.set_major_locator(MaxNLocator(TICKS))
    axes.view_init(*VIEW)
    axes.set_title("in space; grey: the grippers' ways", fontsize=10)


def _ways(motion: Motion, start: int, until: int) -> list[FloatArray]:
    """Ways of the clamps from one stamp [ns] to another, shape (m, 3) [m] each."""
    ways: dict[str, list[FloatArray]] = {}
    for stamp in np.linspace(start, until, POINTS).astype(np.int64).tolist():
        command = motion.at(stamp)
        if command is not None:
            for name, position in zip(command.names, command.sample(stamp)[0], strict=True):
                ways.setdefault(name, []).append(position)
    return [np.array(way) for way in ways.values()]
