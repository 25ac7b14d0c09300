# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Shapes over time with a slider: observed and predicted curve on a photograph or a grid.

Shapes that leave the plane have a view besides that is turned with the mouse or the arrow keys.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from dlo_ros.errors import InputError
from dlo_ros.report.elements import millimetres, typeset
from dlo_ros.spline import FloatArray, SplineBasis

CURVE_POINTS = 80
MOST_FRAMES = 60
INTERVAL = 120  # ms between frames while playing
CELLS = 6.0  # of the grid along its longer side, at most

CURVES = {"observed": "observed", "predicted": "predicted", "initial": "predicted at first"}
"""Names of the curves in the legend, where the caller gives no others."""
NARROWEST, WIDEST = 4.0 / 3.0, 3.0
"""Width over height of a view in the plane: labels stand beside a slender shape, not on it."""
FLIP = np.array([1.0, -1.0])
"""Up in the world is down in SVG."""
RAY = 0.6
"""Length of a camera's line of sight in the view that turns, as a share of the view's radius."""


@dataclass(frozen=True)
class Photograph:
    """A camera's picture, with the curves in its pixels.

    Args:
        jpeg: the file's bytes.
        width, height: size of the picture [px].
        observed, predicted, initial: curves [px], shape (m, 2), as in `ShapeFrame`; None where
            there is none.
    """

    jpeg: bytes
    width: int
    height: int
    observed: FloatArray | None = None
    predicted: FloatArray | None = None
    initial: FloatArray | None = None


@dataclass(frozen=True)
class ShapeFrame:
    """The shapes of one instant.

    Args:
        time: time from the recording's start [s].
        observed, predicted: control points of the published basis [m], shape (n, 3) or (n, 4);
            None where there is none.
        initial: shape predicted with the initial guess, or with the plain model, likewise.
        err: eq. (10) of the paper [m]; None where it is not known.
        err_initial: the same of `initial`.
        photograph: the picture behind; None shows the grid alone.
        arrows: begin and end of each arrow [m], shape (m, 2, 3), drawn on the grid.
    """

    time: float
    observed: FloatArray | None = None
    predicted: FloatArray | None = None
    initial: FloatArray | None = None
    err: float | None = None
    photograph: Photograph | None = None
    arrows: FloatArray | None = None
    err_initial: float | None = None


def player(
    frames: Sequence[ShapeFrame],
    length: float,
    arrows: str = "arrows",
    cameras: Mapping[str, FloatArray] | None = None,
    names: Mapping[str, str] = CURVES,
    first: float | None = None,
    bodies: Sequence[FloatArray] = (),
) -> str:
    """An HTML element that shows the frames, thinned out to what a reader can look at.

    Args:
        frames: frames in the order of time.
        length: L of the spline basis [m].
        arrows: meaning of the arrows, for the legend.
        cameras: the cameras' positions [m], shape (3,), by name, whose lines of sight the view that
            turns shows.
        names: names of the curves in the legend.
        first: time [s] of the frame that is shown before the slider is moved; None: the last.
        bodies: closed outlines of what the DLO may touch, in x and z [m], shape (m, 2) each.

    Raises:
        InputError: there is no frame, or a spline is not finite.
    """
    shown = _thinned(frames, first)
    if not shown:
        raise InputError("a report needs at least one frame with a shape")
    curves = [_curves(frame, length) for frame in shown]
    planes = _planes(curves)
    tips = [ends for frame in shown for ends in _arrows(frame).values()]
    everything = np.concatenate([*(p for c in curves for p in c.values()), *tips])
    spatial = len(planes) > 1
    views: list[dict[str, Any]] = []
    pictured = [f.photograph for f in shown if f.photograph is not None]
    if pictured:
        size = max(p.width for p in pictured), max(p.height for p in pictured)
        views.append({"photograph": True, "box": [0, 0, *size]})
    views += [_grid(everything, axes, spatial) for axes in planes]
    views[-len(planes)]["bodies"] = [_flat(1e3 * b * FLIP) for b in bodies]
    if spatial:
        views.append(_turning(everything, cameras or {}))
    data = {
        "interval": INTERVAL,
        "views": views,
        "frames": [
            _frame(frame, c, planes, bool(pictured), names)
            for frame, c in zip(shown, curves, strict=True)
        ],
    }
    legend = {name: names[name] for name in CURVES if any(name in c for c in curves)}
    times = np.array([frame.time for frame in shown])
    at = len(shown) - 1 if first is None else int(np.argmin(np.abs(times - first)))
    return _element(data, (len(shown), at), legend, arrows if tips else "", touching=bool(bodies))


def _thinned(frames: Sequence[ShapeFrame], first: float | None = None) -> list[ShapeFrame]:
    """At most MOST_FRAMES, evenly over time; where there are photographs, those with one.

    Args:
        first: time [s] of a frame that is kept in the place of its neighbour; None: of none.
    """
    kept = [f for f in frames if f.observed is not None or f.predicted is not None]
    with_picture = [f for f in kept if f.photograph is not None]
    kept = with_picture or kept
    if len(kept) <= MOST_FRAMES:
        return kept
    at = np.linspace(0, len(kept) - 1, MOST_FRAMES).round().astype(int)
    if first is not None:
        chosen = int(np.argmin([abs(f.time - first) for f in kept]))
        at[np.argmin(np.abs(at - chosen))] = chosen
    return [kept[i] for i in at]


def _curves(frame: ShapeFrame, length: float) -> dict[str, FloatArray]:
    """Points of each curve of a frame [mm], shape (CURVE_POINTS, 3)."""
    result = {}
    for name in CURVES:
        points: FloatArray | None = getattr(frame, name)
        if points is None:
            continue
        if not np.all(np.isfinite(points)):
            raise InputError(f"the {CURVES[name]} spline at {frame.time:g} s is not finite")
        basis = SplineBasis(len(points), length)
        u = np.linspace(0.0, length, CURVE_POINTS)
        result[name] = 1e3 * (basis.matrix(u) @ points[:, :3])
    return result


def _planes(curves: Sequence[dict[str, FloatArray]]) -> list[tuple[int, int]]:
    """The planes to look at: x-z, and x-y as well where the shapes leave the plane y = 0."""
    points = np.concatenate([p for c in curves for p in c.values()])
    extent = np.ptp(points, axis=0)
    return [(0, 2), (0, 1)] if extent[1] > 0.05 * float(extent.max()) else [(0, 2)]


def _grid(points: FloatArray, axes: tuple[int, int], spatial: bool) -> dict[str, Any]:
    """A view onto a plane; views beside one another, of shapes in space, have one format."""
    points = points[:, list(axes)]
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * float((high - low).max())
    low, high = low - margin, high + margin
    width, height = (float(v) for v in high - low)
    widest = NARROWEST if spatial else WIDEST
    more = np.array([max(NARROWEST * height - width, 0.0), max(width / widest - height, 0.0)])
    low, high = low - 0.5 * more, high + 0.5 * more
    step = _step(high - low)
    names = "xyz"
    return {
        "box": [_short(v) for v in (low[0], -high[1], high[0] - low[0], high[1] - low[1])],
        "x_ticks": _ticks(low[0], high[0], step),
        "y_ticks": _ticks(low[1], high[1], step),
        "label": f"{names[axes[0]]} to the right, {names[axes[1]]} up, in mm",
    }


def _turning(points: FloatArray, cameras: Mapping[str, FloatArray]) -> dict[str, Any]:
    """A view of all sides: what it turns about, how far it reaches, its floor's grid [mm]."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre = 0.5 * (low + high)
    radius = 1.1 * float(np.linalg.norm(points - centre, axis=1).max())
    rays = []
    for name, position in cameras.items():
        sight = 1e3 * np.asarray(position, float) - centre
        distance = float(np.linalg.norm(sight))
        reach = min(1.0, RAY * radius / distance) if distance > 0.0 else 0.0
        rays.append({"name": name, "to": [_short(v) for v in reach * sight]})
    step = _step(high - low)
    return {
        "turning": True,
        "box": [_short(v * radius) for v in (-NARROWEST, -1.0, 2.0 * NARROWEST, 2.0)],
        "centre": [_short(v) for v in centre],
        "floor": {
            "x": _around(low[0], high[0], step),
            "y": _around(low[1], high[1], step),
            "z": _short(low[2]),
        },
        "rays": rays,
        "label": f"drag or arrow keys turn it; floor grid of {step:g} mm",
    }


def _step(extent: FloatArray) -> float:
    """Distance of grid lines [mm]: the smallest of 1, 2, 5, 10, ... with six cells at most.

    Args:
        extent: extent of the drawing in each direction [mm].
    """
    least = float(extent.max()) / CELLS
    power = 10.0 ** math.floor(math.log10(least)) if least > 0.0 else 1.0
    return next(power * f for f in (1.0, 2.0, 5.0, 10.0) if power * f >= least * (1 - 1e-9))


def _ticks(low: float, high: float, step: float) -> list[float]:
    first, last = math.ceil(low / step), math.floor(high / step)
    return [_short(k * step) for k in range(first, last + 1)]


def _around(low: float, high: float, step: float) -> list[float]:
    """Grid lines from the last one below the drawing to the first one above it."""
    first, last = math.floor(low / step), max(math.ceil(high / step), math.floor(low / step) + 1)
    return [_short(k * step) for k in range(first, last + 1)]


def _frame(
    frame: ShapeFrame,
    curves: dict[str, FloatArray],
    planes: Sequence[tuple[int, int]],
    pictured: bool,
    names: Mapping[str, str],
) -> dict[str, Any]:
    drawn = []
    photograph = frame.photograph
    if pictured:
        pixels = {name: getattr(photograph, name, None) for name in CURVES}
        drawn.append({k: _flat(v) for k, v in pixels.items() if v is not None})
    solid = {**curves, **_arrows(frame)}
    drawn += [{k: _flat(p[:, list(axes)] * FLIP) for k, p in solid.items()} for axes in planes]
    if len(planes) > 1:
        drawn.append({k: _flat(p) for k, p in solid.items()})
    before = ""
    if frame.err_initial is not None:
        before = f" ({names['initial']}: {millimetres(frame.err_initial)})"
    result: dict[str, Any] = {
        "text": f"{frame.time:.2f} s, ERR {millimetres(frame.err)}{before}",
        "curves": drawn,
    }
    if photograph is not None:
        encoded = base64.b64encode(photograph.jpeg).decode("ascii")
        result["photograph"] = f"data:image/jpeg;base64,{encoded}"
    return result


def _arrows(frame: ShapeFrame) -> dict[str, FloatArray]:
    """Both ends of each arrow of a frame [mm], shape (2 m, 3)."""
    return {} if frame.arrows is None else {"arrows": 1e3 * frame.arrows.reshape(-1, 3)}


def _flat(points: FloatArray) -> list[float]:
    """Coordinates point after point, to a tenth; points that are not finite are left out."""
    finite = points[np.all(np.isfinite(points), axis=1)]
    return [_short(v) for v in finite.ravel()]


def _short(value: float) -> float:
    rounded = round(float(value), 1)
    return int(rounded) if rounded == int(rounded) else rounded


def _element(
    data: dict[str, Any], frames: tuple[int, int], names: Mapping[str, str], arrows: str, *,
    touching: bool,
) -> str:  # fmt: skip
    count, at = frames
    # "</" inside the data must not end the script element.
    text = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    pictures = '<svg role="img" aria-label="observed and predicted shape"></svg>' * len(
        data["views"]
    )
    legend = "".join(
        f'<span><svg viewBox="0 0 40 10"><path class="curve {name}" d="M2 5L38 5"/></svg>'
        f"{escape(shown)}</span>"
        for name, shown in names.items()
    )
    if arrows:
        legend += (
            '<span><svg viewBox="0 0 40 10"><path class="arrow arrows" d="M4 5H34M28 1L34 5L28 9"/>'
            f"</svg>{escape(typeset(arrows))}</span>"
        )
    if touching:
        legend += (
            '<span><svg viewBox="0 0 40 10"><path class="body" d="M2 1H38V9H2Z"/></svg>'
            "peg or wall</span>"
        )
    moved = "" if count > 1 else " hidden"  # a single shape has no time to move through
    return (
        f'<div class="player"><script type="application/json">{text}</script>'
        f'<div class="views">{pictures}</div>'
        f'<div class="legend">{legend}</div>'
        f'<div class="controls"><button type="button"{moved}>Play</button>'
        f'<input type="range" min="0" max="{count - 1}" value="{at}" step="1" '
        f'aria-label="time"{moved}><output></output></div>'
        "<noscript><p>The time slider needs JavaScript; the figures do not.</p></noscript></div>"
    )
