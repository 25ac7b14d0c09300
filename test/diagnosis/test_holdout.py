# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The plain model that the gain is measured against."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.diagnosis.findings import holdout
from dlo_ros.errors import SimulationError
from dlo_ros.identification.estimate import searchable
from dlo_ros.identification.material_model import material_model

MATERIAL_ERR, ERR = 1e-3, 1e-2
CREEPING = 5.0  # s, a relaxation time of no DLO
GUESS = PAPER.damping.relaxation_time


@pytest.fixture
def plain_fit(monkeypatch):
    """The plain model's fit: 1 cm off with any creeping, by a factor more with the guess."""

    def with_factor(factor, err=ERR):
        given = searchable(PAPER)
        creeping = replace(given, damping=replace(given.damping, relaxation_time=CREEPING))
        recordings = [SimpleNamespace(until=lambda stop: stop)]

        def fitted(model, chosen):
            assert chosen == [6]  # what is held out is not seen
            guessed = np.isclose(model.settings.damping.relaxation_time, GUESS)
            if guessed and factor is None:
                raise SimulationError("it cannot be simulated with the guess")
            return SimpleNamespace(model=model, mean_err=factor * err if guessed else err)

        monkeypatch.setattr(holdout, "fitted", fitted)
        seen = [np.arange(10) < 6]
        model = material_model(creeping, given)
        return holdout.fitted_to_seen(model, recordings, seen, MATERIAL_ERR).settings.damping

    return with_factor


def test_a_damping_that_brings_the_plain_model_little_nearer_keeps_its_guess(plain_fit):
    assert plain_fit(1.05).relaxation_time == pytest.approx(GUESS)


@pytest.mark.parametrize(
    ("factor", "err"),
    [(1.5, ERR), (1.05, 0.5 * MATERIAL_ERR), (None, ERR)],
    ids=["it brings it nearer", "nothing is left", "the guess cannot be simulated"],
)
def test_otherwise_it_is_fitted(plain_fit, factor, err):
    assert plain_fit(factor, err).relaxation_time == pytest.approx(CREEPING)
