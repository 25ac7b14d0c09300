# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of uncertainty: ellipses of two parameters, and residuals along the DLO and in time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dlo_ros.report.elements import markup
from dlo_ros.spline import FloatArray

SIDE = 220.0  # px of an ellipse's frame
MAP = (640.0, 150.0)  # px of a map of residuals
MOST_COLUMNS = 60


@dataclass(frozen=True)
class Ellipse:
    """Joint covariance of two parameters.

    Args:
        names: names of the horizontal and the vertical quantity.
        covariance: covariance of their logarithms, shape (2, 2).
    """

    names: tuple[str, str]
    covariance: FloatArray


@dataclass(frozen=True)
class ResidualMap:
    """Residuals across the DLO.

    Args:
        times: [s], shape (F,).
        across: observed minus predicted [m], positive to the left of growing u, at equally spaced
            places from u = 0 to L, shape (F, U).
        signed: whether it has a sign; in space it has none.
    """

    times: FloatArray
    across: FloatArray
    signed: bool = True


def ellipse_picture(ellipse: Ellipse) -> str:
    """Ellipses of one and two standard deviations, as SVG; axes in percent of the estimate."""
    std = np.sqrt(np.diag(ellipse.covariance))
    reach = 2.6 * np.maximum(std, 1e-9)
    root = np.linalg.cholesky(ellipse.covariance + 1e-12 * np.diag(std**2 + 1e-18))
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    left, top = 70.0, 10.0
    parts = [
        f'<rect class="gridline" fill="none" x="{left}" y="{top}" width="{SIDE}" height="{SIDE}"/>'
    ]
    for size, name in ((1.0, "observed"), (2.0, "predicted")):
        curve = (size * root @ circle) / reach[:, None]
        x = left + 0.5 * SIDE * (1.0 + curve[0])
        y = top + 0.5 * SIDE * (1.0 - curve[1])
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        parts.append(f'<polyline class="curve {name}" points="{points}"/>')
    correlation = ellipse.covariance[0, 1] / max(float(std[0] * std[1]), 1e-300)
    for share in (-1.0, 0.0, 1.0):
        x = left + 0.5 * SIDE * (1.0 + 0.8 * share)
        parts.append(_tick(x, top + SIDE + 16, "middle", 80.0 * share * reach[0]))
        y = top + 0.5 * SIDE * (1.0 - 0.8 * share) + 4
        parts.append(_tick(left - 6, y, "end", 80.0 * share * reach[1]))
    below = top + SIDE + 36
    parts.append(
        f'<text class="tick" x="{left + 0.5 * SIDE}" y="{below:.0f}" text-anchor="middle" '
        f'font-size="12">{markup(ellipse.names[0])}</text>'
        f'<text class="tick" font-size="12" text-anchor="middle" '
        f'transform="translate(14 {top + 0.5 * SIDE}) rotate(-90)">'
        f"{markup(ellipse.names[1])}</text>"
        f'<text class="tick" x="{left + 6}" y="{top + 16}" font-size="12">correlation '
        f"{round(correlation, 2) + 0.0:+.2f}</text>"
    )
    return (
        f'<svg viewBox="0 0 {left + SIDE + 10:.0f} {below + 8:.0f}" role="img" '
        f'style="max-width:24rem" aria-label="uncertainty of {markup(ellipse.names[0])} and '
        f'{markup(ellipse.names[1])}">{"".join(parts)}</svg>'
    )


def _tick(x: float, y: float, anchor: str, percent: float) -> str:
    return (
        f'<text class="tick" x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}" font-size="11">'
        f"{f'{percent:+.2g}' if percent else '0'} %</text>"
    )


def residual_picture(residuals: ResidualMap) -> str:
    """Residuals over time (to the right) and u (upwards) in colours, as SVG."""
    every = max(1, math.ceil(len(residuals.times) / MOST_COLUMNS))
    values = residuals.across[::every]
    times = residuals.times[::every]
    largest = max(float(np.quantile(np.abs(values), 0.98)), 1e-9)
    left, top, (width, height) = 60.0, 8.0, MAP
    across, up = width / len(values), height / values.shape[1]
    parts = []
    for f, row in enumerate(values):
        for k, value in enumerate(row):
            strength = min(abs(float(value)) / largest, 1.0)
            if strength < 0.02:
                continue
            colour = "predicted" if value > 0.0 else "observed"
            x, y = left + f * across, top + height - (k + 1) * up
            parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{across + 0.3:.1f}" '
                f'height="{up + 0.3:.1f}" fill="var(--{colour})" fill-opacity="{strength:.2f}"/>'
            )
    parts.append(
        f'<rect class="gridline" fill="none" x="{left}" y="{top}" width="{width}" '
        f'height="{height}"/>'
    )
    texts = (
        (left - 6, top + height, "end", "u = 0"),
        (left - 6, top + 12, "end", "u = L"),
        (left, top + height + 16, "start", f"{times[0]:.1f} s"),
        (left + width, top + height + 16, "end", f"{times[-1]:.1f} s"),
        (left + 0.5 * width, top + height + 16, "middle", f"full colour: {1e3 * largest:.2g} mm"),
    )
    for x, y, anchor, text in texts:
        parts.append(
            f'<text class="tick" x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}" font-size="12">'
            f"{text}</text>"
        )
    return (
        f'<svg viewBox="0 0 {left + width + 10:.0f} {top + height + 24:.0f}" role="img" '
        f'aria-label="residuals along the DLO and in time">{"".join(parts)}</svg>'
    )
