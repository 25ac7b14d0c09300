# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Losses of fits: their normal equations against dense answers and differences."""

from dataclasses import replace

import numpy as np
import pytest
from experiment_recordings import fitted_set_up

from dlo_ros.inference.joint import judged, moved
from dlo_ros.inference.losses import CORRELATED, WHITE, RobustLoss, WhiteLoss, misfit


@pytest.fixture(scope="module")
def fitted():
    return fitted_set_up()


def noise_of(at):
    return [np.linspace(1e-4, 3e-4, r.shape[1]) for r, _ in at.fields]


def stepped(at, step):
    """The evaluation where a step leads, as if the model were linear."""
    return replace(judged(replace(at, fields=moved(at.fields, step))), variances=at.variances)


@pytest.mark.parametrize("weighed", [False, True])
def test_white_noise_leads_to_the_least_squares_answer(fitted, weighed):
    at, _ = fitted
    noise = noise_of(at) if weighed else None
    size = len(at.model.parameters)
    units = noise or [np.ones(r.shape[1]) for r, _ in at.fields]
    fields = [(r / n, j / n) for (r, j), n in zip(at.fields, units, strict=True)]
    rows = np.concatenate([j.transpose(0, 2, 1).reshape(-1, size) for _, j in fields])
    left = np.concatenate([r.ravel() for r, _ in fields])
    hessian, gradient = WhiteLoss(noise).normal_equations(at)
    variance = np.mean(left**2)
    assert hessian == pytest.approx(rows.T @ rows / variance, rel=1e-6)
    assert gradient == pytest.approx(rows.T @ left / variance, rel=1e-6, abs=1e-9)
    assert WhiteLoss(noise).value(at, at) == pytest.approx(0.5 * len(left))


@pytest.mark.parametrize("redescending", [False, True])
@pytest.mark.parametrize("kind", ["correlated", "white", "robust"])
def test_the_gradient_is_that_of_the_loss(fitted, kind, redescending):
    at, _ = fitted
    robust = RobustLoss(noise_of(at), 2.0, redescending)
    loss = {"correlated": CORRELATED, "white": WHITE, "robust": robust}[kind]
    _, gradient = loss.normal_equations(at)
    for k, p in enumerate(at.model.parameters[:3]):
        step = 1e-3 * p.step * at.model.axis(p.name)
        there, back = (loss.value(stepped(at, sign * step), at) for sign in (1.0, -1.0))
        assert (back - there) / (2.0 * step[k]) == pytest.approx(gradient[k], rel=1e-3, abs=1e-3)


def test_an_outlier_weighs_less_and_one_that_is_far_off_nothing(fitted):
    at, _ = fitted
    (residual, jacobian), *others = at.fields
    wild = residual.copy()
    wild[3] += 1e3
    spoilt = replace(at, fields=((wild, jacobian), *others))
    for loss, most in ((RobustLoss(noise_of(at), 3.0), 40.0), (WHITE, np.inf)):
        assert loss.value(spoilt, at) - loss.value(at, at) < most * 9.0 * residual.shape[1]
    none = RobustLoss(noise_of(at), 3.0, redescending=True)
    _, without = none.normal_equations(spoilt)
    kept = np.arange(len(residual)) != 3
    rest = replace(at, fields=((residual[kept], jacobian[kept]), *others))
    assert without == pytest.approx(none.normal_equations(rest)[1], rel=1e-3, abs=1e-6)
    assert none.of_pictures(spoilt) - none.of_pictures(rest) == pytest.approx(1.0, abs=1e-3)


def test_the_prior_counts_in_the_misfit(fitted):
    at, _ = fitted
    prior = 0.5 * float(at.model.precision() @ at.model.offset() ** 2)
    assert misfit(at, at, WHITE) == pytest.approx(WHITE.value(at, at) + prior)
    assert misfit(at, at) == pytest.approx(CORRELATED.value(at, at) + prior)
