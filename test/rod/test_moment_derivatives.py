# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Derivatives of inelastic moments at a point, against differences of the moments themselves."""

import numpy as np
import pytest

from dlo_ros.rod.elements import constitutive_law
from dlo_ros.rod.elements import moment_derivatives as written
from dlo_ros.rod.elements.rod_tables import ConstitutiveLaw, InternalVariables

STEP, CLOSE = 1e-5, 1e-8
LINEAR = np.inf
bending_moment = constitutive_law.bending_moment.py_func  # which only compiled code calls
yield_centre = constitutive_law.yield_centre.py_func
hysteresis_moment = constitutive_law.hysteresis_moment.py_func


def law(half, yielding, hardening, turn=np.inf):
    half, yielding, turn = (np.array([x]) for x in (half, yielding, turn))
    return ConstitutiveLaw(1.0, half, yielding, hardening, 0.0, 1.0, 1.0, turn)


def slopes(function, at):
    """Central differences of a pair of numbers by all they depend on, shape (2, K)."""
    columns = []
    for k in range(len(at)):
        sides = []
        for d in (STEP, -STEP):
            there = np.array(at, dtype=np.float64)
            there[k] += d
            sides.append(np.array(function(*there)[:2]))
        columns.append((sides[0] - sides[1]) / (2.0 * STEP))
    return np.array(columns).T


def written_out(stiff, x, centre, inner, one):
    """`MomentDerivatives` of one point whose rest curvature is 0."""
    internal = InternalVariables(np.array([centre]), np.zeros((0, 2)), np.array([inner]))
    return written.moment_derivatives(
        np.array([[*x, 0.0]]), np.array([[*stiff, 0.0]]), np.zeros((1, 2)), internal, one
    )


@pytest.mark.parametrize("x", [(0.4, 0.0), (0.5, -0.3), (3.0, 1.0), (-2.0, 2.5)])
@pytest.mark.parametrize("yielding", [1.5, 100.0], ids=["yields", "elastic"])
@pytest.mark.parametrize("hardening", [0.0, 0.4, 1.0])
def test_moment_and_middle_of_the_elastic_range(x, yielding, hardening):
    stiff, centre, half = (0.7, 1.1), (0.2, -0.1), 1.3
    one = law(half, yielding, hardening)
    found = written_out(stiff, x, centre, np.zeros(6), one)
    np.testing.assert_allclose(
        found.yield_centre[0],
        slopes(yield_centre, (*x, *centre, yielding)),
        atol=CLOSE,
    )
    np.testing.assert_allclose(
        found.moment[0, :, :9],
        slopes(
            lambda s, t, a, b, c, d, y, h, w: bending_moment(s, t, a, b, c, d, w, y, h),
            (*stiff, *x, *centre, yielding, hardening, half),
        ),
        atol=CLOSE,
    )
    moment = bending_moment(*stiff, *x, *centre, half, yielding, hardening)[:2]
    np.testing.assert_allclose(found.moment[0, :, 9], moment, rtol=1e-12)


def test_moment_that_never_softens_has_no_derivative_by_the_softening():
    found = written_out((0.7, 1.1), (3.0, 1.0), (0.2, -0.1), np.zeros(6), law(LINEAR, 1.5, 0.4))
    assert np.isfinite(found.moment).all()
    assert not found.moment[0, :, 8].any()


@pytest.mark.parametrize("change", [(0.4, 0.0), (0.5, -0.3), (-3.0, 1.0)])
def test_internal_friction(change):
    before, turn, start = (0.3, -0.5), 0.8, (0.1, 0.2)
    inner = np.array([0.0, 0.0, *before, *start])
    x = np.add(start, change)
    found = written_out((0.7, 1.1), x, (0.0, 0.0), inner, law(1.0, 1.0, 0.0, turn))
    np.testing.assert_allclose(
        found.slide[0, :, :5], slopes(hysteresis_moment, (*change, *before, turn)), atol=CLOSE
    )
    np.testing.assert_allclose(found.slide[0, :, 5], hysteresis_moment(*change, *before, turn)[:2])
