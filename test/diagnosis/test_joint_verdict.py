# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The verdict of the joint model, by what matters."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiment_recordings import moving
from rods import PAPER

from dlo_ros.diagnosis.explain import measurement_error
from dlo_ros.diagnosis.explain.cause_naming import Cause
from dlo_ros.diagnosis.explain.explanation import Explanation
from dlo_ros.diagnosis.explain.measurement_error import _staying
from dlo_ros.diagnosis.findings import joint_outcome, next_recording
from dlo_ros.diagnosis.findings.holdout import fitted_to_seen, held_out_recording
from dlo_ros.diagnosis.findings.joint_learning import (
    Errors,
    Learned,
    nearer,
    surprising,
    training_set,
)
from dlo_ros.diagnosis.findings.joint_outcome import _completed, _verdict
from dlo_ros.errors import SimulationError
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.inference import joint_fit
from dlo_ros.inference.smooth_modes import whitening
from dlo_ros.inference.spectrum import modes, spectra
from dlo_ros.inference.variances import fit_variances
from dlo_ros.spline import SplineBasis

MATTERS = 1e-3
L = 0.7
NAMEABLE = 0.5e-3


@pytest.mark.parametrize(
    ("setup", "after", "without", "verdict"),
    [
        (0.5e-3, 0.5e-3, [], "adequate"),
        (0.5e-3, 0.4e-3, [0.6e-3], "adequate"),  # certain, but small
        (0.5e-3, 0.5e-3, [0.6e-3, 8e-3], "explained"),  # a camera far beyond its tolerance
        (5e-3, 0.5e-3, [5e-3], "explained"),
        (5e-3, 2e-3, [9e-3], "unexplained"),
        (5e-3, 0.5e-3, [], "unexplained"),
        (1.1e-3, 0.8e-3, [], "adequate"),  # nobody would name what takes so little away
        (1.1e-3, 1.05e-3, [], "unexplained"),
    ],
)
def test_the_verdict_says_whether_what_matters_is_explained(setup, after, without, verdict):
    causes = [Cause("camera_scale", (), {}, 20.0, err, 0.0) for err in without]
    assert _verdict(setup, after, MATTERS, NAMEABLE, causes) == verdict


@pytest.mark.parametrize(
    ("after", "before", "no_nearer"),
    [
        ((0.6e-3, 0.5e-3, 1.3e-3), (0.1e-3, 0.1e-3, 1.4e-3), True),  # one impact, no cause
        ((0.1e-3, 0.1e-3, 1.3e-3), (0.1e-3, 0.1e-3, 1.4e-3), False),
        (None, (1e-3,), False),  # it cannot be simulated
    ],
)
def test_a_fit_that_comes_no_nearer_to_what_it_has_learned_is_told(after, before, no_nearer):
    errors = [None if e is None else [np.full(5, x) for x in e] for e in (after, before)]
    assert joint_outcome._no_nearer(*errors) is no_nearer


def test_errors_that_stay_are_those_that_each_recording_shows():
    """One recording lies three times as far off as the other; their variance is common."""
    n, length, rng = 10, 0.5, np.random.default_rng(4)
    vectors, shares = modes(n)
    residuals, true = [], []
    for size in (0.5e-3, 1.5e-3):
        lasting = size * np.sqrt(shares) * rng.choice([-1.0, 1.0], n) @ vectors.T
        residual = np.zeros((90, 2 * n))
        residual[:, n:] = lasting
        residual += 1e-4 / np.sqrt(n) * rng.normal(size=residual.shape)
        residuals.append(residual)
        true.append(np.sum(lasting**2))
    bins = spectra([(r, np.zeros((90, 1, 2 * n))) for r in residuals], n)
    variances, _ = fit_variances(bins, np.zeros(1), np.ones(1), length)
    assert np.allclose(variances[0].lasting, variances[1].lasting)
    for v, residual, own in zip(variances, residuals, true, strict=True):
        across, along = _staying(v, residual)
        assert along == pytest.approx(own, rel=0.1)
        assert across < 0.01 * own


@pytest.mark.parametrize(
    ("spare", "held", "seen", "surprised"),
    [
        (None, 9e-3, 1e-3, False),  # none is held out
        (2, 2e-3, 1e-3, False),
        (2, 9e-3, 1e-3, True),
        (2, 2e-3, 1e-4, False),  # all that is too much lies within what matters
        (2, None, 1e-3, True),  # it cannot be simulated
    ],
)
def test_a_recording_that_shows_what_others_do_not_is_told(spare, held, seen, surprised):
    errors = [None if e is None else [np.full(5, e)] for e in (held, seen)]
    training = SimpleNamespace(held_out=spare)
    explanation = SimpleNamespace(material_err=MATTERS)
    learned = SimpleNamespace(err=Errors(*errors), explanation=explanation)
    assert surprising(training, learned) is surprised


def recording(speed, grip="start"):
    """A recording of a DLO that moves evenly."""
    times = np.linspace(0.0, 1.0, 6)
    observed = np.zeros((6, 4, 3))
    observed[..., 0] = speed * times[:, None]
    command = SimpleNamespace(names=(grip,))
    return SimpleNamespace(
        times=times,
        observed=observed,
        manipulation=SimpleNamespace(commands=(command,)),
        frames_at_rest=0,
    )


@pytest.mark.parametrize(
    ("recordings", "number"),
    [
        ([recording(0.1), recording(0.1), recording(0.2)], 2),
        ([recording(0.1), recording(0.1), recording(2.0)], 1),  # damping shows in the last alone
        ([recording(0.1), recording(0.1), recording(0.1, "end")], 1),
        ([recording(0.1), recording(2.0)], None),  # too few
        ([recording(0.1), recording(0.1, "end"), recording(0.1, "middle")], None),
    ],
)
def test_held_out_is_a_recording_that_others_can_foretell(recordings, number):
    assert held_out_recording(recordings) == number


def own_err(monkeypatch, noises, still=(), free=(), along=1e-6, slides=()):
    """The measurement's own ERR in recordings with these stds of the noise [m], L = 1 m.

    Args:
        still: recordings in which the DLO does not move.
        free: recordings with a free end.
        along: error along the DLO there that stays [m].
        slides: error of u that measured points leave open in each recording [m]; none: no points.
    """
    monkeypatch.setattr(measurement_error, "_staying", lambda *_: np.array([1e-10, along**2]))
    monkeypatch.setattr(measurement_error, "_noise", lambda std, *_: np.array([std**2, 0.0]))
    ends = {k: ("end",) if k in free else () for k in range(len(noises))}
    monkeypatch.setattr(measurement_error, "free_ends", lambda k, _: ends[k])
    monkeypatch.setattr(
        measurement_error, "_stretched", lambda _, ends, __: (len(ends) * along**2, len(ends))
    )
    errors = iter(slides)
    monkeypatch.setattr(
        measurement_error, "slid", lambda *_: SimpleNamespace(along_square=next(errors) ** 2)
    )
    settings = SimpleNamespace(rod=SimpleNamespace(length=1.0))
    at = SimpleNamespace(
        model=SimpleNamespace(settings=settings), variances=noises, spectra=[None] * len(noises),
        fields=[(None, None)] * len(noises),
        predicted=[np.zeros((9, 4, 3))] * len(noises),
    )  # fmt: skip
    shapes = np.random.default_rng(0).normal(size=(9, 4, 3))
    seen = [
        SimpleNamespace(
            observed=shapes * (k not in still),
            times=np.arange(9.0),
            frames_at_rest=0,
            beyond=0.0 if slides else None,
            manipulation=k,
        )
        for k in range(len(noises))
    ]
    one_direction = np.sqrt(2.0 / np.pi)  # mean of the absolute value
    return measurement_error.own_err(at, seen) / one_direction


@pytest.mark.parametrize(("noise", "own"), [(1e-3, 1e-3), (0.1, 0.01)])
def test_no_noise_beyond_a_hundredth_of_the_length_is_the_measurements_own(monkeypatch, noise, own):
    assert own_err(monkeypatch, (noise,)) == pytest.approx(own, rel=0.02)


def test_what_one_recording_alone_shows_is_not_the_measurements_own(monkeypatch):
    """An impact in one of three; twice the error is no reason, nor is a DLO at rest a measure."""
    assert own_err(monkeypatch, (5e-3, 4e-4, 4e-4)) == pytest.approx(2e-3 / 3.0, rel=0.05)
    assert own_err(monkeypatch, (8e-4, 4e-4, 4e-4)) == pytest.approx(1.6e-3 / 3.0, rel=0.05)
    assert own_err(monkeypatch, (5e-3, 1e-4), still=(1,)) == pytest.approx(2.55e-3, rel=0.05)


@pytest.mark.parametrize(
    ("ends", "error", "expected"),
    [
        (("end",), lambda u: u, 1.0),
        (("start",), lambda u: L - u, 1.0),
        (("end",), lambda u: L - u, 0.25),  # of 1 - x the part along x, squared: (1/6)^2 / (1/3)^2
        (("end",), lambda u: np.ones_like(u), 0.75),
        (("start", "end"), lambda u: np.ones_like(u), 1.0),
        (("end",), lambda u: np.sin(2.0 * np.pi * u / L), 0.152),  # 3 / (2 pi^2)
        ((), lambda u: u, 0.0),
    ],
)
def test_what_grows_towards_a_free_end_is_told_from_other_errors_along_a_dlo(ends, error, expected):
    n = 24
    settings = replace(PAPER, rod=replace(PAPER.rod, length=L, control_points=n))
    basis = SplineBasis(n, L)
    stations = np.linspace(0.0, L, 400)
    along = whitening(n, L) @ np.linalg.lstsq(basis.matrix(stations), error(stations))[0]
    rng = np.random.default_rng(5)
    residual = np.zeros((60, 2 * n))
    residual[:, n:] = along + 0.1 * rng.normal(size=(60, 1)) * along  # more or less of it
    residual[:, :n] = rng.normal(size=(60, n))
    size, share = measurement_error._stretched(residual, ends, settings)
    assert share == pytest.approx(expected, abs=0.02)
    mean_square = np.mean(error(np.linspace(0.0, L, 2000)) ** 2)
    assert size == pytest.approx(expected * mean_square, rel=0.05, abs=0.02 * mean_square)


def test_u_may_be_stretched_towards_a_free_end(monkeypatch):
    """A camera sees a free end too early or too late; held ends leave no room for that."""
    free = own_err(monkeypatch, (1e-4, 1e-4), free=(0, 1), along=8e-3)
    assert free == pytest.approx(8e-3, rel=0.02)
    held = own_err(monkeypatch, (1e-4, 1e-4), along=8e-3)
    assert held == pytest.approx(3e-3**2 / 8e-3, rel=0.02)
    assert own_err(monkeypatch, (1e-4,), along=2.9e-3) == pytest.approx(2.9e-3, rel=0.02)
    # Those that are held tell nothing of one with a free end; another one does.
    alone = own_err(monkeypatch, (1e-4, 1e-4, 1e-4), free=(0,), along=8e-3)
    assert alone == pytest.approx((8e-3 + 2.0 * held) / 3.0, rel=0.02)


def test_a_free_end_that_points_see_too_early_or_too_late_is_compared_with_its_like(monkeypatch):
    """A recording held at both ends tells nothing of how well a free end is seen."""
    beside_held = own_err(monkeypatch, (1e-6, 1e-6), free=(1,), slides=(1e-4, 8e-3))
    assert beside_held == pytest.approx(4.05e-3, rel=0.02)
    both_free = own_err(monkeypatch, (1e-6, 1e-6), free=(0, 1), slides=(1e-4, 8e-3))
    assert both_free == pytest.approx(2e-4, rel=0.02)
    # Errors across the DLO are those of the tracker all the same.
    across = own_err(monkeypatch, (1e-4, 8e-3), free=(1,), slides=(1e-6, 1e-6))
    assert across == pytest.approx(2e-4, rel=0.05)


def test_a_damping_that_keeps_its_guess_asks_for_a_swing():
    model = SimpleNamespace(names=("young_modulus", "density", "air_drag"))
    found = SimpleNamespace(
        causes=(), at=SimpleNamespace(model=model),
        shifts={"internal_damping": {}, "air_drag": {}, "creep": {}},
    )  # fmt: skip
    asked = next_recording.advice("unexplained", found)
    assert "guesses (damping.relaxation_time)." in asked and asked.endswith(next_recording.REPEAT)
    assert next_recording.advice("explained", found) == next_recording.SETTLED
    found.shifts = {}
    assert next_recording.advice("unexplained", found) == next_recording.REPEAT


def fitted_to(*errs):
    """A fit with these ERR [m], one for each recording."""
    return SimpleNamespace(err=tuple(np.full(4, e) for e in errs), mean_err=np.mean(errs))


@pytest.mark.parametrize(
    ("all_of_them", "spoilt"), [((1.1e-3, 1.1e-3, 3e-3), False), ((4e-3, 4e-3, 2e-3), True)]
)
def test_a_recording_that_is_not_explained_does_not_spoil_the_rest(
    monkeypatch, all_of_them, spoilt
):
    found, final = fitted_to(1e-3, 1e-3), fitted_to(*all_of_them)
    monkeypatch.setattr(joint_outcome, "refitted", lambda *_: final)
    assert _completed(found, (0, 1, 2), (0, 1)) is (found if spoilt else final)
    assert _completed(found, (0, 1, 2), (0, 1, 2)) is final  # all have been learned from


@pytest.mark.parametrize(
    ("exact", "far", "may"),
    [(True, (), {"gravity_tilt"}), (True, ("gravity_tilt",), set()), (False, (), set())],
)
def test_a_set_up_does_the_work_of_what_lies_within_its_tolerances(monkeypatch, exact, far, may):
    groups = [SimpleNamespace(effect=name) for name in far]
    monkeypatch.setattr(joint_outcome, "far_off", lambda _: groups)
    causes = (Cause("gravity_tilt", (), {}, 9.0, 5e-3, 0.0),)
    found = SimpleNamespace(setup=None, causes=causes, exact=exact)
    of_itself = joint_outcome._of_itself(found)
    assert of_itself == may
    verdict = _verdict(0.5 * MATTERS, 0.5 * MATTERS, MATTERS, NAMEABLE, causes, of_itself)
    assert verdict == ("adequate" if may else "explained")


@pytest.mark.parametrize(
    ("matters", "causes", "of_all", "err"),
    [
        (1.5e-3, (), 2e-3, 1e-3),
        (2.5e-3, (), 2e-3, 2e-3),
        (1.5e-3, ("tilt",), 2e-3, 2e-3),  # it matters, and a cause explains it
        (2.5e-3, ("tilt",), 3e-3, 1e-3),
    ],
)
def test_a_set_up_is_judged_by_how_near_it_can_come(monkeypatch, matters, causes, of_all, err):
    """Where that decides: correlated errors let a fit drift from the shapes."""
    monkeypatch.setattr(joint_fit, "approached", lambda *_: fitted_to(1e-3, 1e-3))
    monkeypatch.setattr(joint_outcome, "_completed", lambda *_: fitted_to(of_all, of_all))
    final = fitted_to(4e-4, 4e-4)
    found = SimpleNamespace(setup=fitted_to(2e-3, 2e-3), at=final, causes=causes)
    told = joint_outcome._set_up_err(found, final, (0, 1), (0, 1), matters)
    assert told == pytest.approx(err)


@pytest.mark.parametrize(("held", "closer"), [(9e-3, True), (2e-3, False), (None, True)])
def test_all_recordings_teach_where_they_come_nearer_so(held, closer):
    told = None if held is None else [np.full(4, held)]
    again = SimpleNamespace(explanation=SimpleNamespace(at=fitted_to(2e-3, 2e-3)))
    before = Learned(None, {}, (), Errors(told, [np.full(4, 1e-3)]))
    assert nearer(again, before) == closer


@pytest.mark.slow
def test_the_plain_model_has_not_seen_what_is_held_out():
    good, given = moving("simple", {}, 12)
    turned, _ = moving("simple", {"clamp_angle": {"start": 0.2}}, 13)
    both, alone = begin([good, turned], given), begin([good], given)
    masks = [
        np.full(len(r.times), seen) for r, seen in zip(both.recordings, (True, False), strict=True)
    ]

    def stiffness(settings):
        return np.log(settings.rod.specific_modulus / alone.at.model.settings.rod.specific_modulus)

    assert abs(stiffness(both.at.model.settings)) > 0.03
    assert (
        abs(stiffness(fitted_to_seen(both.at.model, both.recordings, masks, 0.0).settings)) < 0.02
    )


@pytest.mark.slow
def test_a_model_that_a_recording_refuses_is_dropped_and_its_set_up_kept(monkeypatch, caplog):
    recording, given = moving("simple", {"clamp_angle": {"start": 0.02}}, 12)
    begun = begin([recording], given)
    setup = training_set(begun, 1, begun.at.model.settings, given).prepared.setup
    theta = setup.model.theta()
    theta[setup.model.index("young_modulus")] += 0.1
    broken = replace(setup, model=setup.model.at(theta))
    cause = Cause("clamp_angle", ("effects.clamp_angle.start",), {}, 9.0, 1e-2, 0.0)
    found = Explanation(setup, broken, (cause,), 1e-4, 2e-4, 1e-5, (), ())
    none = np.zeros(len(setup.err[0]), dtype=bool)
    learned = Learned(found, {}, (none,), Errors(), seen=(~none,))
    real, ratio = joint_outcome.simulate, broken.model.settings.rod.specific_modulus

    def refused(model, *args, **kwargs):
        if model.settings.rod.specific_modulus == pytest.approx(ratio, rel=1e-3):
            raise SimulationError("simple: no static equilibrium")
        return real(model, *args, **kwargs)

    monkeypatch.setattr(joint_outcome, "simulate", refused)
    monkeypatch.setattr(joint_outcome, "refitted", lambda at, *_: at)
    told = joint_outcome.joint_outcome(begun, begun.at, learned, given)
    assert told.effects == () and told.setup
    assert "no static equilibrium" in caplog.text
    # Where the set-up alone is refused, too, nothing is left to fall back on.
    alone = replace(found, setup=broken, causes=())
    with pytest.raises(SimulationError, match="no static equilibrium"):
        joint_outcome.joint_outcome(begun, begun.at, replace(learned, explanation=alone), given)


@pytest.mark.slow
def test_what_comes_no_nearer_than_the_plain_model_explains_nothing(monkeypatch):
    """However near a fit to other simulations came: what is told is the plain model."""
    recording, given = moving("simple", {"gravity_tilt": {"angle": 0.3}}, 12)
    begun = begin([recording], given)
    setup = training_set(begun, 1, begun.at.model.settings, given).prepared.setup
    found = Explanation(setup, setup, (), 1e-4, 2e-4, 1e-5, (), ())
    far, mask = np.full(len(setup.err[0]), 1.0), np.zeros(len(setup.err[0]), dtype=bool)
    monkeypatch.setattr(joint_outcome, "refitted", lambda at, *_: at)
    told = joint_outcome.joint_outcome(
        begun, begun.at, Learned(found, {}, (mask,), Errors(None, [far]), seen=(~mask,)), given
    )
    assert setup.mean_err < told.material_err < begun.at.mean_err
    assert told.verdict == "unexplained"
    assert told.extended.err_train == told.baseline.err_train
