# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The statistical core on made-up numbers, whose truth is known."""

from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from ordinary import some_of
from scipy.optimize import approx_fprime
from scipy.signal import lfilter

from dlo_ros.inference import variances as core
from dlo_ros.inference.parameter import Parameter, ParametricModel
from dlo_ros.inference.smooth_modes import modes
from dlo_ros.inference.spectrum import (
    bands,
    joined,
    motion_power,
    nodal_shares,
    of_residuals,
    spectra,
    spectrum,
)
from dlo_ros.inference.variances import Variances, fit_variances, guess, posterior
from dlo_ros.inference.widened_covariance import widened_covariance
from dlo_ros.parameters import RodParameters, Settings

N = 10
LENGTH = 0.4


def fading(rng, frames, size, memory):
    """An AR(1) error that is smooth along the DLO, coefficients (F, n) [m]."""
    vectors, shares = modes(N)
    white = rng.normal(size=(frames + 200, N)) * np.sqrt(shares)
    decay = ([size * np.sqrt(1.0 - memory**2)], [1.0, -memory])
    return lfilter(*decay, white, axis=0)[200:] @ vectors.T


def made(rng, frames=250, count=6, discrepancy=2e-3, memory=0.9):
    """Residuals with a known change of parameters: residual, Jacobian, change."""
    jacobian = lfilter([1.0], [1.0, -0.9], 1e-2 * rng.normal(size=(frames, count, 2 * N)), axis=0)
    theta = 0.1 * rng.normal(size=count)
    parts = [
        3e-4 / np.sqrt(N) * rng.normal(size=(frames, N)) + fading(rng, frames, size, memory)
        for size in (discrepancy, 0.5 * discrepancy)
    ]
    residual = np.concatenate(parts, axis=1) + np.einsum("fpk,p->fk", jacobian, theta)
    return residual, jacobian, theta


def test_modes_are_orthonormal_and_share_the_whole():
    vectors, shares = modes(N)
    assert np.allclose(vectors.T @ vectors, np.eye(N), atol=1e-12)
    assert shares.sum() == pytest.approx(1.0)
    assert np.all(np.diff(shares) <= 1e-12)


@pytest.mark.parametrize("frames", [1, 2, 7, 300])
def test_bands_tile_the_frequencies(frames):
    found = bands(frames)
    assert found[0] == (0, 1)
    assert [a for a, _ in found[1:]] == [b for _, b in found[:-1]]
    assert found[-1][1] == frames


def test_a_spectrum_keeps_power_and_normal_equations():
    residual, jacobian, _ = made(np.random.default_rng(1))
    s = spectrum(residual, jacobian, N)
    assert s.sum_of_squares.sum() == pytest.approx(np.sum(residual**2))
    assert s.count.sum() == residual.size
    assert np.allclose(s.hessian.sum(axis=0), np.einsum("fpk,fqk->pq", jacobian, jacobian))
    assert np.allclose(s.gradient.sum(axis=0), np.einsum("fpk,fk->p", jacobian, residual))


@pytest.mark.parametrize("linear", [True, False])
def test_derivatives_of_the_marginal_likelihood(linear):
    rng = np.random.default_rng(2)
    lengths = (40, 60)
    each = spectra(
        [made(rng, f)[:2] for f in lengths], N, [rng.exponential(1e-6, f) for f in lengths]
    )
    offset, precision = 0.1 * rng.normal(size=6), np.full(6, 10.0)
    bins, rows = joined(each), core._rows(each)

    def cost(x):
        value, slope, _ = core._cost(x, bins, rows, offset, precision, linear)
        unlikely, rate, _ = core._unlikely(x, rows, LENGTH)
        return value + unlikely, slope + rate

    x = core._packed([guess(s, LENGTH) for s in each])
    x[-1] = np.log1p(-0.4)
    numbers = approx_fprime(x, lambda y: cost(y)[0], 1e-6)
    assert np.allclose(cost(x)[1], numbers, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("columns", [[0, 2, 4], [0, 1, 2, 3, 4]])
def test_a_spectrum_of_other_residuals_is_as_if_made_of_them(columns):
    rng = np.random.default_rng(3)
    residual, other = rng.normal(size=(2, 40, 3 * N))
    jacobian, motion = rng.normal(size=(40, 5, 3 * N)), rng.exponential(size=40)
    known = spectrum(residual, jacobian, N, motion)
    (found,) = of_residuals([known], [other], columns)
    expected = spectrum(other, jacobian[:, columns], N, motion)
    for f in fields(expected):
        assert getattr(found, f.name) == pytest.approx(getattr(expected, f.name), rel=1e-9), f.name
    (back,) = of_residuals([found], [residual], range(len(columns)))
    assert np.allclose(back.gradient, spectrum(residual, jacobian[:, columns], N).gradient)


def test_what_all_recordings_share_stands_in_one_mean_of_them():
    """An error that is the same everywhere is left in one mean; nothing of the data is lost."""
    rng = np.random.default_rng(14)
    shared, lengths = rng.normal(size=2 * N), (30, 50, 20)
    recordings = [(np.tile(shared, (f, 1)), rng.normal(size=(f, 3, 2 * N))) for f in lengths]
    found = spectra(recordings, N)
    squares = [s.sum_of_squares.sum() for s in found]
    assert squares == pytest.approx([100.0 * np.sum(shared**2), 0.0, 0.0], abs=1e-9)
    assert [s.alike.max() for s in found] == [100.0, 0.0, 0.0]
    alone = [spectrum(r, j, N) for r, j in recordings]
    for name in ("sum_of_squares", "gradient", "hessian", "still"):
        sums = [sum(getattr(s, name).sum(axis=0) for s in each) for each in (found, alone)]
        assert sums[0] == pytest.approx(sums[1], rel=1e-9), name
    others = [rng.normal(size=r.shape) for r, _ in recordings]
    as_made = spectra([(o, j[:, [2, 0]]) for o, (_, j) in zip(others, recordings, strict=True)], N)
    for a, b in zip(of_residuals(found, others, [2, 0]), as_made, strict=True):
        assert a.gradient == pytest.approx(b.gradient, rel=1e-9)
        assert a.sum_of_squares == pytest.approx(b.sum_of_squares, rel=1e-9)


def test_what_the_errors_are_made_of_is_found():
    rng = np.random.default_rng(3)
    residual, jacobian, _ = made(rng, frames=600)
    s = spectrum(residual, jacobian, N)
    (found,), _ = fit_variances([s], np.zeros(6), np.full(6, 100.0), LENGTH)
    assert np.sqrt(found.white) == pytest.approx([3e-4, 3e-4], rel=0.1)
    assert np.sqrt(found.fading) == pytest.approx([2e-3, 1e-3], rel=0.25)
    assert found.memory == pytest.approx(0.9, abs=0.05)


def swinging(rng, frames, size):
    """A swing of unit mean square that wanders in phase, and an error of it, (F, n) [m] each."""
    vectors, shares = modes(N)
    poles = 0.98 * np.exp(np.array([1j, -1j]) * 0.4)
    a = np.real(np.poly(poles))
    motion, error = (
        lfilter([1.0], a, rng.normal(size=(frames + 200, N)) * np.sqrt(shares), axis=0)[200:]
        for _ in range(2)
    )
    unit = np.sqrt(np.mean(np.sum(motion**2, axis=1)))
    return motion / unit @ vectors.T, size * error / unit @ vectors.T


def test_an_error_at_the_frequencies_of_the_motion_is_one_of_the_laws():
    """As noise that dies out it would count for little there, and numbers would be too certain."""
    rng = np.random.default_rng(11)
    off = []
    for _ in range(40):
        jacobian = lfilter([1.0], [1.0, -0.9], 1e-2 * rng.normal(size=(300, 2, 2 * N)), axis=0)
        jacobian[:, :, N:] *= 1e-3
        motion, error = swinging(rng, 300, 0.05)
        jacobian[:, 0, :N] = motion
        residual = 1e-4 * rng.normal(size=(300, 2 * N))
        residual[:, :N] += error
        power = motion_power(motion)
        rows = []
        for known in (power, None):
            s = spectrum(residual, jacobian, N, known)
            (v,), found = fit_variances([s], np.zeros(2), np.full(2, 1.0), LENGTH)
            rows.append((found.step[0] / np.sqrt(found.covariance[0, 0]), v.swinging[0]))
        off.append(rows)
    here, without = np.array(off)[:, 0], np.array(off)[:, 1]
    assert np.median(np.sqrt(here[:, 1])) == pytest.approx(0.05, rel=0.2)
    assert np.median(without[:, 1]) < 1e-6
    assert np.std(here[:, 0]) == pytest.approx(1.0, abs=0.35)
    assert np.std(without[:, 0]) > 1.5 * np.std(here[:, 0])


def test_evidence_is_that_of_the_present_values_or_of_those_promised_by_the_derivatives():
    rng = np.random.default_rng(12)
    residual, jacobian, _ = made(rng)
    fitted = residual - np.einsum("fpk,p->fk", jacobian, offset_fit(residual, jacobian))
    for here, gains in ((residual, True), (fitted, False)):
        s = spectrum(here, jacobian, N)
        flat = np.zeros(6), np.full(6, 1e-3)
        ((v,), promised), ((w,), present) = (
            fit_variances([s], *flat, LENGTH, linear=linear) for linear in (True, False)
        )
        assert (promised.evidence > present.evidence + 10.0) == gains
        assert np.all(w.white + w.fading > 2.0 * (v.white + v.fading)) == gains


def offset_fit(residual, jacobian):
    """The parameters' change that fits best with the variances of its own."""
    s = spectrum(residual, jacobian, N)
    return fit_variances([s], np.zeros(6), np.full(6, 1e-3), LENGTH)[1].step


def test_a_residual_of_many_lengths_is_no_error():
    """A trial far from the shapes: its noise has the largest standard deviation that there is."""
    rng = np.random.default_rng(10)
    s = spectrum(20.0 * rng.normal(size=(50, 2 * N)), np.full((50, 1, 2 * N), 1e-6), N)
    (found,), _ = fit_variances([s], np.zeros(1), np.full(1, 100.0), LENGTH)
    assert np.sqrt(found.white) == pytest.approx([core.LARGEST * LENGTH] * 2)


@pytest.mark.parametrize("apart", [0.0, 0.002])
def test_numbers_on_which_recordings_disagree_are_known_less_well(apart):
    """Each recording has a value of its own: the std of their mean is what their spread says."""
    rng = np.random.default_rng(9)
    off, alone = [], []
    for _ in range(60):
        recordings = []
        for _ in range(4):
            jacobian = 1e-2 * rng.normal(size=(80, 2, 2 * N))
            noise = 3e-4 / np.sqrt(N) * rng.normal(size=(80, 2 * N))
            own = np.array([apart * rng.normal(), 0.0])
            recordings.append((noise + np.einsum("fpk,p->fk", jacobian, own), jacobian))
        open_, bins = (np.zeros(2), np.full(2, 1.0)), spectra(recordings, N)
        variances, found = fit_variances(bins, *open_, LENGTH)
        stds = np.sqrt(np.diag(widened_covariance(bins, variances, *open_)))
        off.append(found.step[0] / stds[0])
        alone.append(found.step[0] / np.sqrt(found.covariance[0, 0]))
    held, before = (np.mean(np.abs(z) < 2.0) for z in (off, alone))
    assert held > 0.8
    assert before < 0.4 if apart else held < before + 0.05


@pytest.mark.parametrize("common", [True, False])
def test_errors_that_stay_may_be_the_same_in_all_recordings(common):
    """A camera that is wrong in the same way everywhere, and a number that shifts all shapes."""
    rng = np.random.default_rng(11)
    push = rng.normal(size=2 * N)
    off, sizes = [], []
    for _ in range(30):
        stays = fading(rng, 8, 1e-3 * LENGTH, 0.0).reshape(4, 2 * N)
        recordings = []
        for own in stays:
            jacobian = np.full((60, 1, 1), 1e-2) * push
            noise = 1e-4 / np.sqrt(N) * rng.normal(size=(60, 2 * N))
            recordings.append((noise + (stays[0] if common else own), jacobian))
        variances, found = fit_variances(spectra(recordings, N), np.zeros(1), np.ones(1), LENGTH)
        off.append(found.step[0] / np.sqrt(found.covariance[0, 0]))
        v = variances[0]
        sizes.append(np.sqrt([np.mean(x) for x in (v.shared, v.lasting)]))
    assert np.mean(np.abs(off) < 2.0) > 0.9
    shared, own = np.median(sizes, axis=0)
    if common:
        assert shared == pytest.approx(1e-3 * LENGTH, rel=0.2) and own < 1e-5
    else:
        assert own == pytest.approx(1e-3 * LENGTH, rel=0.2)


def test_what_is_rough_and_the_same_in_all_recordings_does_not_average_out():
    """Shading moves every control point by itself, and may do so in all recordings alike."""
    rng = np.random.default_rng(13)
    push = rng.normal(size=2 * N)
    off = []
    for _ in range(60):
        stays = 1e-3 / np.sqrt(N) * LENGTH * rng.normal(size=2 * N)
        noise = 1e-4 / np.sqrt(N) * rng.normal(size=(6, 60, 2 * N))
        bins = spectra([(stays + x, np.full((60, 1, 1), 1e-2) * push) for x in noise], N)
        (v, *_), found = fit_variances(bins, np.zeros(1), np.ones(1), LENGTH)
        off.append(found.step[0] / np.sqrt(found.covariance[0, 0]))
        assert v.rough.max() < 0.01 * v.shared_rough.mean()
    assert np.mean(np.abs(off) < 1.96) > 0.75  # twenty numbers, of which nothing is known before


def test_details_do_not_judge_a_model_that_is_far_off():
    """Noise of a hundredth of what the model misses counts as a tenth of it; its own is no more.

    What the model misses along the DLO alone, where u may be counted from a wrong end, is no such.
    """
    rng = np.random.default_rng(8)
    noise = 1e-5 / np.sqrt(N) * rng.normal(size=(300, 2 * N))
    missed = np.concatenate([fading(rng, 300, size, 0.9) for size in (8e-3, 6e-3)], axis=1)
    along = missed.copy()
    along[:, :N] = 0.0
    jacobian, open_ = np.full((300, 1, 2 * N), 1e-6), (np.zeros(1), np.full(1, 100.0), LENGTH)
    for residual, least in ((missed + noise, 8e-4), (along + noise, 1e-5), (noise, 1e-5)):
        (found,), _ = fit_variances([spectrum(residual, jacobian, N)], *open_)
        across, lengthwise = np.sqrt(found.white)
        assert across == pytest.approx(least, rel=0.15)
        assert 0.85 * least < lengthwise < 3.0 * least


@pytest.mark.parametrize("nodal", [False, True])
@pytest.mark.parametrize("memory", some_of([0.0, 0.3, 0.6], [0.6]))
def test_a_trackers_smoothing_is_noise_and_no_lack_of_the_model(memory, nodal):
    """Noise of which neighbouring frames share a part, of all points or of control points."""
    rng = np.random.default_rng(7)
    noise = 3e-4 / np.sqrt(N) * rng.normal(size=(400, 2, N))
    if nodal:
        noise = noise @ (vectors := modes(N)[0]) * np.sqrt(N * nodal_shares(N)) @ vectors.T
    for before, now in pairwise(noise):
        now[:] = memory * before + np.sqrt(1.0 - memory**2) * now
    (found,), _ = fit_variances(
        [spectrum(noise.reshape(400, -1), np.full((400, 1, 2 * N), 1e-6), N)],
        np.zeros(1), np.full(1, 100.0), LENGTH,
    )  # fmt: skip
    assert np.sqrt(found.white + found.nodal) == pytest.approx([3e-4, 3e-4], rel=0.1)
    assert np.all((found.nodal > found.white) == nodal)
    assert np.all(np.sqrt(found.fading) < 1.5e-4)
    assert found.noise_memory == pytest.approx([memory, memory], abs=0.05)


def test_a_small_error_that_lasts_along_the_dlo_says_nothing_of_the_noise_across():
    rng = np.random.default_rng(11)
    noise = rng.normal(size=(200, 2, N)) / np.sqrt(N) * np.array([3e-4, 2e-5])[:, None]
    for before, now in pairwise(noise):
        now[1] = 0.85 * before[1] + np.sqrt(1.0 - 0.85**2) * now[1]
    (found,), _ = fit_variances(
        [spectrum(noise.reshape(200, -1), np.full((200, 1, 2 * N), 1e-6), N)],
        np.zeros(1), np.full(1, 100.0), LENGTH,
    )  # fmt: skip
    assert np.sqrt(found.white + found.nodal)[0] == pytest.approx(3e-4, rel=0.05)
    assert found.noise_memory[0] < 0.1


@pytest.mark.parametrize("memory", some_of([0.0, 0.5, 0.95], [0.5]))
def test_intervals_hold_what_they_promise(memory):
    """Correlated errors of any memory: 95 % intervals cover about 95 %."""
    rng = np.random.default_rng(4)
    off = []
    for _ in range(40):
        residual, jacobian, theta = made(rng, memory=memory)
        s = spectrum(residual, jacobian, N)
        _, found = fit_variances([s], np.zeros(6), np.full(6, 100.0), LENGTH)
        off.append((found.step - theta) / np.sqrt(np.diag(found.covariance)))
    covered = np.mean(np.abs(off) < 1.96)
    assert 0.90 < covered < 0.99


def test_one_picture_leaves_no_room_for_what_dies_out():
    rng = np.random.default_rng(5)
    residual, jacobian, _ = made(rng, frames=1)
    (found,), _ = fit_variances(
        [spectrum(residual, jacobian, N)], np.zeros(6), np.full(6, 100.0), LENGTH
    )
    assert np.all(found.fading < 1e-10)


@pytest.mark.parametrize("frames", some_of([3, 40], [3]))
def test_frames_of_one_pose_are_one_measurement(frames):
    """What is wrong in all of them alike does not average out, however often it was seen."""
    rng = np.random.default_rng(8)
    off = []
    for _ in range(60):
        jacobian = np.repeat(1e-2 * rng.normal(size=(1, 2, 2 * N)), frames, axis=0)
        theta = 0.1 * rng.normal(size=2)
        pose = 3e-4 * rng.normal(size=(1, 2 * N))
        residual = pose + 5e-6 * rng.normal(size=(frames, 2 * N))
        residual += np.einsum("fpk,p->fk", jacobian, theta)
        _, found = fit_variances(
            [spectrum(residual, jacobian, N)], np.zeros(2), np.full(2, 100.0), LENGTH
        )
        off.append((found.step - theta) / np.sqrt(np.diag(found.covariance)))
    assert np.mean(np.abs(off) < 1.96) > 0.75  # twenty numbers, of which nothing is known before


def test_a_needless_parameter_costs_evidence():
    rng = np.random.default_rng(6)
    residual, jacobian, _ = made(rng)
    needless = np.concatenate([jacobian, rng.normal(size=(250, 1, 2 * N))], axis=1)
    tiny = np.full(2, 1e-12)
    fades = np.full(2, 4e-6), *[tiny] * 5, 0.9, np.zeros(2)
    v = [Variances(np.full(2, 9e-8), tiny, *fades)]
    spare = posterior([spectrum(residual, jacobian, N)], v, np.zeros(6), np.full(6, 100.0))
    more = posterior([spectrum(residual, needless, N)], v, np.zeros(7), np.full(7, 1e-2))
    assert more.evidence < spare.evidence - 1.0


def test_parameters_stay_in_their_range_and_know_their_logarithm():
    settings = Settings(rod=RodParameters(LENGTH, 0.004, 1e7, 2000.0)).with_effects(
        {"point_mass": {"mass": 0.01, "position": 0.4}}
    )
    model = ParametricModel(
        settings,
        (
            Parameter("young_modulus", "Pa", True, 1e3, 1e12, np.log(1e7), 4.0, guessed=True),
            Parameter("effects.point_mass.mass", "kg", False, 0.0, 10.0, 0.0, 0.1),
        ),
    )
    assert model.theta() == pytest.approx([np.log(1e7), 0.01])
    moved = model.at(np.array([np.log(2e7), -1.0]))
    assert moved.settings.rod.young_modulus == pytest.approx(2e7)
    assert moved.settings.effects["point_mass"]["mass"] == 0.0
    assert model.without(["effects.point_mass.mass"]).settings.effects == {
        "point_mass": {"position": 0.4}
    }
