# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How far another value of a number lies, by what it costs with all else fitted anew."""

from types import SimpleNamespace

import numpy as np
import pytest

from dlo_ros.diagnosis.explain import profile_loss
from dlo_ros.diagnosis.explain.profile_loss import Refit, refitted_loss
from dlo_ros.errors import SimulationError


@pytest.mark.parametrize(
    ("loss", "scatter", "least", "away"),
    [
        (8.0, 0.0, 0.0, 4.0),
        (8.0, 4.0, 0.0, 4.0),  # by chance as much as where one of the models is true
        (8.0, 8.0, 0.0, 2.0),  # bins disagree by twice as much
        (8.0, 40.0, 0.0, 1.0),  # nothing is told; the other one lies a std off at least
        (0.2, 0.1, 0.0, 1.0),
        (-3.0, 2.0, 0.0, 1.0),  # it explains more
        (3.0, 0.0, -5.0, 4.0),  # and a third one still more
        (np.inf, 0.0, -5.0, np.inf),
    ],
)
def test_a_number_lies_as_many_std_off_as_its_loss_is_more_than_chance(loss, scatter, least, away):
    assert Refit(loss, scatter).stds_away(least) == pytest.approx(away)


def test_the_std_of_a_number_whose_scores_scatter_is_that_of_the_sandwich():
    """A mean of numbers with three times the spread that the model believes."""
    rng = np.random.default_rng(3)
    data, shift = 3.0 * rng.normal(size=4000), 0.2
    data -= data.mean()
    differences = 0.5 * ((data - shift) ** 2 - data**2)  # of the log likelihood, bin by bin
    refit = Refit(differences.sum(), np.sqrt(len(data)) * differences.std())
    true = 3.0 / np.sqrt(len(data))
    assert shift / refit.stds_away() == pytest.approx(true, rel=0.05)


def test_what_cannot_be_simulated_costs_infinitely_much(monkeypatch):
    def refused(*_):
        raise SimulationError("no static equilibrium")

    at = SimpleNamespace()
    monkeypatch.setattr(profile_loss, "borrowed", refused)
    assert refitted_loss(at, object(), ()) == Refit(np.inf, 0.0)
    monkeypatch.setattr(profile_loss, "borrowed", lambda *_: object())
    monkeypatch.setattr(profile_loss, "fit", lambda *_, **__: "there")
    monkeypatch.setattr(profile_loss, "misfit", lambda e, _: 7.0 if e == "there" else 4.0)
    monkeypatch.setattr(profile_loss, "evidence_std", lambda *_: 2.0)
    assert refitted_loss(at, object(), ()) == Refit(3.0, 2.0)
