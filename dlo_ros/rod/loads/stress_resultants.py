# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Stress resultants of many instants at once, and the generalised forces that balance them.

The same strain energy as in `strains` and `constitutive_law`, in NumPy: at an instant that has been
reached the reference frame is the present one, so that its derivatives are short. Strain rates are
those of the velocity, not backward differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dlo_ros.rod.elements.rod_tables import InternalVariables
from dlo_ros.rod.elements.strains import MIDDLE, OUTER
from dlo_ros.rod.model import RodModel
from dlo_ros.rod_settings import kink_curvature
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class Instants:
    """States of a rod at S instants.

    Args:
        q, velocity: x, y, z [m] and theta [rad] of the control points, and rates, shape (S, n, 4).
        acceleration: rates of the velocity, shape (S, n, 4); only those of held points are used.
        director: first director of the reference frame, shape (S, nb, 3).
        twist: twist of the reference frame [rad/m], shape (S, nb).
        internal: variables of bending and friction, with a leading axis of S.
        growth: free length over the model's, and its rate [1/s]; the same for all.
    """

    q: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    director: FloatArray
    twist: FloatArray
    internal: InternalVariables
    growth: tuple[float, float]


class Stresses:
    """The stresses of one rod.

    Args:
        model: the rod.
    """

    def __init__(self, model: RodModel) -> None:
        self._model = model
        self.value = model.basis.matrix(model.points)  # (nb, n)
        self.slope, self.curvature = model.discretisation.slope, model.discretisation.curvature

    @cached_property
    def _tension_share(self) -> FloatArray:
        """Weights with which tension acts at the points, shape (nb,) [m]."""
        rule = self._model.rule
        share = np.where(np.arange(rule.weight.size) % 3 == 1, 1.0 / MIDDLE, 0.0)
        return np.where(np.repeat(rule.stretch_linear, 3), 1.0, share) * rule.weight

    def _stretch(self, x: FloatArray) -> FloatArray:
        """Values (S, nb) as those of whole spans, see `strains.span_stretch`."""
        return _spans(x, self._model.rule.stretch_linear, (0.0, 1.0, 0.0))

    def _twist(self, x: FloatArray) -> FloatArray:
        """Values (S, nb) as those of whole spans, see `strains.span_twist`."""
        return _spans(x, self._model.rule.twist_linear, (OUTER, MIDDLE, OUTER))

    def at(self, now: Instants) -> tuple[FloatArray, FloatArray]:
        """Generalised forces and tangents of the stresses at S instants.

        Returns:
            Generalised forces against which they act [N; N m for theta], shape (S, n, 4), and unit
            tangents at the quadrature points, shape (S, nb, 3).
        """
        model, w = self._model, self._model.rule.weight
        q, v = now.q, now.velocity
        p, s = self.slope @ q[..., :3], self.curvature @ q[..., :3]
        n = np.linalg.norm(p, axis=-1)
        t = p / n[..., None]
        bow = cross(p, s) / n[..., None] ** 3
        theta = (self.value @ q[..., 3:])[..., 0]
        cos, sin = np.cos(theta)[..., None], np.sin(theta)[..., None]
        d1 = cos * now.director + sin * cross(t, now.director)
        directors = d1, cross(t, d1)
        kappa = np.stack([dot(bow, d) for d in directors], axis=-1)  # (S, nb, 2)
        by_p = [
            cross(s, d) / n[..., None] ** 3 - 3.0 * (k / n**2)[..., None] * p
            for d, k in zip(directors, (kappa[..., 0], kappa[..., 1]), strict=True)
        ]
        by_s = [cross(d, p) / n[..., None] ** 3 for d in directors]
        by_theta = [kappa[..., 1], -kappa[..., 0]]
        rate = (self.slope @ q[..., 3:])[..., 0]
        dp, ds = self.slope @ v[..., :3], self.curvature @ v[..., :3]
        d_theta = (self.value @ v[..., 3:])[..., 0]
        kappa_rate = np.stack(
            [dot(by_p[i], dp) + dot(by_s[i], ds) + by_theta[i] * d_theta for i in range(2)],
            axis=-1,
        )
        twist_rate = dot(bow, dp) + (self.slope @ v[..., 3:])[..., 0]
        stretch, stretch_rate = self._stretch(n - 1.0), self._stretch(dot(t, dp))
        longer, longer_rate = now.growth
        stiff, t_r = model.stiffness, model.body.relaxation_time
        tension = (stiff.stretch / longer) * (
            stretch - (longer * (1.0 + stiff.stretch_rest) - 1.0)
            + t_r * (stretch_rate - longer_rate)
        )  # fmt: skip
        torque = (stiff.twist / longer) * (
            self._twist(rate + now.twist) - longer * stiff.twist_rest
            + t_r * self._twist(twist_rate)
        )  # fmt: skip
        moment = self._moment(kappa, kappa_rate, longer, now.internal)
        m1, m2 = moment[..., 0], moment[..., 1]
        pull = self._tension_share * tension
        g_p = pull[..., None] * t + (w * torque)[..., None] * bow
        g_p += (w * m1)[..., None] * by_p[0] + (w * m2)[..., None] * by_p[1]
        g_s = (w * m1)[..., None] * by_s[0] + (w * m2)[..., None] * by_s[1]
        g_theta = w * (m1 * by_theta[0] + m2 * by_theta[1])
        gradient = np.empty_like(q)
        gradient[..., :3] = self.slope.T @ g_p + self.curvature.T @ g_s
        gradient[..., 3] = g_theta @ self.value + (w * torque) @ self.slope
        return gradient, t

    def _bending(self, longer: float) -> tuple[FloatArray, FloatArray]:
        """Bending stiffness (nb, 3) and rest curvature (nb, 2), see `write_grown_bending`.

        Args:
            longer: see `Instants`.
        """
        model = self._model
        if longer == 1.0:
            return model.stiffness.bend, model.stiffness.bend_rest
        less = 1.0 / longer - 1.0
        one, two, both = model.stiffness.bend.T
        softer, product = less * model.hinge, one * two - both**2
        share = longer / (1.0 + softer * (one + two + softer * product))
        bend = np.column_stack([one + softer * product, two + softer * product, both])
        rest = model.stiffness.bend_rest.copy()
        rest[:, 0] += less * kink_curvature(model.body)
        return share[:, None] * bend, rest

    def _moment(
        self, kappa: FloatArray, rate: FloatArray, longer: float, internal: InternalVariables
    ) -> FloatArray:
        """Bending moments about the two material directors [N m], shape (S, nb, 2).

        Args:
            kappa, rate: curvatures [1/m] and their rates, shape (S, nb, 2).
            longer, internal: see `Instants`.
        """
        model, law = self._model, self._model.law
        bend, rest = self._bending(longer)
        stiff, both = bend[:, :2], bend[:, 2:]
        x = kappa - rest
        strain = (1.0 - law.relaxing) * x + model.body.relaxation_time * rate
        if internal.inner.shape[1]:
            strain = strain + internal.inner[..., :2]
        result = stiff * strain + both * strain[..., ::-1]
        if internal.inner.shape[1]:
            result += law.slide * internal.inner[..., 2:4]
        if law.active != 0.0:
            elastic = x - (1.0 - law.hardening) * internal.yield_centre
            mean = stiff.mean(axis=-1, keepdims=True)
            size = np.sqrt(np.sum(stiff * elastic**2, axis=-1, keepdims=True) / mean)
            ratio = np.maximum(size / law.half_curvature[:, None], 1e-9)
            softer = np.arctan(ratio) / ratio * elastic - x
            result += (1.0 - law.relaxing) * stiff * softer
        return result


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector products of arrays (..., 3); for few vectors much faster than NumPy's."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(a[..., j] * b[..., k], a[..., k] * b[..., j], out=result[..., i])
    return result


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar products of arrays (..., 3)."""
    result: FloatArray = np.einsum("...c,...c->...", a, b)
    return result


def _spans(x: FloatArray, linear: np.ndarray, mean: tuple[float, float, float]) -> FloatArray:
    """Values (S, nb) as the mean of each span, or the straight line that fits best."""
    points = x.reshape(len(x), -1, 3)
    flat = points @ np.array(mean)
    line = points @ np.array([OUTER, MIDDLE, OUTER])
    tilt = 0.5 * (points[..., 2] - points[..., 0])
    middle = np.where(linear, line, flat)[..., None]
    away = np.where(linear, tilt, 0.0)[..., None] * np.array([-1.0, 0.0, 1.0])
    result: FloatArray = (middle + away).reshape(x.shape)
    return result
