# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Figures like the paper's: the simulation's shapes over the observed final one."""

from __future__ import annotations

import numpy as np

from dlo_ros.report.elements import markup
from dlo_ros.spline import FloatArray, SplineBasis
from paper.experiments import TABLE_I, TABLE_II, TABLE_III, TABLE_V, Recorded

POINTS = 80
# Figure, experiment, parameter sets, instants [s]; the paper's captions in other words.
FIGURES = (
    ("Figure 3", "simple", (TABLE_I,), (0.0, 0.5, 1.0, 3.0)),
    ("Figure 5", "different", (TABLE_II,), (0.0, 0.5, 1.0, 3.0)),
    ("Figure 7", "c_shape", (TABLE_I, TABLE_II, TABLE_III), (3.0,)),
    ("Figure 9", "approach_two", (TABLE_V,), (0.0, 0.5, 1.0, 2.0)),
    ("Figure 11", "approach_four", (TABLE_V,), (2.0,)),
)


def panels(
    recorded: Recorded, sets: tuple[tuple[float, float], ...], times: tuple[float, ...]
) -> list[tuple[str, FloatArray, FloatArray]]:
    """Label, observed final shape and simulated shape, x and z [m], of each panel."""
    rod = recorded.settings.rod
    basis = SplineBasis(rod.control_points, rod.length)
    matrix = basis.matrix(np.linspace(0.0, rod.length, POINTS))
    final = matrix @ recorded.manipulation.observations[-1].control_points[:, [0, 2]]
    result = []
    for material in sets:
        found = recorded.predicted(material)
        at = (found.stamps - found.stamps[0]) * 1e-9
        for time in times:
            k = int(np.argmin(np.abs(at - time)))
            label = f"E = {material[0]:.0e} Pa, t = {at[k]:.1f} s"
            result.append((label, final, matrix @ found.predicted[k][:, [0, 2]]))
    return result


def picture(shown: list[tuple[str, FloatArray, FloatArray]]) -> str:
    """Panels side by side at one scale, as SVG."""
    everything = np.concatenate([c for _, a, b in shown for c in (a, b)])
    low, high = everything.min(axis=0), everything.max(axis=0)
    centre, size = 0.5 * (low + high), 1.15 * float((high - low).max())
    side = 260.0
    scale = side / size
    height = 24.0 + scale * 1.15 * max(float(high[1] - low[1]), 0.1 * size)
    parts = []
    for k, (label, observed, predicted) in enumerate(shown):
        left = k * (side + 10.0)
        parts.append(
            f'<text class="tick" x="{left + 4:.0f}" y="15" font-size="13">{markup(label)}</text>'
        )
        for name, curve in (("observed", observed), ("predicted", predicted)):
            x = left + 0.5 * side + scale * (curve[:, 0] - centre[0])
            y = 24.0 + 0.5 * (height - 24.0) - scale * (curve[:, 1] - centre[1])
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
            parts.append(f'<polyline class="curve {name}" points="{points}"/>')
    width = len(shown) * (side + 10.0)
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" '
        f'aria-label="observed final and simulated shapes">{"".join(parts)}</svg>'
    )
