# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Two wrong models are told apart where one is better by more than chance."""

from types import SimpleNamespace

import numpy as np
import pytest

from dlo_ros.inference.model_comparison import evidence_std, tells_apart

BINS, COUNT = 200, 8


def model(sums, variance=1.0, worse=0.0):
    """A fit of one recording, by the sum of squares in each bin."""
    bins = SimpleNamespace(count=np.full(BINS, COUNT), sum_of_squares=np.asarray(sums))
    v = SimpleNamespace(of=lambda _: np.full(BINS, variance))
    log = -0.5 * float(np.sum(sums) / variance + BINS * COUNT * np.log(variance)) - worse
    return SimpleNamespace(
        spectra=(bins,), variances=(v,), posterior=SimpleNamespace(evidence=log)
    )  # fmt: skip


@pytest.mark.parametrize(("better_by", "apart"), [(0.0, False), (1.0, False), (8.0, True)])
def test_models_that_win_here_and_lose_there_are_not_told_apart(better_by, apart):
    """One is better by so many standard deviations of a sum of random numbers."""
    rng = np.random.default_rng(1)
    sums, swaps = rng.chisquare(COUNT, BINS), 3.0 * rng.normal(size=BINS)
    swaps -= swaps.mean()
    std = 0.5 * np.sqrt(np.sum(swaps**2))
    one, other = model(sums), model(sums + swaps + 2.0 * better_by * std / BINS)
    assert evidence_std(one, other) == pytest.approx(std)
    assert tells_apart(one, other) is apart
    assert not tells_apart(other, one)


@pytest.mark.parametrize(("worse", "apart"), [(2.9, False), (3.1, True)])
def test_of_models_that_miss_alike_strong_evidence_decides(worse, apart):
    """One needs so much more freedom: Bayes factors of 20 to 1 are strong."""
    sums = np.full(BINS, COUNT)
    assert evidence_std(model(sums), model(sums, worse=worse)) == 0.0
    assert tells_apart(model(sums), model(sums, worse=worse)) is apart


def test_likelihoods_hold_the_errors_that_each_model_has_for_its_own():
    """A model that misses twice as much claims errors as large: each bin likes it less."""
    near, far = model(np.full(BINS, COUNT)), model(np.full(BINS, 4.0 * COUNT), 4.0)
    assert tells_apart(near, far)
    assert evidence_std(near, far) == pytest.approx(0.0, abs=1e-9)
