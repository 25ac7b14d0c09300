# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Losses of fits: their normal equations against dense answers and differences."""

from dataclasses import replace

import numpy as np
import pytest
from experiment_recordings import fitted_set_up

from dlo_ros.inference.joint import judged, moved
from dlo_ros.inference.losses import CORRELATED, WHITE, WhiteLoss, independent, misfit
from dlo_ros.inference.spectrum import spectrum


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
    count = independent(at.spectra)
    weight = count / np.sum(left**2)
    assert hessian == pytest.approx(weight * rows.T @ rows, rel=1e-6)
    assert gradient == pytest.approx(weight * rows.T @ left, rel=1e-6, abs=1e-9)
    assert WhiteLoss(noise).value(at, at) == pytest.approx(0.5 * count)


def test_residuals_count_as_far_as_they_are_independent():
    """All of white noise, and a few of a model that misses a slow swing."""
    rng = np.random.default_rng(2)
    n, frames = 10, 200
    nothing = np.zeros((frames, 1, 2 * n))
    white = rng.normal(size=(frames, 2 * n))
    slow = np.sin(0.1 * np.arange(frames))[:, None] * np.linspace(0.0, 1.0, 2 * n)
    everything, few = (independent([spectrum(r, nothing, n)]) for r in (white, slow))
    assert everything == pytest.approx(white.size, rel=0.1)
    assert few < 0.02 * white.size
    assert independent([spectrum(3.0 * slow, nothing, n)]) == pytest.approx(few)


@pytest.mark.parametrize("loss", [CORRELATED, WHITE])
def test_the_gradient_is_that_of_the_loss(fitted, loss):
    at, _ = fitted
    _, gradient = loss.normal_equations(at)
    for k, p in enumerate(at.model.parameters[:3]):
        step = 1e-3 * p.step * at.model.axis(p.name)
        there, back = (loss.value(stepped(at, sign * step), at) for sign in (1.0, -1.0))
        assert (back - there) / (2.0 * step[k]) == pytest.approx(gradient[k], rel=1e-3, abs=1e-3)


def test_the_prior_counts_in_the_misfit(fitted):
    at, _ = fitted
    prior = 0.5 * float(at.model.precision() @ at.model.offset() ** 2)
    assert misfit(at, at, WHITE) == pytest.approx(WHITE.value(at, at) + prior)
    assert misfit(at, at) == pytest.approx(CORRELATED.value(at, at) + prior)
