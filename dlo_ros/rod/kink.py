"""The curvature at rest that stands for a kink in a rod whose curvature cannot be a pulse."""

from __future__ import annotations

import numpy as np

from dlo_ros.spline import FloatArray, SplineBasis

FINE = 8  # points of a knot span at which the tangent's angle is looked at


def profile(basis: SplineBasis, points: FloatArray, place: float) -> FloatArray:
    """Curvature of a kink of 1 rad at a place u, at points (m,) [1/m].

    The curvature of a cubic spline is a line in each knot span. A kink that is only spread cuts its
    corner: with the deviation g, from -1 to 1, of the tangent from its mean direction, what lies
    beyond is displaced along that direction by angle^2 / 8 * integral of (1 - g^2). So the tangent
    overshoots by as much as makes that integral vanish.
    """
    knots = np.linspace(0.0, basis.length, basis.spans + 1)
    u, weight = basis.quadrature(3)
    fine = np.linspace(0.0, basis.length, basis.spans * FINE + 1)
    width = fine[1]

    def lines(at: FloatArray) -> FloatArray:
        return np.maximum(1.0 - np.abs(at[:, None] - knots) / basis.span_length, 0.0)

    near = lines(u)
    gram = near.T @ (weight[:, None] * near)
    heights, turned = [], []
    for reach in (basis.span_length, 2.0 * basis.span_length):
        hat = np.maximum(1.0 - np.abs(u - place) / reach, 0.0)
        height = np.linalg.solve(gram, near.T @ (weight * hat))
        curvature = lines(fine) @ height
        angle = np.concatenate([[0.0], np.cumsum(0.5 * width * (curvature[1:] + curvature[:-1]))])
        heights.append(height / angle[-1])
        turned.append(2.0 * angle / angle[-1] - 1.0)
    one, more = turned[0], turned[0] - turned[1]
    cut, slope, bend = (
        float(np.trapezoid(x, dx=width)) for x in (1.0 - one**2, one * more, more**2)
    )
    share = (np.sqrt(slope**2 + cut * bend) - slope) / bend
    return np.asarray(lines(points) @ (heights[0] + share * (heights[0] - heights[1])))
