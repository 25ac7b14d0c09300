# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The springs that stand for quadratic drag in one step, against the law at each point."""

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.rod.elements.drag_springs import add_springs, drag_springs
from dlo_ros.rod.model import RodModel
from dlo_ros.spline import SplineBasis

RATE = 40.0  # [1/s]
DRAG = 0.3  # [N s^2/m^3]


@pytest.fixture(params=[2, 4], ids=["plane", "space"])
def moving(request):
    """A rod's rule, and crumpled control points that move: q, velocity, still."""
    dof, n = request.param, 11
    rng = np.random.default_rng(3)
    q = 0.02 * rng.normal(size=(n, dof))
    q[:, 0] += np.linspace(0.0, 0.4, n)
    return RodModel(PAPER, SplineBasis(n, 0.4)).rule, q, *rng.normal(size=(2, n, dof))


def across(rule, q, velocity, still, rate):
    """Generalised forces of -c |v_n| times what `rate` makes of the distance across the DLO."""
    dof = q.shape[1]
    axes = [0, 1] if dof == 2 else [0, 1, 2]
    result = np.zeros_like(q)
    for span, b, b1, weight in zip(rule.span, rule.b, rule.b1, rule.weight, strict=True):
        rows = slice(span, span + 4)
        tangent = b1 @ q[rows, axes]
        tangent /= np.linalg.norm(tangent)
        beside = np.eye(len(axes)) - np.outer(tangent, tangent)
        speed = np.linalg.norm(beside @ (b @ velocity[rows, axes]))
        away = b @ (q - still)[rows, axes]
        force = DRAG * speed * rate * weight * (beside @ away)
        result[rows, axes] += np.outer(b, force)
    return result


def test_springs_pull_against_the_motion_across_the_dlo_alone(moving):
    rule, q, velocity, still = moving
    gradient, band = np.zeros(q.size), np.zeros((q.size, 4 * q.shape[1]))
    add_springs(q, drag_springs(rule, DRAG, q, velocity, still, RATE), gradient, band)
    expected = across(rule, q, velocity, still, RATE)
    np.testing.assert_allclose(gradient.reshape(q.shape), expected, rtol=1e-10, atol=1e-12)


def test_their_tangent_is_that_of_their_force(moving):
    rule, q, velocity, still = moving
    springs, width = drag_springs(rule, DRAG, q, velocity, still, RATE), 4 * q.shape[1]
    gradient, band = np.zeros(q.size), np.zeros((q.size, width))
    add_springs(q, springs, gradient, band)
    matrix = np.zeros((q.size, q.size))
    for m in range(width):
        below = band[m:, width - 1 - m]
        matrix += np.diag(below, -m) + (np.diag(below, m) if m else 0.0)
    move = np.random.default_rng(7).normal(size=q.shape)
    moved = np.zeros(q.size)
    add_springs(q + move, springs, moved, np.zeros_like(band))
    np.testing.assert_allclose(moved - gradient, matrix @ move.ravel(), rtol=1e-9, atol=1e-9)


def test_a_dlo_at_rest_feels_none(moving):
    rule, q, velocity, still = moving
    springs = drag_springs(rule, DRAG, q, 0.0 * velocity, still, RATE)
    assert not springs.stiffness.any() and not springs.pull.any()
