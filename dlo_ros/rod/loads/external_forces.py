# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""External forces on a rod as forces at points along it: weight, drag, contact, hung masses.

The same forces as those of `contact_and_friction` and of the model's matrices, at many instants
at once.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.rod.loads.stress_resultants import Instants
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.planar_model import IN_PLANE
from dlo_ros.spline import FloatArray


class ExternalForces:
    """Points of one rod at which external forces act.

    Weight, drag and inertia are integrated as the model's matrices are, exactly; friction with the
    board and quadratic drag at the model's quadrature points; contact where it is looked for.

    Args:
        model: the rod.

    Attributes:
        matrix: basis functions at the m points, shape (m, n).
        span: knot span of each, shape (m,).
    """

    def __init__(self, model: RodModel) -> None:
        self._model, basis, body = model, model.basis, model.body
        u, self._width = basis.quadrature()
        around = model.surroundings
        rough = model.points if around.friction > 0.0 or around.brake > 0.0 else np.zeros(0)
        touch = np.zeros((len(around.span), basis.control_points))
        for k, span in enumerate(around.span):
            touch[k, span : span + 4] = around.b[k]
        hung = np.array([place for _, place in body.masses] + [p for p, _ in model.point_forces])
        self.matrix = np.concatenate(
            [basis.matrix(u), basis.matrix(rough), touch, basis.matrix(hung)]
        )
        places = np.concatenate([u, rough, np.zeros(len(touch)), hung])
        self.span = basis.span_of(places)
        parts = np.cumsum([len(u), len(rough), len(touch), len(hung)])
        self._smooth, self._rough = slice(0, parts[0]), slice(parts[0], parts[1])
        self._touch, self._hung = slice(parts[1], parts[2]), slice(parts[2], parts[3])
        self.span[self._touch] = around.span

    def mass(self, longer: float) -> FloatArray:
        """Mass at each point [kg], shape (m,).

        Args:
            longer: see `Instants.growth`.
        """
        body, result = self._model.body, np.zeros(len(self.span))
        result[self._smooth] = longer * body.lengthening * body.line_density * self._width
        hung = result[self._hung]
        hung[: len(body.masses)] = [mass for mass, _ in body.masses]
        return result

    def at(self, now: Instants, tangent: FloatArray, longer: float) -> FloatArray:
        """Forces on the rod [N], inertia aside, shape (S, m, 3).

        Args:
            now: S instants.
            tangent: unit tangents at the quadrature points, shape (S, nb, 3).
            longer: see `Instants.growth`.
        """
        body, around = self._model.body, self._model.surroundings
        place, speed = self.matrix @ now.q[..., :3], self.matrix @ now.velocity[..., :3]
        result = self.mass(longer)[:, None] * body.gravity + np.zeros_like(place)
        width = (longer * body.lengthening * self._width)[:, None]
        result[:, self._smooth] += width * (body.force - body.air_drag * speed[:, self._smooth])
        for k, (_, force) in enumerate(self._model.point_forces, start=len(body.masses)):
            result[:, self._hung][:, k] += np.asarray(force)
        weight = self._model.rule.weight[:, None]
        if around.brake > 0.0:
            v = speed[:, self._rough]
            across = v - np.sum(v * tangent, axis=-1, keepdims=True) * tangent
            size = np.linalg.norm(across, axis=-1, keepdims=True)
            result[:, self._rough] -= longer * around.brake * weight * size * across
        flat = result[..., IN_PLANE]
        if around.friction > 0.0:
            away = place[:, self._rough][..., IN_PLANE] - now.internal.anchor
            size = np.linalg.norm(away, axis=-1, keepdims=True)
            flat[:, self._rough] -= weight * around.friction * away / np.maximum(size, around.creep)
        if len(around.span):
            flat[:, self._touch] -= self._contact(place[:, self._touch][..., IN_PLANE])
        result[..., IN_PLANE] = flat
        return result

    def _contact(self, points: FloatArray) -> FloatArray:
        """Forces against pegs and walls of points (S, nc, 2), likewise [N]."""
        around = self._model.surroundings
        result, push = np.zeros_like(points), (around.contact * around.weight)[:, None]
        for x, z, reach in around.pegs:
            away = points - np.array([x, z])
            size = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9 * reach)
            result += push * np.minimum(size - reach, 0.0) * away / size
        for x, z, offset in around.walls:
            normal = np.array([x, z])
            result += push * np.minimum(points @ normal - offset, 0.0)[..., None] * normal
        return result
