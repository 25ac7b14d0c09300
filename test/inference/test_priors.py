# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Priors whose tolerance may not hold."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER
from scipy.optimize import approx_fprime
from scipy.stats import norm

from dlo_ros.effects import Scene, Start, effects
from dlo_ros.inference.parameter import SLAB, Parameter
from dlo_ros.inference.priors import cause_priors, joint_model, uncertain, with_tails

SHARE, STD = 0.05, 0.4
COILED = Parameter("effects.x.y", "1/m", False, -9.0, 9.0, 0.1, STD, tolerated=True, beyond=SHARE)


def density(value):
    within, wide = (norm.pdf(value, COILED.centre, s) for s in (STD, SLAB * STD))
    return (1.0 - SHARE) * within + SHARE * wide


@pytest.mark.parametrize("off", [0.0, 0.3, 1.2, 1.5, 6.0])
def test_a_prior_that_may_not_hold_is_a_mixture(off):
    value = COILED.centre + off
    expected = np.log(density(COILED.centre) / density(value))
    assert COILED.surprise(value) == pytest.approx(expected, abs=1e-12)
    slope = approx_fprime([value], lambda x: COILED.surprise(x[0]), 1e-7)[0]
    assert COILED.precision(value) * off == pytest.approx(slope, rel=1e-5, abs=1e-5)


def test_far_out_it_is_as_wide_as_that_of_a_cause():
    far = COILED.centre + 10.0 * STD
    assert COILED.precision(far) == pytest.approx((SLAB * STD) ** -2, rel=1e-6)
    assert COILED.surprise(far) < 0.2 * replace(COILED, beyond=0.0).surprise(far)
    assert COILED.widened().std == SLAB * STD and not COILED.widened().beyond
    usual = replace(COILED, beyond=0.0)
    assert usual.widened() == usual
    assert usual.precision(far) == pytest.approx(STD**-2)
    assert usual.surprise(far) == pytest.approx(50.0)


def test_a_coil_is_beyond_tolerance_more_often_than_a_clamp():
    scene = Scene(PAPER.scale, ("start",), ("start",), 0.0)
    model = joint_model(PAPER, PAPER, scene)
    assert not any(p.beyond for p in model.parameters)
    tails = {p.effect for p in with_tails(model, PAPER).parameters if p.beyond}
    assert tails == {"intrinsic_curvature"}
    stated = replace(PAPER, tolerances={"intrinsic_curvature.curvature": 2.0})
    assert not any(p.beyond for p in with_tails(model, stated).parameters)


def test_the_prior_of_a_size_of_something_is_as_wide_as_where_it_is_looked_for():
    """A fit sees its logarithm."""
    start = Start("obstacle", {"x": 0.1, "z": -0.1, "radius": 0.01}, (), ("x", "z", "radius"))
    radius = {p.key: p for p in cause_priors(PAPER, start)[0]}["radius"]
    (q,) = (q for q in effects()["obstacle"].quantities() if q.name == "radius")
    ends = np.log(q.search_for(PAPER.scale))
    assert radius.centre == pytest.approx(ends.mean())
    assert radius.std == pytest.approx(np.ptp(ends) / np.sqrt(12.0))
    assert max(radius.surprise(x) for x in ends) < 2.0


def test_a_stated_std_of_a_time_is_relative_where_a_fit_sees_its_logarithm():
    block = {"length": 0.01, "onset": 0.5, "duration": 0.2}
    given = replace(PAPER, tolerances={"clamp_slip.duration": 0.05})
    start = Start("clamp_slip", block, (), ("duration",))
    ((duration,), _) = cause_priors(given, start)
    neutral = next(q for q in effects()["clamp_slip"].quantities() if q.name == "duration").neutral
    assert duration.std == pytest.approx(SLAB * 0.05 / neutral)
    (known,) = uncertain(given.with_effects({"clamp_slip": block}))
    assert known.std == pytest.approx(0.05 / 0.2)
