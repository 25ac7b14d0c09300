# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A motion that several values of E come near to: none of them is a cause."""

import pytest
from challenge import draw

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.diagnosis import diagnose
from dlo_ros.identification.offline import initial_fit
from dlo_ros.parameters import Settings

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def overhead(tmp_path_factory):
    """A plain rope that swings over its grip, and is guessed too stiff."""
    folder = tmp_path_factory.mktemp("overhead")
    bags = draw(6002, "none").write(folder, edges=150, step=1e-3)
    settings = Settings.load(folder / "params.yaml")
    return [load_manipulation(b, settings) for b in bags], settings


def test_the_fit_begins_in_the_right_valley(overhead):
    recordings, settings = overhead
    found = diagnose(recordings, settings)
    assert (found.verdict, found.effects) == ("adequate", ())
    assert found.baseline.err_train < 1.2 * found.noise_floor


def test_an_effect_that_does_nothing_leads_back_to_the_plain_model(overhead, monkeypatch):
    recordings, settings = overhead
    monkeypatch.setattr(initial_fit, "VALLEYS", 0)
    astray = initial_fit.begin(recordings, settings)
    assert max(e.mean() for e in astray.at.err) > 0.03
    found = diagnose(recordings, settings)
    assert (found.verdict, found.effects) == ("adequate", ())
    assert found.baseline.err_train < 1.2 * found.noise_floor
