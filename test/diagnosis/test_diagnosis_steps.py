# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Steps of the diagnosis: coarse trials, what is faint, suspects, held-out data."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_candidates import KNOWN
from measured import swing
from rods import PAPER

from dlo_ros.diagnosis.contact.peg_places import resized, tangent_wall
from dlo_ros.diagnosis.findings import holdout
from dlo_ros.diagnosis.findings.fitted_numbers import covariance, own_error
from dlo_ros.diagnosis.findings.fitted_numbers import fitted as fitted_numbers
from dlo_ros.diagnosis.fitting import evaluation, levenberg_marquardt
from dlo_ros.diagnosis.fitting.evaluation import differenced, earlier, evaluate
from dlo_ros.diagnosis.fitting.initial_fit import begin, drafts, finer
from dlo_ros.diagnosis.fitting.levenberg_marquardt import UNDAMPED, fit, polished
from dlo_ros.diagnosis.selection import verdict
from dlo_ros.diagnosis.selection.effect_search import candidate
from dlo_ros.effects import Peg
from dlo_ros.errors import SimulationError

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def beginning():
    return begin([swing(PAPER, seconds=1.0), swing(PAPER, seconds=0.6, seed=1)], KNOWN)


def test_a_coarse_trial_agrees_where_it_begins(beginning, monkeypatch):
    monkeypatch.setattr("dlo_ros.diagnosis.fitting.initial_fit.DRAFT_ERROR", 50.0)
    at = beginning.at
    tried = drafts(beginning.recordings, at)
    coarse = evaluate(at.model, tried, KNOWN, derivatives=False)
    for draft, fine, here, there in zip(
        tried, beginning.recordings, coarse.residuals, at.residuals, strict=True
    ):
        assert draft.tolerance > fine.tolerance
        assert not np.allclose(draft.observed, fine.observed, rtol=0.0, atol=1e-6)
        assert here == pytest.approx(there, abs=1e-6)


def test_long_recordings_are_tried_in_part(beginning, monkeypatch):
    monkeypatch.setattr("dlo_ros.diagnosis.fitting.initial_fit.DRAFT_FRAMES", 20)
    monkeypatch.setattr("dlo_ros.diagnosis.fitting.initial_fit.LEAST_FRAMES", 5)
    at = beginning.at
    tried = drafts(beginning.recordings, at)
    for draft, whole, residual in zip(tried, beginning.recordings, at.residuals, strict=True):
        count = len(draft.times)
        assert 10 <= count < len(whole.times) == len(residual)
        assert len(draft.manipulation.observations) == len(draft.observed) == count
        shown = np.sum(residual[:count] ** 2) / np.sum(residual**2)
        assert shown >= 0.25
    begun = earlier(at, beginning.recordings, tried, KNOWN)
    coarse = evaluate(at.model, tried, KNOWN, derivatives=False)
    assert begun.sum_of_squares == pytest.approx(coarse.sum_of_squares)


def test_a_simulation_is_refined_for_a_model_that_comes_near(beginning):
    assert finer(beginning, beginning.at.model, KNOWN) is None
    rough = tuple(replace(r, spans=7, tolerance=5e-3) for r in beginning.recordings)
    sharper = finer(replace(beginning, recordings=rough), beginning.at.model, KNOWN)
    assert sharper is not None
    assert all(r.tolerance < 5e-3 for r in sharper.recordings)
    assert (
        sharper.at.sum_of_squares
        < evaluate(beginning.at.model, rough, KNOWN, derivatives=False).sum_of_squares
    )


def test_a_standard_deviation_knows_the_simulations_own_error(beginning):
    rough = tuple(replace(r, spans=7, tolerance=2e-3) for r in beginning.recordings)
    at = polished(evaluate(beginning.at.model, rough, KNOWN), rough, KNOWN)
    own = own_error(at, rough, KNOWN)
    sharp = tuple(replace(r, spans=14, tolerance=2e-4) for r in rough)
    finer = polished(evaluate(at.model, sharp, KNOWN), sharp, KNOWN)
    moved = finer.model.theta() - at.model.theta()
    largest = int(np.argmax(np.abs(moved)))
    assert own[largest] == pytest.approx(moved[largest], rel=0.3)
    without, widened = (np.sqrt(np.diag(covariance(at, KNOWN, o))) for o in (None, own))
    assert widened == pytest.approx(np.hypot(without, own))
    small = own_error(beginning.at, beginning.recordings, KNOWN)
    assert np.abs(small).max() < 0.1 * np.abs(own).max()


def test_the_std_of_the_ratio_knows_the_rod_theory_s_and_the_diameter_s_error(beginning):
    at, rod = beginning.at, beginning.at.model.settings.rod
    ratio = np.array([(n == "young_modulus") - float(n == "density") for n in at.model.free])
    bare = float(np.sqrt(ratio @ covariance(at, KNOWN) @ ratio))
    # Curvature per stretched or unstretched length: 1.3 of the strain under the own weight.
    theory = 1.3 * 9.81 * rod.length * rod.density / rod.young_modulus
    thickness = 2.0 * rod.diameter_std / rod.diameter
    value, std = fitted_numbers(at, KNOWN, None, None).specific_modulus
    assert std / value == pytest.approx(np.sqrt(bare**2 + theory**2 + thickness**2), rel=0.01)
    assert std / value > 1.001 * bare


def test_what_starts_in_motion_is_refined_without_equilibria(monkeypatch):
    def at_rest(*words, **more):
        raise AssertionError("an equilibrium was asked for")

    monkeypatch.setattr("dlo_ros.diagnosis.fitting.initial_fit.forecast", at_rest)
    moving = replace(KNOWN, simulation=replace(KNOWN.simulation, start="moving"))
    begun = begin([swing(PAPER, seconds=0.5)], moving)
    assert begun.recordings[0].spans > 7
    assert 0.0 < begun.error < 1e-4 * PAPER.rod.length
    assert begun.at.err[0].mean() < 5e-3 * PAPER.rod.length


def test_what_cannot_be_simulated_finely_stays_as_it_is(beginning, monkeypatch):
    def failing(*words, **more):
        raise SimulationError("does not converge")

    monkeypatch.setattr("dlo_ros.diagnosis.fitting.levenberg_marquardt.evaluate", failing)
    assert polished(beginning.at, beginning.recordings, KNOWN) is beginning.at


@pytest.mark.parametrize("wild", [1e200, np.inf, np.nan])
def test_derivatives_beyond_all_bounds_are_refused(beginning, monkeypatch, wild):
    held = evaluation._held_against

    def wildly(*words):
        found, jacobian = held(*words)
        jacobian[0, 1, 0] = wild
        return found, jacobian

    monkeypatch.setattr(evaluation, "_held_against", wildly)
    with pytest.raises(SimulationError, match="derivatives"):
        evaluate(beginning.at.model, beginning.recordings, KNOWN)


def fitted_with_a_wrong_clamp(beginning, count, monkeypatch):
    """A fit whose derivatives are expensive, and how often they were simulated."""
    model = beginning.at.model.extended("clamp_angle", {"start": 0.03}, ("start",))
    at = evaluate(model, beginning.recordings, KNOWN)
    assert (
        at.expensive_jacobian
        and not evaluate(beginning.at.model, beginning.recordings, KNOWN).expensive_jacobian
    )
    made = []

    def counted(*words, **more):
        made.append(more.get("derivatives", True))
        return evaluate(*words, **more)

    monkeypatch.setattr("dlo_ros.diagnosis.fitting.levenberg_marquardt.evaluate", counted)
    return at, fit(at, beginning.recordings, KNOWN, count, damping=UNDAMPED), sum(made)


def test_dear_derivatives_are_carried_on(beginning, monkeypatch):
    at, found, simulated = fitted_with_a_wrong_clamp(beginning, 8, monkeypatch)
    assert 1 <= simulated <= 2  # renewed before the end is believed
    assert abs(found.model.settings.effects["clamp_angle"]["start"]) < 1e-3
    exact = fit(at, beginning.recordings, KNOWN, 8, exact=True, damping=UNDAMPED)
    assert found.cost == pytest.approx(exact.cost, abs=0.5)


def test_derivatives_that_are_carried_on_foretell_the_step_they_have_gone(beginning, monkeypatch):
    at, after, simulated = fitted_with_a_wrong_clamp(beginning, 1, monkeypatch)
    assert simulated == 0 and after.carried
    step = after.model.theta() - at.model.theta()
    for jacobian, here, there in zip(after.jacobians, at.residuals, after.residuals, strict=True):
        assert np.einsum("fpk,p->fk", jacobian, step) == pytest.approx(here - there, abs=1e-6)
    renewed = levenberg_marquardt.renewed(after, beginning.recordings, KNOWN)
    assert not renewed.carried and renewed.cost == pytest.approx(after.cost)


def test_differences_stand_beside_known_derivatives(beginning):
    """Of an effect that is tried its own numbers suffice; the others' derivatives stay."""
    recordings = beginning.recordings
    model = beginning.at.model.extended("clamp_angle", {"start": 0.02}, ("start",))
    at = evaluate(model, recordings, KNOWN, derivatives=False)
    here = evaluate(beginning.at.model, recordings, KNOWN)
    found = differenced(here, at, recordings, KNOWN)
    exact = evaluate(model, recordings, KNOWN)
    for jacobian, known, true in zip(found.jacobians, here.jacobians, exact.jacobians, strict=True):
        assert np.array_equal(jacobian[:, :-1], known)
        apart = np.linalg.norm(jacobian[:, -1] - true[:, -1])
        assert apart < 0.02 * np.linalg.norm(true[:, -1])


def test_a_fit_ends_where_nothing_is_promised(beginning, monkeypatch):
    at = polished(beginning.at, beginning.recordings, KNOWN)

    def simulated(*words, **more):
        raise AssertionError("simulated although nothing is to be gained")

    monkeypatch.setattr("dlo_ros.diagnosis.fitting.levenberg_marquardt.evaluate", simulated)
    assert fit(at, beginning.recordings, KNOWN, 3, damping=UNDAMPED) is at


def test_a_faint_autocovariance_needs_a_cause_that_takes_it_away():
    assert verdict.limit(0.8) < 0.3
    assert verdict.limit(2.0) == verdict.EXPLAINED
    assert verdict.limit(60.0) > verdict.EXPLAINED


def test_many_pictures_excuse_nothing():
    """What repeats from picture to picture may do so by chance in a few; many know the noise."""
    rng = np.random.default_rng(4)
    wobble = np.convolve(rng.normal(size=200), np.ones(5) / 5**0.5, mode="same")[:, None]
    noise = rng.normal(size=(200, 10))
    assert verdict.adequate([noise])
    assert not verdict.adequate([noise + 20.0 * wobble])
    assert not verdict.excusable([noise + 20.0 * wobble])
    few = [rng.normal(size=(6, 10)) + 20.0 * rng.choice([-1.0, 1.0], (6, 1))]
    assert verdict.excusable(few) and verdict.adequate(few)


def fitted(beginning, root_autocovariance, score, effect):
    at = beginning.at
    settings = KNOWN.with_effects({effect: {}})
    found = candidate(effect, "", at, KNOWN)
    model = replace(at.model, settings=settings)
    return replace(
        found, at=replace(at, model=model), root_autocovariance=root_autocovariance, score=score
    )


def test_suspects_come_near_and_hold_on_held_out_data(beginning):
    near = fitted(beginning, 2.0, 20.0, "gravity_tilt")
    nearer = fitted(beginning, 1.5, 10.0, "point_mass")
    astray = fitted(beginning, 1.6, 5.0, "stiff_segment")
    far = fitted(beginning, 4.0, 1.0, "length_error")
    errors = {id(near): 1.2e-3, id(nearer): 1e-3, id(astray): 9e-3, id(far): 1e-3}
    found = verdict.suspects([near, nearer, astray, far], lambda c: errors[id(c)])
    assert found == [nearer, near]
    assert verdict.suspects([], lambda c: None) == []


def test_errors_on_held_out_data_are_computed_once_and_of_a_fit_that_holds(beginning, monkeypatch):
    at = beginning.at
    parted = holdout.split(beginning.recordings, 0, at, at, KNOWN)
    holdout_err = holdout.HoldoutErrors(beginning.recordings, 2, parted, KNOWN)
    plain = candidate("", "", at, KNOWN)
    assert (
        holdout_err(plain) == holdout_err.linearised_err(plain) == pytest.approx(3e-4 / 4, rel=0.7)
    )
    wrong = at.model.at(at.model.theta() + np.array([1.0, 0.0, 0.0, 0.0]))
    linearised = holdout.trained
    monkeypatch.setattr(holdout, "trained", lambda *words: wrong)
    other = replace(plain)
    assert holdout_err.linearised_err(other) > 3.0 * holdout_err(plain)
    assert holdout_err(other) < 1.5 * holdout_err(plain)  # fitted anew, from the wrong beginning
    monkeypatch.setattr(holdout, "trained", linearised)
    assert holdout_err.linearised_err(other) == holdout_err(other)


def test_a_peg_is_resized_where_it_is_touched():
    """A straight DLO along x that lies on a peg below its middle."""
    rod = PAPER.rod
    shape = np.zeros((1, rod.control_points, 3))
    shape[0, :, 0] = np.linspace(0.0, rod.length, rod.control_points)
    touching = Peg(0.5 * rod.length, -0.01 - 0.5 * rod.diameter, 0.01)
    smaller, larger = resized(touching, rod, [shape])
    assert smaller.radius < touching.radius < larger.radius
    for other in (smaller, larger):
        assert other.x == pytest.approx(touching.x, abs=2e-3)
        assert other.z + other.radius == pytest.approx(touching.z + touching.radius, abs=2e-3)


def test_a_peg_may_stand_for_a_wall_that_no_shape_reaches_behind():
    """A straight DLO along x that lies on a peg below its middle, and one with its end lower."""
    rod = PAPER.rod
    lying = np.zeros((10, rod.control_points, 3))
    lying[..., 0] = np.linspace(0.0, rod.length, rod.control_points)
    touching = Peg(30 / 59 * rod.length, -0.01 - 0.5 * rod.diameter, 0.01)
    normal, offset = tangent_wall(touching, rod, [lying])
    assert normal == pytest.approx([0.0, 1.0], abs=0.05)
    assert touching.x * normal[0] - offset == pytest.approx(0.5 * rod.diameter, abs=2e-4)
    hanging = lying.copy()
    hanging[:, -1, 2] = -0.1 * rod.length
    assert tangent_wall(touching, rod, [lying, hanging]) is None
    hanging[1:] = lying[1:]  # a single picture that is grossly wrong
    assert tangent_wall(touching, rod, [lying, lying, hanging]) is not None
