# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Damping and weight that the parameter file only guesses, and what diagnosis makes of it."""

from dataclasses import replace

import numpy as np
import pytest
from challenge import draw

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.diagnosis import diagnose
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.parameters import Settings

pytestmark = pytest.mark.long


def guessing(settings):
    """The same file without what was measured beforehand."""
    return replace(
        settings,
        rod=replace(settings.rod, density_std=0.0),
        damping=replace(settings.damping, air_drag_std=0.0, relaxation_time_std=0.0),
    )


def recorded(folder, seed, kind, names=()):
    challenge = draw(seed, kind, names, recordings=2)
    bags = challenge.write(folder, edges=150, step=1e-3)
    settings = guessing(Settings.load(folder / "params.yaml"))
    return challenge, [load_manipulation(b, settings) for b in bags], settings


@pytest.fixture(scope="module")
def damped(tmp_path_factory):
    """A rope with nine times the damping inside that the file guesses."""
    return recorded(tmp_path_factory.mktemp("damped"), 3, "single", ("internal_damping",))


@pytest.mark.slow
def test_a_guess_is_known_to_a_factor(damped):
    """With a damping of up to nine times the guess a model is as it may be expected. As it is known
    better, it is told, and is a cause.
    """
    challenge, recordings, settings = damped
    found = diagnose(recordings, settings)
    assert found.verdict == "adequate"
    (effect,) = found.effects
    true = challenge.effects["internal_damping"]["relaxation_time"]
    assert effect.name == "internal_damping"
    assert effect.parameters["relaxation_time"].value == pytest.approx(true, rel=0.02)


@pytest.mark.slow
def test_a_wrong_guess_is_named_where_it_is_all_that_is_missing(damped):
    challenge, recordings, settings = damped
    third = settings.damping.relaxation_time / 3.0
    settings = replace(settings, damping=replace(settings.damping, relaxation_time=third))
    found = diagnose(recordings, settings)
    (effect,) = found.effects
    assert (found.verdict, effect.name, effect.rivals) == ("explained", "internal_damping", ())
    true = 2.0 * third + challenge.effects["internal_damping"]["relaxation_time"]
    assert effect.parameters["relaxation_time"].value == pytest.approx(true, rel=0.1)
    assert found.extended.settings.damping.relaxation_time == third  # the guess, and what is added


@pytest.mark.slow
def test_only_the_ratio_of_drag_and_weight_is_seen(tmp_path):
    """A drag that is missing is a rope that is too heavy, while nobody has weighed it."""
    _, recordings, settings = recorded(tmp_path, 3, "single", ("air_drag",))
    found = diagnose(recordings, settings)
    assert (found.verdict, found.effects) == ("adequate", ())
    assert found.extended.density[1] is None


@pytest.mark.slow
def test_what_is_open_stays_where_it_was_known_to_be(tmp_path):
    """E, mu and the drag scale together: the fit must not wander along what the data leave open."""
    _, recordings, settings = recorded(tmp_path, 2, "none")
    at = begin(recordings, settings).at
    rod = at.model.settings.rod
    assert abs(np.log(rod.density / settings.rod.density)) < 0.3
    fitted, given = at.model.settings.damping, settings.damping
    for name in ("air_drag", "relaxation_time"):
        assert abs(np.log(getattr(fitted, name) / getattr(given, name))) < 0.3, name


@pytest.mark.slow
def test_a_mass_is_known_no_better_than_the_rope(tmp_path):
    challenge, recordings, settings = recorded(tmp_path, 1, "single", ("point_mass",))
    found = diagnose(recordings, settings)
    (effect,) = found.effects
    true, mass = challenge.effects["point_mass"]["mass"], effect.parameters["mass"]
    assert effect.name == "point_mass"
    assert mass.std > 0.2 * mass.value
    assert abs(mass.value - true) < 2.5 * mass.std
