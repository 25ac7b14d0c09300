# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Everything that the joint model has fitted is told: as material, as a cause, or in the table."""

from dataclasses import replace

import numpy as np
import pytest
from experiment_recordings import moving

from dlo_ros.diagnosis.explain.cause_naming import Cause
from dlo_ros.diagnosis.explain.certainty import SCALES
from dlo_ros.diagnosis.explain.trials import fitted
from dlo_ros.diagnosis.findings.diagnosis_outcome import SetupNumber
from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.diagnosis.findings.joint_numbers import (
    _mean_number,
    at_guessed_scale,
    effect_numbers,
    fitted_material,
    outer_stds,
    reported_covariance,
    set_up_numbers,
)
from dlo_ros.diagnosis.findings.least_std import least_std
from dlo_ros.diagnosis.proposals.linear_evidence import proposal_of, with_proposals
from dlo_ros.effects import starts
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.inference.plain_rod import instead_of_plain

DRAG, INNER = "air_drag.coefficient", "internal_damping.relaxation_time"
TRUE_DRAG = 0.06
"""Of the rod that is recorded [N s/m^2]; the parameter file guesses a third of it."""
TRUE_DENSITY = 2500.0  # kg/m^3


@pytest.fixture(scope="module")
def begun():
    """The plain model fitted to a swing with more drag than the file guesses, and the file."""
    recording, guess = moving("simple", {"air_drag": {"coefficient": TRUE_DRAG}}, 31)
    own = guess.damping.air_drag
    given = replace(guess, damping=replace(guess.damping, air_drag=(TRUE_DRAG + own) / 3.0))
    return begin([recording], given), given


@pytest.fixture(scope="module")
def draughty(begun):
    """The set-up fitted to it, the file, and the true drag [N s/m^2]."""
    beginning, given = begun
    own = 3.0 * given.damping.air_drag - TRUE_DRAG
    training = training_set(beginning, 1, beginning.at.model.settings, given)
    return training.prepared, given, TRUE_DRAG + own


def weighed(at, std):
    """A fit to the same data of a DLO whose density is known to a relative standard deviation."""
    parameters = tuple(
        replace(p, guessed=False, std=std) if p.name == "density" else p
        for p in at.model.parameters
    )
    return replace(at, model=replace(at.model, parameters=parameters))


def test_a_number_is_known_no_better_than_what_may_act_beside_it(draughty):
    prepared, given, _ = draughty
    angle = "effects.clamp_angle.start"
    # Doubts go by the names of parameters; those of the report are others.
    before, doubt = set_up_numbers(prepared.setup, (), given), [{angle: 0.2, INNER: 9.0}]
    told = set_up_numbers(prepared.setup, (), given, doubt)
    known = before.pop("clamp_angle.start").std
    assert told.pop("clamp_angle.start").std == pytest.approx((known**2 + 0.2**2) ** 0.5)
    assert told == before
    model = prepared.setup.model
    more = reported_covariance(prepared.setup, None, doubt) - reported_covariance(prepared.setup)
    assert np.allclose(more, 0.2**2 * np.outer(model.axis(angle), model.axis(angle)))
    number = effect_numbers("clamp_angle", prepared.setup, given, {angle: 2.0}, doubt)["start"]
    assert number.std == pytest.approx(((2.0 * known) ** 2 + 0.2**2) ** 0.5, rel=0.05)


def test_what_may_act_changes_numbers_together(draughty):
    """A force is known as a share of E, where both are larger by a fifth with something beside."""
    at, modulus, density = draughty[0].setup, "young_modulus", "density"
    axis = at.model.axis(modulus) - at.model.axis(density)
    alone = reported_covariance(at)

    def more(*doubts):
        return axis @ (reported_covariance(at, None, doubts) - alone) @ axis

    assert more({modulus: 0.2, density: 0.2}) == pytest.approx(0.0, abs=1e-9)
    assert more({modulus: 0.2}, {density: 0.2}) == pytest.approx(2.0 * 0.2**2)


def test_a_guessed_drag_is_told_with_its_std_and_has_no_tolerance(draughty):
    prepared, given, true = draughty
    told = set_up_numbers(prepared.setup, (), given)
    drag = told[DRAG]
    assert drag.tolerance is None and drag.unit == "N s/m^2"
    # Shapes tell its ratio to the density, of which the file has a guess that is too small.
    fitted_to = prepared.setup.model.settings
    off = true * fitted_to.rod.density / TRUE_DENSITY - given.damping.air_drag
    assert drag.std is None
    assert drag.held_std < 0.5 * off and abs(drag.value - off) < 4.0 * drag.held_std
    known = set_up_numbers(weighed(prepared.setup, 0.05), (), given)[DRAG]
    whole = fitted_to.damping.air_drag
    expected = ((drag.held_std / whole) ** 2 + 0.05**2) ** 0.5 * whole
    assert known.std == pytest.approx(expected, rel=0.05) and known.held_std is None
    assert drag.value == pytest.approx(
        prepared.setup.model.settings.damping.air_drag - given.damping.air_drag
    )
    assert INNER in told
    # All but E and mu, each once.
    assert len(told) == len(prepared.setup.model.parameters) - 2


def test_a_drag_that_is_a_cause_is_not_told_twice(draughty):
    prepared, given, _ = draughty
    cause = Cause("air_drag", ("air_drag",), {}, 9.0, 1e-3, 0.0)
    told = set_up_numbers(prepared.setup, (cause,), given)
    assert DRAG not in told and INNER in told


def test_a_drag_that_is_known_has_the_tolerance_that_is_stated(draughty):
    prepared, given, _ = draughty
    std = 0.3 * given.damping.air_drag
    parameters = tuple(
        replace(p, guessed=False, std=0.3) if p.name == "air_drag" else p
        for p in prepared.setup.model.parameters
    )
    at = replace(prepared.setup, model=replace(prepared.setup.model, parameters=parameters))
    assert set_up_numbers(at, (), given)[DRAG].tolerance == pytest.approx(std)


def test_what_the_data_do_not_determine_has_no_std(draughty):
    prepared, given, _ = draughty
    blind = tuple(
        replace(s, gradient=0.0 * s.gradient, hessian=0.0 * s.hessian)
        for s in prepared.setup.spectra
    )
    told = set_up_numbers(replace(prepared.setup, spectra=blind), (), given)
    assert told[DRAG].std is None and told[DRAG].held_std is None
    assert told["clamp_angle.start"].std is not None


def test_an_effect_that_is_no_certain_cause_is_told_too(draughty):
    prepared, given, _ = draughty
    start = next(s for s in starts(prepared.scene) if s.effect == "quadratic_drag")
    proposal = proposal_of(prepared.setup.model.settings, start)
    model, _ = with_proposals(prepared.setup.model, [proposal])
    told = set_up_numbers(fitted(model, prepared.recordings), (), given)
    added = told["quadratic_drag.coefficient"]
    assert added.tolerance is None and added.std > 0.0


def test_a_number_of_a_law_is_known_no_better_than_laws_are(draughty):
    prepared, given, _ = draughty
    start = next(s for s in starts(prepared.scene) if s.effect == "quadratic_drag")
    proposal = proposal_of(prepared.setup.model.settings, start)
    model, (name,) = with_proposals(weighed(prepared.setup, 0.01).model, [proposal])
    at = fitted(model, prepared.recordings)
    told = effect_numbers("quadratic_drag", at, given)["coefficient"]
    least = least_std("quadratic_drag", "coefficient", told.value, given.rod)
    by_shapes = outer_stds(at)[at.model.index(name)]
    assert told.std == pytest.approx(np.hypot(by_shapes, least))
    table = set_up_numbers(at, (), given)
    assert table["quadratic_drag.coefficient"].std >= least
    tilt, known = "gravity_tilt.angle", np.sqrt(np.diag(reported_covariance(at)))
    assert table[tilt].std == pytest.approx(known[at.model.index(f"effects.{tilt}")])


def test_a_scale_of_all_forces_that_nothing_tells_is_that_of_the_guesses(draughty):
    """However far the size that a cause mostly has leads the fit away from them."""
    prepared, _, _ = draughty
    at = prepared.setup
    theta = at.model.theta()
    for name in ("young_modulus", "density", "air_drag"):
        theta[at.model.index(name)] -= 1.2
    away = replace(at, model=at.model.at(theta))
    here, there = (at_guessed_scale(e).model.settings for e in (at, away))
    assert there.rod.density == pytest.approx(here.rod.density, rel=1e-6)
    assert there.rod.specific_modulus == pytest.approx(
        at.model.settings.rod.specific_modulus, rel=1e-9
    )
    assert abs(here.rod.density / at.model.parameters[1].outer(at.model.parameters[1].centre) - 1
               ) < 0.5  # fmt: skip
    told = fitted_material(away, None, None)
    assert told.young_modulus[1] is told.density[1] is None
    assert told.specific_modulus[1] is not None
    drag = away.model.index("air_drag")
    assert 0.3 < outer_stds(away)[drag] / away.model.settings.damping.air_drag < 1.0
    known = weighed(away, 0.05)
    assert at_guessed_scale(known) is known


@pytest.fixture(scope="module")
def slowed():
    """A fit with a drag of the square of speed to a swing that has one, and the number of that."""
    recording, given = moving("simple", {"quadratic_drag": {"coefficient": 0.5}}, 32)
    begun = begin([recording], given)
    prepared = training_set(begun, 1, begun.at.model.settings, given).prepared
    begins = instead_of_plain(prepared.setup.model, starts(prepared.scene))
    model = next(m for start, m in begins if start.effect == "quadratic_drag")
    at = fitted(model, prepared.recordings)
    return at, at.model.index("effects.quadratic_drag.coefficient")


@pytest.mark.slow
def test_at_another_scale_of_forces_each_is_known_as_well_as_before(slowed):
    """A linear number goes with that scale, and so do its std and the derivatives by it."""
    at, k = slowed
    assert not at.model.parameters[k].logarithmic

    def relative(at):
        return outer_stds(at)[k] / at.model.settings.effects["quadratic_drag"]["coefficient"]

    density = at.model.index("density")
    heavier = replace(
        at.model.parameters[density], centre=at.model.parameters[density].centre + 1.5
    )
    far = replace(at, model=at.model.with_prior([heavier]))
    here, there = at_guessed_scale(at), at_guessed_scale(far)
    assert there.model.settings.rod.density > 2.0 * here.model.settings.rod.density
    assert relative(here) < 1.5  # it is told, beside a linear drag that does part of its work
    assert relative(there) == pytest.approx(relative(here), rel=0.02)


def test_a_cause_is_as_certain_beside_a_rival_on_a_lighter_dlo(slowed):
    """Nothing tells its weight: with the rival it is half as heavy, and all forces with it."""
    at, k = slowed
    scales = [at.model.index(name) for name in SCALES]

    def std_at_a_scale(doubts=()):
        chosen = np.ix_([k, *scales], [k, *scales])
        return np.linalg.inv(reported_covariance(at, None, doubts)[chosen])[0, 0] ** -0.5

    lighter = dict.fromkeys(SCALES, np.log(0.5))
    assert std_at_a_scale([lighter]) == pytest.approx(std_at_a_scale(), rel=0.01)
    # A rival beside which that force is as large on the lighter DLO would make it doubtful.
    assert std_at_a_scale([{**lighter, at.model.names[k]: 0.0}]) > 1.2 * std_at_a_scale()


def test_how_well_the_scale_is_known_is_told_beside_the_numbers_that_contain_it(slowed):
    """Forces at a grip tell the scale: what else is not known of a number stays."""
    at = at_guessed_scale(slowed[0])
    spread = outer_stds(at)[at.model.index("density")] / at.model.settings.rod.density
    assert fitted_material(at, None, None).scale_std == pytest.approx(spread, rel=1e-6)


@pytest.mark.parametrize("known", [True, False])
def test_a_moment_that_recordings_have_of_their_own_is_told_by_its_mean(known):
    numbers = [
        SetupNumber(value, std if known else None, None, "s", None if known else std)
        for value, std in ((-0.1, 0.02), (0.1, 0.04))
    ]
    told = _mean_number(numbers)
    assert told.value == 0.0
    std, other = (told.std, told.held_std) if known else (told.held_std, told.std)
    assert std == pytest.approx(np.sqrt(0.1**2 + 0.01**2 + 0.02**2)) and other is None
