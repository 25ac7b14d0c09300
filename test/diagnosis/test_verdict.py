# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The verdict: rivals, what is certain, explanations that must hold on held-out data."""

import numpy as np
import pytest
from diagnosis_candidates import candidate

from dlo_ros.diagnosis.selection import verdict

pytestmark = pytest.mark.long


def test_names_stand_beside_their_rivals():
    rng = np.random.default_rng(4)
    noise = [rng.normal(size=(60, 10))]
    slow = np.sin(np.linspace(0.0, 6.0, 60))[:, None]
    best = candidate(["gravity_tilt"], 0.1, 10.0, noise)
    alike = candidate(["constant_force"], 0.12, 11.0, [noise[0] + 0.01 * slow])
    worse = candidate(["clamp_angle"], 0.7, 900.0, [noise[0] + 1.0 * slow])
    wrong = candidate(["obstacle"], 4.0, 5000.0, [noise[0] + 6.0 * slow])
    found = verdict.explanations([wrong, worse, alike, best], verdict.limit(20.0))
    assert [e.effects for e in found] == [("gravity_tilt",), ("constant_force",), ("clamp_angle",)]
    decision = verdict.choose(found)
    assert decision.verdict == "explained"
    assert decision.rivals == (("constant_force",),)


def test_an_explanation_must_hold_on_held_out_data():
    noise = [np.random.default_rng(6).normal(size=(60, 10))]
    first = verdict.SufficientEffects(("obstacle",), candidate(["obstacle"], 0.1, 1.0, noise))
    second = verdict.SufficientEffects(("point_mass",), candidate(["point_mass"], 0.2, 2.0, noise))
    errors = {"obstacle": 5e-3, "point_mass": 1e-3}

    def holdout_err(c):
        return errors[c.effect]

    assert verdict.confirmed([first, second], 5e-3, holdout_err) == [second]
    assert verdict.confirmed([first], 1e-3, holdout_err) == []  # worse than without it
    assert verdict.confirmed([first], 5e-3, holdout_err) == [first]  # it does not show there
    assert verdict.confirmed([first], None, lambda c: None) == []


def test_rivals_of_a_pair_take_the_place_of_one():
    noise = [np.random.default_rng(5).normal(size=(60, 10))]
    best = candidate(["point_mass", "command_delay"], 0.1, 10.0, noise)
    other = candidate(["point_mass", "internal_damping"], 0.1, 11.0, noise)
    far = candidate(["obstacle", "plasticity"], 0.1, 12.0, noise)
    found = verdict.explanations([best, other, far], 0.9)
    assert verdict.choose(found).rivals == ((), ("internal_damping",))


def missing(**errors):
    """Candidates by the effects that they have, with ERR in the fit and on held-out data."""
    noise = [np.random.default_rng(7).normal(size=(60, 10))]
    return [
        candidate(names.split("_and_") if names != "plain" else [], 1e3 * e, 1e6 * e, noise, e)
        for names, e in errors.items()
    ]


def test_sure_is_what_nothing_can_do_without():
    plain, *rest = missing(plain=9e-3, mass_and_drag=1e-3, mass=1.5e-3, drag=8e-3)

    def holdout_err(c):
        return c.at.err[0][0]

    found, rivals = verdict.sure(plain, rest, holdout_err)
    assert found.effects == ("mass",) and rivals == ((),)
    assert found.candidate is rest[0]  # its numbers from where everything fits best
    # A model without it that comes near is a rival; too many rivals, and nothing is certain.
    beside = [*rest, *missing(tilt_and_drag=2e-3, tilt=2.2e-3)]
    found, rivals = verdict.sure(plain, beside, holdout_err)
    assert found.effects == ("mass",) and rivals == (("tilt",),)
    assert verdict.sure(plain, [*beside, *missing(peg=2e-3, slip=2e-3)], holdout_err) is None
    # The other effect of the best alone does nearly as well: no name for the first.
    assert verdict.sure(plain, [*rest[:2], *missing(drag=2e-3)], holdout_err) is None
    # On held-out data nothing else is excluded.
    assert verdict.sure(plain, rest, lambda c: 1e-3) is None
    far = missing(mass=8e-3)
    assert verdict.sure(plain, far, holdout_err) is None


def test_few_pictures_exclude_no_explanation_that_foretells_as_well():
    rng = np.random.default_rng(8)
    few, many = [rng.normal(size=(2, 20))], [rng.normal(size=(200, 20))]
    errors = {0.6: 4e-3, 1.2: 4.2e-3, 1.6: 9e-3}

    def holdout_err(c):
        return errors[c.root_autocovariance]

    for pictures, expected in ((few, [("gravity_tilt",)]), (many, [])):
        best = candidate(["intrinsic_curvature"], 0.6, 100.0, pictures)
        alike = candidate(["gravity_tilt"], 1.2, 150.0, pictures)
        worse = candidate(["stiff_segment"], 1.6, 120.0, pictures)
        found = verdict.equal_predictors(best, [best, alike, worse], holdout_err)
        rivals = [e.effects for e in found if e.candidate is not best]
        assert rivals == expected
    one = verdict.SufficientEffects(("intrinsic_curvature",), best)
    two = verdict.SufficientEffects(("gravity_tilt",), alike)
    assert verdict.choose([one], [two]).rivals == (("gravity_tilt",),)
