# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fits of the joint model: steps with derivatives from elsewhere, and their limits."""

from dataclasses import replace

import numpy as np
import pytest
from experiment_recordings import fitted_set_up

from dlo_ros.effects import Start
from dlo_ros.errors import SimulationError
from dlo_ros.inference import joint, joint_fit, losses
from dlo_ros.inference.joint import borrowed, judged, simulate
from dlo_ros.inference.losses import CORRELATED, TO_REPORT, WHITE
from dlo_ros.inference.priors import cause_priors

ANGLE = "effects.clamp_angle.start"


@pytest.fixture(scope="module")
def fitted():
    return fitted_set_up()


def moved_by(at, name, change):
    theta = at.model.theta()
    theta[at.model.index(name)] += change
    return at.model.at(theta)


def test_steps_with_borrowed_derivatives_come_near(fitted, monkeypatch):
    at, recordings = fitted
    far = borrowed(at, moved_by(at, ANGLE, 0.1), recordings)
    far = borrowed(far, moved_by(far, "young_modulus", 0.7), recordings)

    def fails(*_):
        raise AssertionError("derivatives were computed")

    monkeypatch.setattr(joint_fit, "evaluate", fails)
    nearer = [joint_fit.approached(far, recordings, steps).mean_err for steps in (0, 1, 4)]
    assert nearer[0] == far.mean_err
    assert nearer[2] < nearer[1] < 0.5 * nearer[0]
    assert nearer[2] < at.mean_err + 0.1 * far.mean_err


def test_a_step_that_leads_nowhere_corrects_no_derivative(fitted):
    at, _ = fitted
    assert joint_fit._corrected(at, at) is at


@pytest.mark.parametrize("size", [1e200, 1e30])  # overflow; priors that vanish beside it
def test_derivatives_beyond_all_bounds_are_a_failed_simulation(fitted, size):
    at, _ = fitted
    steep = tuple((r, np.where(j == 0.0, j, size)) for r, j in at.fields)
    with (
        np.errstate(over="ignore", invalid="ignore"),
        pytest.raises(SimulationError, match="derivatives of the simulation grow"),
    ):
        judged(replace(at, fields=steep))


def test_where_derivatives_grow_beyond_what_a_step_could_do_there_are_differences(
    fitted, monkeypatch
):
    at, recordings = fitted
    exact = simulate(at.model, recordings)
    length = at.model.settings.rod.length
    steep = np.zeros_like(exact.fields[0][1])
    assert not joint._boundless(exact.fields[0][1], at.model, at.model.names).any()
    assert not joint._boundless(steep[:, :0], at.model, ()).any()
    first, second = (length / joint.DIFFERENCE / p.step for p in at.model.parameters[:2])
    for beyond in (1.1 * first, 1e200, np.inf, np.nan):
        steep[-1, 0, 0] = beyond
        found = joint._boundless(steep, at.model, at.model.names)  # without a word to the user
        assert found[0] and not found[1:].any()
    steep[:, :3, 0] = 0.3 * first, 1.2 * second, 0.0  # a snap: large and right
    assert list(joint._boundless(steep, at.model, at.model.names)[:3]) == [False, True, False]
    steep[:, :3, 0] = 3.0 * first, 3.0 * second, 1e-3 * second  # the third is small for all that
    assert list(joint._boundless(steep, at.model, at.model.names)[:3]) == [True, True, False]
    steep[:, :, 0] = 1e6 * np.array([length / p.step for p in at.model.parameters])
    steep[:, 2] *= 1e-5
    assert joint._boundless(steep, at.model, at.model.names).all()  # through impacts

    monkeypatch.setattr(joint, "_boundless", lambda jacobian, *_: np.full(jacobian.shape[1], True))
    for (r, j), (there, differences) in zip(
        exact.fields, simulate(at.model, recordings).fields, strict=True
    ):
        np.testing.assert_array_equal(there, r)
        for k, name in enumerate(at.model.names):
            off, size = np.linalg.norm(differences[:, k] - j[:, k]), np.linalg.norm(j[:, k])
            # The steps in time may be others at the moved value: shapes then differ by so much.
            steps = 1e-4 / (joint.DIFFERENCE * at.model.parameters[k].step)
            assert off < 0.25 * size + steps, name


def test_at_an_end_of_its_range_a_difference_is_one_sided(fitted):
    at, recordings = fitted
    exact = simulate(at.model, recordings[:1])
    residual, jacobian = exact.fields[0]
    k = at.model.index("young_modulus")
    p, here = at.model.parameters[k], at.model.theta()[k]
    for upper in (here, here + 0.1 * joint.DIFFERENCE * p.step):
        bound = at.model.with_prior([replace(p, upper=float(p.outer(upper)))])
        ((column,),) = [joint.differences(bound, recordings[0], [p.name], residual).swapaxes(0, 1)]
        off, size = np.linalg.norm(column - jacobian[:, k]), np.linalg.norm(jacobian[:, k])
        assert off < 0.25 * size + 1e-4 / (joint.DIFFERENCE * p.step)


@pytest.mark.parametrize(
    "effect, block, points",
    [
        ("obstacle", {"x": 0.3, "z": -0.2, "radius": 0.01}, ("x", "z")),
        ("wall", {"offset": -0.3, "angle": 0.0}, ("offset",)),
    ],
)
def test_a_point_of_the_board_moves_by_steps_of_the_dlos_size(fitted, effect, block, points):
    """It may stand anywhere in a room: a tenth of that is no step through which it touches."""
    given = fitted[0].model.settings
    start = Start(effect, block, (), tuple(block), neutral=False)
    steps = {p.key: p.step for p in cause_priors(given, start)[0]}
    for key in points:
        assert 0.01 * given.rod.length < steps[key] < 0.05 * given.rod.length


def test_a_draft_needs_no_derivatives_at_its_end(fitted, monkeypatch):
    at, recordings = fitted
    near = borrowed(at, moved_by(at, ANGLE, 0.01), recordings)
    assert at.derived and not near.derived
    final = joint_fit.fit(near, recordings, 1)
    assert final.derived

    def fails(*_):
        raise AssertionError("derivatives were computed")

    monkeypatch.setattr(joint_fit, "evaluate", fails)
    draft = joint_fit.fit(near, recordings, 1, draft=True)
    assert not draft.derived
    assert draft.mean_err == pytest.approx(final.mean_err, rel=1e-3)  # by other engines
    assert draft.mean_err < near.mean_err


@pytest.mark.parametrize("loss", [WHITE, CORRELATED])
def test_a_small_gain_of_a_damped_step_ends_no_fit(fitted, monkeypatch, loss):
    at, recordings = fitted
    far = borrowed(at, moved_by(at, ANGLE, 0.1), recordings)
    monkeypatch.setattr(joint_fit, "MARQUARDT_DAMPING", 10.0)
    found = joint_fit.fit(far, recordings, 12, loss=loss)
    assert found.mean_err < at.mean_err + 0.1 * far.mean_err


def test_a_fit_that_only_steps_away_from_the_shapes_improve_is_at_its_end(fitted, monkeypatch):
    at, recordings = fitted
    far = borrowed(at, moved_by(at, ANGLE, 0.1), recordings)
    begun = joint.evaluate(far.model, recordings, far.variances)
    assert TO_REPORT.farther == 1.0 < CORRELATED.farther
    monkeypatch.setattr(losses, "FARTHER", 0.0)
    monkeypatch.setattr(joint_fit, "approached", lambda here, _: here)
    assert joint_fit.fit(begun, recordings, 12) is begun


def test_a_number_at_the_end_of_its_range_takes_no_other_with_it(fitted):
    """The others go to the optimum beside it, not to that without the range."""
    model = fitted[0].model.without([n for n in fitted[0].model.names if n.startswith("effects")])
    here = model.theta()
    k = model.index("density")
    end = replace(model.parameters[k], upper=model.parameters[k].outer(float(here[k])))
    model = model.with_prior([end])
    lhs = np.eye(len(here)) + 0.9
    rhs = 0.1 * np.linspace(1.0, 2.0, len(here))
    rhs[k] = 5.0
    step = joint_fit._step(model, lhs, rhs)
    others = np.delete(np.arange(len(here)), k)
    assert step[k] == 0.0
    np.testing.assert_allclose(
        step[others], np.linalg.solve(lhs[np.ix_(others, others)], rhs[others])
    )
    np.testing.assert_allclose(joint_fit._step(model, lhs, -rhs), np.linalg.solve(lhs, -rhs))


@pytest.mark.parametrize("noisy", [False, True])
def test_a_fit_that_ends_in_a_wrong_minimum_begins_elsewhere(fitted, monkeypatch, noisy):
    """Also where all that is left passes for noise in it, as 11 mm had: that is fitted, too."""
    at, recordings = fitted
    wrong = joint.evaluate(moved_by(at, ANGLE, -0.3).stiffened(1e-3), recordings)
    if noisy:
        each = [np.full_like(v.white, wrong.mean_err**2) for v in wrong.variances]
        variances = [replace(v, white=w) for v, w in zip(wrong.variances, each, strict=True)]
        wrong = replace(wrong, variances=tuple(variances))
    ends, settled = [wrong], joint_fit.settled

    def first_wrong(start, recordings):
        return ends.pop() if ends else settled(start, recordings)

    monkeypatch.setattr(joint_fit, "settled", first_wrong)
    found = joint_fit.best_settled(wrong, recordings)
    assert not ends and wrong.mean_err > 50.0 * at.mean_err
    assert found.mean_err < 1.2 * at.mean_err


@pytest.mark.parametrize("factor", [0.01, 0.1, 10.0, 100.0])
@pytest.mark.parametrize("angle", [-0.3, 0.3])
def test_a_fit_from_far_away_finds_the_minimum(fitted, factor, angle):
    """Residuals that are not independent weigh no more than their number: priors hold the rest."""
    at, recordings = fitted
    far = joint.evaluate(moved_by(at, ANGLE, angle).stiffened(factor), recordings)
    assert joint_fit.settled(far, recordings).mean_err < 1.2 * at.mean_err


@pytest.mark.parametrize("nearer", [True, False])
def test_a_fit_whose_steps_all_fail_goes_on_from_nearer_to_the_shapes(fitted, monkeypatch, nearer):
    """As at a kink: no step holds until the fit lies elsewhere."""
    at, recordings = fitted
    far = joint_fit.evaluate(moved_by(at, ANGLE, 0.1), recordings)
    improved, held = joint_fit._improved, []

    def stuck_there(here, recordings, way, loss, *rest):
        if here is far and loss.fits_variances:
            return replace(improved(here, recordings, way, loss, *rest), at=None, failed=True)
        held.append(here)
        return improved(here, recordings, way, loss, *rest)

    monkeypatch.setattr(joint_fit, "_improved", stuck_there)
    if not nearer:
        monkeypatch.setattr(joint_fit, "approached", lambda here, _: here)
    found = joint_fit.fit(far, recordings, 12)
    if nearer:
        assert found.mean_err < 1.1 * at.mean_err
        assert found.posterior.evidence == pytest.approx(at.posterior.evidence, abs=1.0)
    else:
        assert found is far and not held


def test_a_fit_that_has_converged_looks_nowhere_else(fitted, monkeypatch):
    at, recordings = fitted
    monkeypatch.setattr(joint_fit, "approached", lambda *_: pytest.fail("looked elsewhere"))
    joint_fit.fit(at, recordings, 12)
