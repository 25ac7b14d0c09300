# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Damping and weight that the parameter file only guesses, and what diagnosis makes of it."""

from dataclasses import replace

import numpy as np
import pytest
from challenge import draw
from diagnosis_candidates import candidate

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.diagnosis import damping_selection, diagnose
from dlo_ros.diagnosis.fitting.initial_fit import begin
from dlo_ros.diagnosis.selection import verdict
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
    """A rope with more damping inside than the file guesses."""
    return recorded(tmp_path_factory.mktemp("damped"), 3, "single", ("internal_damping",))


@pytest.mark.slow
def test_a_wrong_guess_is_named_where_it_is_all_that_is_missing(damped):
    challenge, recordings, settings = damped
    found = diagnose(recordings, settings)
    (effect,) = found.effects
    assert (found.verdict, effect.name, effect.rivals) == ("explained", "internal_damping", ())
    true = challenge.effects["internal_damping"]["relaxation_time"]
    assert effect.parameters["relaxation_time"].value == pytest.approx(true, rel=0.1)
    assert found.extended.settings.damping == settings.damping  # the guess, and what is added
    assert found.gain.low > 0.0


@pytest.mark.slow
def test_only_the_ratio_of_drag_and_weight_is_seen(tmp_path):
    """A drag that is missing is a rope that is too heavy, while nobody has weighed it."""
    _, recordings, settings = recorded(tmp_path, 3, "single", ("air_drag",))
    found = diagnose(recordings, settings)
    assert (found.verdict, found.effects) == ("adequate", ())
    assert found.extended.density[1] > 0.2 * found.extended.density[0]


@pytest.mark.slow
def test_what_is_open_stays_where_it_was_known_to_be(tmp_path):
    """E, mu and the drag scale together: the fit must not wander along what the data leave open."""
    _, recordings, settings = recorded(tmp_path, 2, "none")
    at = begin(recordings, settings).at
    rod = at.model.settings.rod
    assert abs(np.log(rod.density / settings.rod.density)) < 0.3
    assert all(
        abs(np.log(g.fitted / g.given)) < 0.1 for g in damping_selection.wrong_guesses(at, settings)
    )


@pytest.mark.slow
def test_a_mass_is_known_no_better_than_the_rope(tmp_path):
    challenge, recordings, settings = recorded(tmp_path, 1, "single", ("point_mass",))
    found = diagnose(recordings, settings)
    (effect,) = found.effects
    true, mass = challenge.effects["point_mass"]["mass"], effect.parameters["mass"]
    assert effect.name == "point_mass"
    assert mass.std > 0.2 * mass.value
    assert abs(mass.value - true) < 2.5 * mass.std


@pytest.mark.slow
def test_models_with_the_guess_start_where_all_else_has_followed(damped):
    _, recordings, settings = damped
    at = begin(recordings, settings).at
    assert damping_selection.guessed(at.model, settings) == ("air_drag", "internal_damping")
    for model in damping_selection.with_guess(at, settings):
        assert model.settings.damping == settings.damping
        assert model.free == ("young_modulus", "density")
    fitted = at.model.settings.damping
    for model in damping_selection.with_guess(at, settings, ("internal_damping",)):
        assert model.settings.damping == settings.damping
        added = model.settings.effects["internal_damping"]["relaxation_time"]
        total = settings.damping.relaxation_time + added
        assert total == pytest.approx(fitted.relaxation_time, rel=0.1)
    known = replace(settings, damping=replace(settings.damping, air_drag_std=1e-3))
    assert damping_selection.guessed(at.model, known) == ("internal_damping",)


def held(correlated):
    """Candidates whose residuals are correlated, by their effects."""
    rng = np.random.default_rng(0)
    result = []
    for names, root_autocovariance in correlated.items():
        slow = root_autocovariance * np.sqrt(2.0) * np.sin(np.linspace(0.0, 20.0, 200))[:, None]
        residual = rng.normal(size=(200, 20)) + slow
        result.append(
            candidate(names.split("+"), root_autocovariance, root_autocovariance**2, [residual])
        )
    return result


@pytest.mark.parametrize(
    "left, named, rivals",
    [
        # Both together are hardly better than one, and the other alone is far behind.
        ((900.0, 400.0, 395.0), ["internal_damping"], [()]),
        # The other alone leaves not twice as much.
        ((500.0, 400.0, 395.0), ["internal_damping"], [("air_drag",)]),
        ((500.0, 400.0, 100.0), ["air_drag", "internal_damping"], [(), ()]),
    ],
)
def test_beside_what_nothing_explains_no_small_difference_names_a_damping(left, named, rivals):
    names = ("air_drag", "internal_damping", "air_drag+internal_damping")
    found = held(dict(zip(names, left, strict=True)))
    plain = candidate([], 2000.0, 4e6, [np.ones((200, 20))])
    decided = damping_selection.decided(found, plain, verdict.Decision("unexplained", None))
    assert list(decided.chosen.effects) == named and list(decided.rivals) == rivals
    assert decided.verdict == "unexplained"


def test_beside_something_certain_only_that_and_the_damping_are_named():
    """What is fitted beside it, and may be something else, is not."""
    names = ("point_mass+clamp_angle+air_drag", "point_mass+clamp_angle+internal_damping")
    found = held(dict(zip(names, (100.0, 900.0), strict=True)))
    chosen = candidate(["point_mass", "clamp_angle"], 2000.0, 4e6, [np.ones((200, 20))])
    sure = verdict.SufficientEffects(("point_mass",), chosen)
    before = verdict.Decision("unexplained", sure, (("constant_force",),))
    decided = damping_selection.decided(found, chosen, before)
    assert dict(zip(decided.chosen.effects, decided.rivals, strict=True)) == {
        "point_mass": ("constant_force",), "air_drag": (),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("with_it", "without", "told"),
    [(1.0, 2.0, True), (2.0, 1.0, False), (None, 1.0, False), (1.0, None, True)],
)
def test_a_damping_that_foretells_worse_alone_is_not_told(with_it, without, told):
    """Beside causes that nobody names it may be certain and still be of no use."""
    noise = [np.random.default_rng(8).normal(size=(60, 10))]
    plain, drag = candidate([], 9.0, 1e5, noise), candidate(["air_drag"], 8.0, 9e4, noise)
    decision = verdict.Decision(
        "unexplained", verdict.SufficientEffects(("air_drag",), drag), ((),)
    )
    errors = {id(plain): without, id(drag): with_it}
    assert damping_selection._holds(decision, plain, lambda c: errors[id(c)]) is told
