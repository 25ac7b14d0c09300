# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Distances of shapes without the slide along the DLO that measured points leave open."""

from types import SimpleNamespace

import numpy as np
import pytest

from dlo_ros.inference.err import shape_errors
from dlo_ros.inference.slide import slid
from dlo_ros.spline import SplineBasis

LENGTH = 0.4
BASIS = SplineBasis(10, LENGTH)


def arc(u):
    """Points of a DLO bent to a quarter of a circle, at material coordinates (m,), (m, 3)."""
    radius = LENGTH / (0.5 * np.pi)
    angle = u / radius
    return radius * np.column_stack([np.sin(angle), 0.0 * angle, np.cos(angle)])


def shape(slide, bulge=0.0):
    """Control points (1, n, 3) of the arc whose u is off by `slide`, a function of u / L."""
    u = np.linspace(0.0, LENGTH, 200)
    share = u / LENGTH
    points = arc(u + slide(share)) * (1.0 + bulge * np.sin(np.pi * share))[:, None]
    return BASIS.fit(u, points)[None]


def apart(names, observed, predicted):
    """The distances of a DLO that a command of these names holds."""
    manipulation = SimpleNamespace(commands=[SimpleNamespace(names=names)])
    recording = SimpleNamespace(manipulation=manipulation, observed=observed)
    return slid(recording, predicted, LENGTH)


@pytest.mark.parametrize(
    ("names", "left"),
    [
        (("start", "end"), 0.0),
        (("start",), 0.0),
        (("end",), 2.08e-3),  # the best multiple of u / L takes a part of it
        (("control_point_4",), 2.5e-3),
    ],
)
def test_a_clamp_that_is_elsewhere_slides_u_and_is_no_error(names, left):
    observed, predicted = shape(lambda share: 5e-3 * (1.0 - share)), shape(lambda share: 0.0)
    assert shape_errors(observed, predicted, BASIS)[0] == pytest.approx(2.5e-3, rel=0.02)
    found = apart(names, observed, predicted)
    assert found.err[0] == pytest.approx(left, abs=5e-5)
    assert np.sqrt(found.along_square) <= 1.3 * found.err[0] + 5e-5


def test_a_dlo_that_slips_out_of_its_grip_shows_at_its_tip():
    observed, predicted = shape(lambda share: 0.0 * share - 5e-3), shape(lambda share: 0.0)
    assert apart(("start",), observed, predicted).err[0] > 1e-3


def test_what_lies_across_stays():
    observed, predicted = shape(lambda share: 0.0 * share, bulge=0.02), shape(lambda share: 0.0)
    whole = shape_errors(observed, predicted, BASIS)[0]
    assert apart(("start", "end"), observed, predicted).err[0] == pytest.approx(whole, rel=0.05)
    several = np.concatenate([observed, predicted])
    both = apart(("start",), several, np.concatenate([predicted, predicted])).err
    assert both[0] > 10.0 * both[1] and both[1] < 1e-9


def test_the_distance_along_a_straight_dlo_is_told():
    straight = np.zeros((1, 10, 3))
    straight[0, :, 0] = BASIS.greville
    moved = straight + np.array([0.003, 0.0, 0.001])
    found = apart((), straight, moved)
    assert found.along_square == pytest.approx(0.003**2)
    assert found.err[0] == pytest.approx(np.hypot(0.003, 0.001))
