# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The tables of a rod that follow from its spline basis and the freedom of its ends alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dlo_ros.rod.elements.rod_tables import Quadrature
from dlo_ros.rod.elements.strains import span_twist
from dlo_ros.spline import FloatArray, SplineBasis

POINTS = 3
"""Quadrature points of a knot span."""
CONTACTS = 8
"""Points of a knot span at which contact is looked for, and one more at the end of the DLO."""
KEPT = 64
"""Discretisations that are kept: those of some recordings, each with several numbers of spans."""


@dataclass(frozen=True)
class Discretisation:
    """The tables of a spline basis, whatever the rod is made of; see `discretisation`.

    Args:
        basis: the simulation's own spline basis.
        full_start, full_end: see `dlo_ros.rod.model.RodModel`.
    """

    basis: SplineBasis
    full_start: bool
    full_end: bool

    @cached_property
    def rule(self) -> Quadrature:
        """Quadrature tables: three points a knot span.

        Stretch counts by its value in the middle of a span: at every point it would lock
        (numerics.md). Where the direction of an end is free its straight line counts, or a mode
        without energy would be left over. Twist counts by its mean, since the frame's twist is no
        spline that theta could relax: means make the twist between the ends exact, and the lines
        at both ends give as many numbers as theta has coefficients.
        """
        basis = self.basis
        u, weight = basis.quadrature(POINTS)
        span, b = self.local(u)
        stretch, twist = np.zeros(basis.spans, np.bool_), np.zeros(basis.spans, np.bool_)
        stretch[0] |= self.full_start
        stretch[-1] |= self.full_end
        twist[[0, -1]] = True
        slope, curvature = (self.local(u, k)[1] for k in (1, 2))
        return Quadrature(span, b, slope, curvature, weight.copy(), stretch, twist)

    def local(
        self, u: NDArray[np.floating[Any]], derivative: int = 0
    ) -> tuple[NDArray[np.int64], FloatArray]:
        """Knot span of each u and the four basis functions (or derivatives) that live there."""
        full = self.basis.matrix(u, derivative)
        span, rows = self.basis.span_of(u), np.arange(len(u))[:, None]
        return span, np.ascontiguousarray(full[rows, span[:, None] + np.arange(4)])

    @cached_property
    def points(self) -> FloatArray:
        """Material coordinates of the bending points [m], shape (nb,)."""
        return self.basis.quadrature(POINTS)[0]

    @property
    def contact_width(self) -> float:
        """Length of the DLO for which a point of contact stands [m]."""
        return self.basis.length / (self.basis.spans * CONTACTS)

    @cached_property
    def contacts(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Knot span and basis functions of each point of contact, see `local`.

        A tip touches a wall first: both ends are among the points.
        """
        return self.local(self.contact_width * np.arange(self.basis.spans * CONTACTS + 1))

    @cached_property
    def slope(self) -> FloatArray:
        """First derivatives of the basis at the bending points, shape (nb, n)."""
        return self.basis.matrix(self.points, 1)

    @cached_property
    def curvature(self) -> FloatArray:
        """Second derivatives of the basis at the bending points, shape (nb, n)."""
        return self.basis.matrix(self.points, 2)

    @cached_property
    def gram(self) -> FloatArray:
        """Lower band of the basis' Gram matrix, shape (n, 4) [m]."""
        return lower_band(self.basis.gram)

    def span_twists(self, values: FloatArray) -> FloatArray:
        """Twists at the points (nb, ...) as those of whole spans."""
        result = np.array(values, dtype=np.float64)
        for e in range(self.basis.spans):
            for column in result[3 * e : 3 * e + 3].reshape(3, -1).T:
                span_twist(column, self.rule.twist_linear[e])
        return result

    @cached_property
    def twist_fit(self) -> FloatArray:
        """Control points 2..n of a spline that starts at 0, from its slope over the spans."""
        return np.asarray(np.linalg.pinv(self.span_twists(self.slope[:, 1:])))


@lru_cache(maxsize=KEPT)
def discretisation(basis: SplineBasis, full_start: bool, full_end: bool) -> Discretisation:
    """The tables of a basis, kept: rods of different material have them in common."""
    return Discretisation(basis, full_start, full_end)


def lower_band(full: FloatArray) -> FloatArray:
    """Lower band (n, 4) of a symmetric matrix of basis functions (n, n)."""
    n = len(full)
    band = np.zeros((n, 4))
    for k in range(4):
        band[3 - k :, k] = np.diagonal(full, k - 3)
    return band
