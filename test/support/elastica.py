# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Planar elastica under dead loads as a boundary value problem: an answer from outside the package.

A cantilever starts at the origin in a given direction; the force n(s) that all loads beyond s exert
is known. With the angle positive from x towards -z, t = (cos a, -sin a), and moment M = B f(kappa):

    a' = kappa(M) + kappa_0,   M' = -(n . dt/da) (1 + n . t / EA),   r' = t (1 + n . t / EA)

The length is cut where something jumps, and all pieces are solved at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid, solve_bvp
from scipy.optimize import brentq


@dataclass
class Cantilever:
    """SI units; functions take s of any shape [m]."""

    length: float
    stiffness: Callable[[np.ndarray], np.ndarray]  # B(s)
    stretch: float  # E A
    force: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # n(s): x, z
    rest: Callable[[np.ndarray], np.ndarray] = np.zeros_like
    curvature: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda moment, b: moment / b
    direction: float = 0.0
    breaks: Sequence[float] = ()
    kinks: dict[float, float] = field(default_factory=dict)

    def _unloaded(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle and x, z without any load, shapes as s and (2, ...)."""
        fine = np.linspace(0.0, self.length, 2001)
        angle = self.direction + cumulative_trapezoid(self.rest(fine), fine, initial=0.0)
        for place, kink in self.kinks.items():
            angle = angle + kink * (fine > place)
        along = np.array([np.cos(angle), -np.sin(angle)])
        points = cumulative_trapezoid(along, fine, initial=0.0)
        return np.interp(s, fine, angle), np.array([np.interp(s, fine, p) for p in points])

    def solve(self, s: np.ndarray) -> np.ndarray:
        """Points x, z [m] at s, shape (m, 2)."""
        cuts = np.array([0.0, *sorted(self.breaks), self.length])
        pieces = len(cuts) - 1
        start, width = cuts[:-1, None], np.diff(cuts)[:, None]
        jumps = np.array([self.kinks.get(cut, 0.0) for cut in cuts[1:-1]])

        def rate(t, y):
            a, moment, _, _ = y.reshape(4, pieces, -1)
            at = start + width * t
            inside = np.clip(at, start + 1e-9, start + width - 1e-9)
            nx, nz = (np.broadcast_to(f, at.shape) for f in self.force(inside))
            b = self.stiffness(inside)
            grown = 1.0 + (nx * np.cos(a) - nz * np.sin(a)) / self.stretch
            return np.concatenate(
                [
                    width * (self.curvature(moment, b) + self.rest(inside)),
                    width * grown * (nx * np.sin(a) + nz * np.cos(a)),
                    width * grown * np.cos(a),
                    -width * grown * np.sin(a),
                ]
            )

        def ends(first, last):
            p, q = first.reshape(4, pieces), last.reshape(4, pieces)
            step = p[:, 1:] - q[:, :-1]
            step[0] -= jumps
            begin = [p[0, 0] - self.direction, p[2, 0], p[3, 0]]
            return np.concatenate([begin, [q[1, -1]], step.ravel()])

        grid = np.linspace(0.0, 1.0, 80)
        guess = np.zeros((4, pieces, len(grid)))
        guess[0], guess[2:] = self._unloaded(start + width * grid)
        full = self.force
        for share in (0.05, 0.2, 0.5, 1.0):  # the load is brought on gradually
            self.force = lambda at, share=share: tuple(share * f for f in full(at))
            solution = solve_bvp(
                rate, ends, grid, guess.reshape(-1, len(grid)), tol=1e-8, max_nodes=50000
            )
            assert solution.success, solution.message
            guess = solution.sol(grid)
        self.force = full
        piece = np.clip(np.searchsorted(cuts, s, side="right") - 1, 0, pieces - 1)
        t = (s - cuts[piece]) / width[piece, 0]
        values = solution.sol(t).reshape(4, pieces, -1)
        return np.column_stack([values[c, piece, np.arange(len(s))] for c in (2, 3)])


def hinged(problem: Cantilever, compliance: float, weight: float) -> Cantilever:
    """The cantilever on a torsional spring: its direction gives way to the moment at the clamp.

    Args:
        problem: the cantilever under its own weight alone.
        compliance: compliance of the spring [rad/(N m)].
        weight: weight per length [N/m].
    """
    fine = np.linspace(0.0, problem.length, 2001)

    def too_far(turned: float) -> float:
        x = replace(problem, direction=problem.direction + turned).solve(fine)[:, 0]
        return turned - compliance * weight * float(np.trapezoid(x, fine))  # clockwise

    turned = float(brentq(too_far, 0.0, 0.5 * np.pi, xtol=1e-9))
    return replace(problem, direction=problem.direction + turned)
