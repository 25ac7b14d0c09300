# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The set-up within its tolerances: found where the data show it, and counted in every std."""

from dataclasses import replace

import numpy as np
import pytest
from experiment_recordings import fitted_set_up, moving
from field.coverage import condition
from live_estimates import live_estimate
from measured import at_rest, swing
from ordinary import some_of
from rods import PAPER
from scipy.spatial.transform import Rotation

from dlo_ros.cli.main import main
from dlo_ros.command import Command
from dlo_ros.identification import OnlineEstimator, identify
from dlo_ros.identification.estimate import inverse
from dlo_ros.identification.information import widened
from dlo_ros.identification.offline import set_up_estimate
from dlo_ros.identification.offline.set_up_estimate import _information, mixed
from dlo_ros.inference.joint import evaluate
from dlo_ros.inference.joint_fit import expected_gain
from dlo_ros.inference.losses import CORRELATED
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings, tolerance
from dlo_ros.rod.live_simulation import LiveSimulation
from dlo_ros.rod.sensitivity_parameters import variation_of

pytestmark = pytest.mark.long

RATIO = PAPER.rod.specific_modulus
TURNED = 0.04  # [rad]
DELAY = 0.05  # [s]


def with_values(settings, **values):
    """Settings with other values, dots written as two underscores."""
    changed = {key.replace("__", "."): value for key, value in values.items()}
    return Settings.from_mapping(settings.flat() | changed)


@pytest.fixture(scope="module")
def turned():
    """A swing of which the command tells another direction of the clamp than it had."""
    recording = swing(PAPER, seconds=1.5)
    (imposed,) = recording.commands
    _, other = variation_of(PAPER, "start.angle").vary(PAPER, imposed, -TURNED)
    return replace(recording, commands=(other,))


@pytest.fixture(scope="module")
def guess():
    return PAPER.with_material(2e7, 2000.0)


@pytest.mark.slow
def test_a_clamp_that_is_off_leads_a_fit_into_no_wrong_valley():
    """With 23 % of E/mu and five times the ERR a first fit ends there."""
    drawn = condition(7833, "clamp")
    found = identify(drawn.recordings, drawn.guess)
    assert abs(np.log(found.estimate.specific_modulus / drawn.ratio)) < 0.02
    assert found.fitted.at.mean_err < 2e-4


@pytest.mark.slow
def test_a_rope_that_keeps_its_coil_leads_a_fit_into_no_wrong_valley():
    """Its curvature at rest is nine tolerances; a first fit ends with a third of E/mu."""
    drawn = condition(8801, "coil")
    found = identify(drawn.recordings, drawn.guess)
    assert abs(np.log(found.estimate.specific_modulus / drawn.ratio)) < 0.04
    assert found.fitted.at.mean_err < 1e-3
    curved = [
        value for name, (value, _) in found.fitted.set_up.items() if "intrinsic_curvature" in name
    ]
    assert np.abs(curved).mean() * drawn.guess.rod.length > 3.0


def test_a_clamp_that_points_elsewhere_is_found_and_the_ratio_with_it(turned, guess):
    exact = with_values(
        guess,
        **{
            f"effects__{name}__{key}_std": 0.0
            for name, key in (("clamp_angle", "start"), ("gravity_tilt", "angle"),
                              ("camera_rotation", "angle"), ("clamp_offset", "start"))
        },
    )  # fmt: skip
    assert tolerance(exact, "clamp_angle.start") == 0.0
    without = identify([turned], exact)
    assert "effects.clamp_angle.start" not in without.fitted.set_up
    found = identify([turned], guess)
    value, std = found.fitted.set_up["effects.clamp_angle.start"]
    assert abs(value - TURNED) < 3.0 * std
    assert std < 0.02
    estimate = found.estimate
    assert abs(estimate.specific_modulus - RATIO) < 2.0 * estimate.specific_modulus_std
    assert estimate.specific_modulus == pytest.approx(RATIO, rel=0.02)
    assert found.recordings[0].err < 0.7 * without.recordings[0].err
    # What the nodes load contains it.
    assert estimate.settings.effects["clamp_angle"]["start"] == value


def test_a_set_up_as_stated_is_taken_as_exact(guess):
    found = identify([swing(PAPER, seconds=1.5)], guess)
    assert found.fitted.set_up == {}
    assert not found.estimate.settings.effects
    assert found.estimate.specific_modulus == pytest.approx(RATIO, rel=2e-3)


@pytest.mark.parametrize("std", some_of([0.0, 1e-3], [1e-3]))
def test_what_is_known_of_an_effect_to_a_std_is_known_no_better(std):
    """Shapes tell the mass over the density, which is known as well as the mass is."""
    hung = {"point_mass": {"mass": 0.006, "position": 0.3}}
    recording, guess = moving("simple", hung, 33)
    known = guess.with_effects(hung).flat() | {"effects.point_mass.mass_std": std}
    found = identify([recording], Settings.from_mapping(known)).estimate
    expected = std / 0.006 * found.settings.rod.density
    assert found.density_std == pytest.approx(expected, rel=0.25, abs=50.0)


def test_a_mixture_has_the_variance_of_both_and_of_what_lies_between():
    a, b = np.diag([4.0, 1.0]), np.diag([1.0, 0.25])
    apart = np.array([0.5, 0.0])
    found = np.linalg.inv(mixed(a, b, 0.25, apart))
    wanted = 0.75 * np.linalg.inv(a) + 0.25 * (np.linalg.inv(b) + np.outer(apart, apart))
    assert np.allclose(found, wanted)
    assert np.allclose(mixed(a, b, 0.0, apart), a)


def test_what_a_fit_has_not_reached_counts_in_the_std():
    at, recordings = fitted_set_up()
    ratio = np.array([1.0, -1.0, 0.0, 0.0])  # of ln (E, mu, c, t_r)

    def std(found):
        known = _information(found) + 1e-2 * np.eye(4)
        return float(np.sqrt(ratio @ np.linalg.solve(known, ratio)))

    off = evaluate(at.model.stiffened(1.2), recordings)
    assert expected_gain(off, CORRELATED) > 10.0 > expected_gain(at, CORRELATED)
    assert std(off) > 3.0 * std(at)
    assert std(off) == pytest.approx(np.log(1.2), rel=0.3)


def test_a_model_that_is_far_from_the_shapes_claims_little(monkeypatch):
    at, _ = fitted_set_up()
    unknown = np.zeros(4)
    monkeypatch.setattr(set_up_estimate, "model_shift", lambda *_, **__: unknown)
    monkeypatch.setattr(set_up_estimate, "next_step", lambda a, _: np.zeros(len(a.model.names)))
    near = set_up_estimate._information(at)
    length = at.model.settings.rod.length
    for share, factor in ((0.005, 1.0), (0.1, 10.0)):
        far = replace(at, err=tuple(np.full_like(e, share * length) for e in at.err))
        assert set_up_estimate._information(far) == pytest.approx(near / factor**2, rel=1e-9)


def test_what_is_open_stays_open():
    ratio = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    told = 1e4 * np.outer(ratio, ratio)
    for found in (mixed(told, 0.1 * told, 0.5, ratio), widened(told, 0.1 * ratio)):
        values, vectors = np.linalg.eigh(found)
        assert np.abs(values[:2]).max() < 1e-9 * values[2]
        assert abs(vectors[:, 2] @ ratio) == pytest.approx(1.0)
    assert ratio @ widened(told, 0.1 * ratio) @ ratio == pytest.approx(1.0 / (1e-4 + 1e-2))


@pytest.mark.slow
def test_a_density_that_is_open_stays_so_where_recordings_disagree_on_the_drag(guess):
    recordings = [swing(PAPER, seconds=0.8, seed=k) for k in range(3)]
    information = identify(recordings, guess).fitted.information
    alike = np.array([1.0, 1.0, 1.0, 0.0])  # E, mu and drag together leave every shape as it is
    assert alike @ information @ alike < 1e-8 * information[0, 0]


def test_a_mixture_with_nothing_tells_what_the_likelier_one_does():
    """A scale that is hardly known, and in no exact direction: 2.4 % became of 0.35."""
    ratio, scale = np.array([1.0, -1.0 + 1e-4]), np.array([1.0, 1.0])
    told = 1e6 * np.outer(ratio, ratio) + 1e-4 * np.outer(scale, scale)
    found = inverse(mixed(told, 0.1 * told, 0.0, ratio))
    wanted = np.linalg.inv(told)
    across = np.array([1.0, -1.0])
    assert across @ found @ across == pytest.approx(across @ wanted @ across, rel=1e-3)
    assert scale @ found @ scale == pytest.approx(scale @ wanted @ scale, rel=1e-3)


def test_what_cannot_be_told_apart_widens_the_std(guess):
    # Shapes at rest tell little of how they are held.
    exact = identify([at_rest(PAPER, same=False)], guess).estimate
    unsure = with_values(guess, rod__diameter_std=0.02 * PAPER.rod.diameter)
    found = identify([at_rest(PAPER, same=False)], unsure).estimate
    assert found.specific_modulus_std > 0.039 * RATIO > exact.specific_modulus_std


def test_live_a_clamp_that_points_elsewhere_is_counted_in_the_std(turned, guess):
    found = live_estimate(turned, guess)
    off = abs(found.specific_modulus - RATIO)
    assert off > 0.01 * RATIO
    assert off < 2.0 * found.specific_modulus_std
    exact = live_estimate(swing(PAPER, seconds=1.5), guess)
    assert exact.specific_modulus_std < 0.2 * found.specific_modulus_std


def test_live_the_set_up_waits_for_the_time_between_pictures(turned, guess):
    estimator = OnlineEstimator(guess, clock=lambda: 0.0)  # all that is due fits into an update
    estimator.set_command(turned.commands[0])
    for observation in turned.observations:
        estimator.observe(observation)
    before = estimator.estimate
    assert estimator.busy
    while estimator.busy:
        estimator.proceed()
    after = estimator.estimate
    assert after.specific_modulus == before.specific_modulus
    assert after.specific_modulus_std > 2.0 * before.specific_modulus_std


def test_live_a_delay_of_the_pictures_is_found_unless_it_is_stated(guess):
    recording = swing(PAPER, seconds=1.5)
    late = replace(recording, commands=tuple(c.later(-DELAY) for c in recording.commands))
    value, std = live_estimate(late, guess).delay
    assert abs(value - DELAY) < min(3.0 * std, 5e-4)
    assert std < 2e-3
    stated = live_estimate(late, with_values(guess, effects__command_delay__delay=DELAY))
    assert stated.delay is None
    assert stated.specific_modulus == pytest.approx(RATIO, rel=0.01)


def test_live_a_grip_that_comes_later_brings_numbers_of_its_own(guess):
    """The other end is held where it is once the motion is over."""
    recording = swing(PAPER, seconds=1.5)
    (imposed,) = recording.commands
    observations = list(recording.observations)
    rod = LiveSimulation(PAPER)
    rod.set_command(imposed)
    rod.start(observations[:1])
    estimator = OnlineEstimator(guess, budget=np.inf)
    estimator.set_command(imposed)
    for observation in observations:
        estimator.observe(observation)
    stamp = observations[-1].stamp
    end, along = rod.advance(stamp).control_points[[-1, -2], :3]
    turn, _ = Rotation.align_vectors([end - along], [[1.0, 0.0, 0.0]])
    position, rotation = imposed.sample(stamp)
    both = Command(
        stamp, ("start", "end"), np.zeros(1), np.array([[position[0], end]]),
        np.array([[rotation[0], turn.as_quat()]]), np.full((1, 2, 3), np.nan),
        PAPER.rod.control_points,
    )  # fmt: skip
    rod.set_command(both)
    estimator.set_command(both)
    for _ in range(len(observations)):
        stamp += 40_000_000
        estimator.observe(Observation(stamp, rod.advance(stamp).control_points))
    assert estimator.estimate.specific_modulus == pytest.approx(RATIO, rel=0.02)


def test_live_a_rod_at_rest_tells_no_delay(guess):
    value, std = live_estimate(at_rest(PAPER, same=False), guess).delay
    known = tolerance(guess, "command_delay.delay")
    assert abs(value) < known
    assert std == pytest.approx(known, rel=0.05)


def test_a_negative_std_is_told_in_a_line(tmp_path, capsys):
    params = tmp_path / "params.yaml"
    PAPER.dump(params)
    words = ["identify", "--params", str(params), "--output", str(tmp_path / "out"), "bag"]
    assert main([*words, "--tilt-std", "-0.1"]) == 2
    assert "--tilt-std is -0.1; it must be zero or positive" in capsys.readouterr().err
