# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measured points against a predicted shape: closed forms, an independent rod, unusable points."""

import json
from dataclasses import replace

import numpy as np
import pytest
from challenge.generate import _recordings
from challenge.manipulations import carry, swing, wave

from dlo_ros.cli.main import main
from dlo_ros.identification import Manipulation, identify
from dlo_ros.inference.forecast import compared
from dlo_ros.inference.measured import measured
from dlo_ros.inference.observation_operator import noise_unit, operator_of
from dlo_ros.observation import CentrelinePoints, Observation
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import (
    BAG_MESSAGES,
    command_message,
    observation_messages,
    points_message,
)
from dlo_ros.recordings.read import read_recording
from dlo_ros.recordings.write import BagWriter
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.experiment import read_experiment
from dlo_ros.synthesis.synthesize import measure
from dlo_ros.synthesis.true_motion import build_simulation, project, simulate

L, STD = 0.5, 1e-4


def arc(u, radius=0.25):
    """A rope along a circle."""
    angle = np.asarray(u) / radius
    return radius * np.column_stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle) - 1.0])


def spline(points, n):
    shape = np.zeros((n, 4))
    shape[:, :3] = SplineBasis(n, L).fit(points.u, points.positions)
    return shape


def seen(n, u, positions=None, std_along=None):
    positions = arc(u) if positions is None else positions
    points = CentrelinePoints(positions, u, np.full(len(u), STD), std_along)
    return Observation(0, spline(points, n), points)


def against(observation, predicted):
    """Residual (n, 3) of `Forecast` [m]."""
    n = len(predicted)
    return compared([observation], predicted[None], None, SplineBasis(n, L), 1, 0.0).residual[0]


def test_even_points_give_the_mean_squared_distance_along_u():
    u = np.linspace(0.0, L, 400)
    observation = seen(16, u)
    moved = observation.control_points.copy()
    moved[:, :3] -= 1e-3 * arc(SplineBasis(16, L).greville) / 0.25  # in part across, in part along
    plain = Observation(0, observation.control_points)
    whole = float(np.sum(against(plain, moved) ** 2))
    operator = operator_of(observation, L)
    unit = noise_unit([observation], L)
    across = unit * operator.residual(moved[:, :3])[0]
    basis = SplineBasis(16, L)
    at, weight = basis.quadrature()
    gap = basis.matrix(at) @ (observation.control_points - moved)[:, :3]
    outwards = arc(at) + np.array([0.0, 0.0, 0.25])
    outwards /= np.linalg.norm(outwards, axis=1)[:, None]
    true = float(weight @ np.sum(gap * outwards, axis=1) ** 2 / L)
    assert np.sum(across**2) == pytest.approx(true, rel=0.02)
    assert np.sum(against(observation, moved) ** 2) < whole  # u is known to a thousandth of L only
    # It is linear: what a change of control points does is its derivative.
    change = moved[:, :3] - observation.control_points[:, :3]
    off = operator.residual(observation.control_points[:, :3]) - operator.residual(moved[:, :3])
    np.testing.assert_allclose(off, operator.moved(change), atol=1e-9)
    turned = operator.in_space(off)
    np.testing.assert_allclose(np.sum(turned**2), np.sum(off**2))


def test_what_was_not_seen_asks_for_nothing():
    u = np.linspace(0.0, L, 300)
    observation = seen(20, u[(u < 0.2) | (u > 0.38)])
    beside = observation.control_points.copy()
    support = [k for k in range(20) if 0.2 < SplineBasis(20, L).knots[k] <= 0.38 - 4 * L / 17]
    assert support
    beside[support, 2] += 0.01
    np.testing.assert_allclose(
        against(observation, beside), against(observation, observation.control_points), atol=1e-12
    )
    plain = Observation(0, observation.control_points)
    assert np.linalg.norm(against(plain, beside)) > 1e-3


@pytest.mark.parametrize("n", [6, 9, 14])
def test_control_points_that_cannot_follow_do_no_harm(n):
    u = np.linspace(0.0, L, 250)
    course = arc(u, 0.06)
    observation = seen(n, u, course)
    true = np.zeros((n, 4))
    true[:, :3] = project(SplineBasis(n, L), lambda at: arc(at, 0.06))
    missed = np.sqrt(np.mean((SplineBasis(n, L).matrix(u) @ true[:, :3] - course) ** 2))
    left = np.linalg.norm(against(observation, true))
    assert left < max(0.05 * missed, 1e-6)


def test_a_stretched_u_counts_for_what_it_is_worth():
    u = np.linspace(0.0, L, 250)
    true = spline(CentrelinePoints(arc(u), u, np.full(250, STD)), 14)
    late = u / 1.01
    known = against(seen(14, late, arc(u)), true)
    stated = against(seen(14, late, arc(u), np.hypot(0.01 * late, STD)), true)
    assert np.linalg.norm(known) > 2.0 * np.linalg.norm(stated)
    plain = Observation(0, seen(14, late, arc(u)).control_points)
    assert np.linalg.norm(against(plain, true)) > 20.0 * np.linalg.norm(stated)


def test_a_recording_of_the_diagnosis_sees_the_same_and_keeps_pictures_without_points():
    u = np.linspace(0.0, L, 120)
    off = np.array([1e-4, 0.0, 1e-4, 0.0])
    first, bare = seen(12, u), Observation(40, seen(12, u).control_points + off)
    no_std = CentrelinePoints(arc(u), u, np.full(120, np.nan))
    broken = Observation(80, first.control_points + 2.0 * off, no_std)
    few = Observation(
        120, first.control_points + 3.0 * off, CentrelinePoints(arc(u[:2]), u[:2], np.full(2, STD))
    )
    assert operator_of(broken, L) is None and operator_of(few, L) is None
    assert operator_of(bare, L) is None and noise_unit([bare, broken], L) is None
    tree = _recordings(np.random.default_rng(3), [swing(np.random.default_rng(3))], STD)[0]
    experiment = read_experiment(tree, "kept", "test")
    rod = replace(experiment.guess.rod, length=L, control_points=12)
    manipulation = Manipulation("kept", (experiment.command,), (first, bare, broken, few))
    recording = measured(manipulation, replace(experiment.guess, rod=rod))
    predicted = np.array([first.control_points] * 4)
    left = recording.residual(predicted)
    assert np.isfinite(left).all()
    operator, unit = operator_of(first, L), noise_unit([first], L)
    own = unit * operator.residual(first.control_points[:, :3])[:2].ravel()
    np.testing.assert_allclose(left[0], own, atol=1e-12)
    sizes = np.linalg.norm(left, axis=1)
    np.testing.assert_allclose(sizes[1:], [1.41e-4, 2.83e-4, 4.24e-4], rtol=0.25)
    # Without the first picture its points are gone, too.
    np.testing.assert_allclose(recording.until(1).residual(predicted[:1])[0], left[0])


def late(observation, length, share):
    """What is seen where something beyond the free end is taken for it."""
    points = observation.points
    tip, n = points.positions[-1], len(observation.control_points)
    ahead = tip - points.positions[-3]
    steps = np.linspace(0.0, share * length, 4)[1:]
    positions = np.vstack([points.positions, tip + steps[:, None] * ahead / np.linalg.norm(ahead)])
    u = np.append(points.u, length + steps) / (1.0 + share)
    std = np.full(len(u), points.std[0])
    shape = np.zeros((n, 4))
    shape[:, :3] = SplineBasis(n, length).fit(u, positions)
    cloud = CentrelinePoints(positions, u, std, np.hypot(share * u, std))
    return Observation(observation.stamp, shape, cloud)


def filmed(seed, kind, share, frames=None):
    """A recording of the independent rod, u stretched by a share towards its free end."""
    rng = np.random.default_rng(seed)
    experiment = read_experiment(_recordings(rng, [kind(rng)], 2e-4)[0], "filmed", "test")
    simulation, _ = build_simulation(experiment)
    rod = experiment.truth.rod
    truth = simulate(simulation, experiment.stamps[:frames], rod.length)
    found = []
    for i, points, shape in measure(experiment, truth, range(len(truth.stamps)), seed):
        four = np.column_stack([shape, np.zeros(len(shape))])
        one = Observation(truth.stamps[i], four, points)
        found.append(late(one, rod.length, share))
    return experiment, Manipulation("filmed", (experiment.command,), tuple(found))


def test_the_tool_is_right_where_u_is_stretched(tmp_path, capsys):
    experiment, recording = filmed(95201, swing, 0.01, frames=24)
    bag = tmp_path / "bag"
    with BagWriter(bag) as writer:
        command = experiment.command
        writer.write(topics.COMMAND, command_message(BAG_MESSAGES, command), command.stamp)
        for one in recording.observations:
            for topic, message in observation_messages("board", one):
                writer.write(topic, message, one.stamp)
    experiment.guess.dump(tmp_path / "params.yaml")
    words = ["identify", "--params", str(tmp_path / "params.yaml"), "--output"]
    assert main([*words, str(tmp_path / "result"), str(bag)]) == 0
    found = json.loads((tmp_path / "result" / "estimate.json").read_text())["specific_modulus"]
    true = experiment.truth.rod.specific_modulus
    assert found["value"] == pytest.approx(true, rel=0.004)
    assert abs(found["value"] - true) < 3.0 * found["std"]


def test_points_and_splines_that_disagree_are_told(tmp_path):
    u = np.linspace(0.0, L, 60)
    right, elsewhere = seen(10, u), seen(10, u).points
    elsewhere = replace(elsewhere, positions=elsewhere.positions + np.array([0.3, 0.0, 0.0]))
    bag = tmp_path / "bag"
    with BagWriter(bag) as writer:
        for stamp, points in ((10**9, right.points), (2 * 10**9, elsewhere), (3 * 10**9, None)):
            one = Observation(stamp, right.control_points, points)
            for topic, message in observation_messages("board", one):
                writer.write(topic, message, stamp)
        late = points_message(BAG_MESSAGES, 3 * 10**9 + 5, "board", right.points)
        writer.write(topics.OBSERVED_POINTS, late, 3 * 10**9 + 5)
    tree = _recordings(np.random.default_rng(3), [swing(np.random.default_rng(3))], STD)[0]
    settings = read_experiment(tree, "told", "test").guess
    settings = replace(settings, rod=replace(settings.rod, length=L, control_points=10))
    recording = read_recording(bag, settings, require_command=False)
    assert [o.points is None for o in recording.observations] == [False, False, True]
    assert "have the stamp of no spline" in " ".join(recording.skipped)
    usable = [operator_of(o, L) is not None for o in recording.observations]
    assert usable == [True, False, False]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed"),
    [(swing, 95210), (swing, 95211), (carry, 95210), (wave, 95210), (wave, 95211)],
)
def test_stretched_u_and_few_control_points_leave_e_over_mu_alone(kind, seed):
    experiment, recording = filmed(seed, kind, 0.01)
    true = experiment.truth.rod.specific_modulus
    off = {}
    for name, n in (("ten", 10), ("seven", 7)):
        rod = replace(experiment.guess.rod, control_points=n)
        basis = SplineBasis(n, rod.length)
        shapes = []
        for one in recording.observations:
            four = np.zeros((n, 4))
            four[:, :3] = basis.fit(one.points.u, one.points.positions)
            shapes.append(replace(one, control_points=four))
        command = replace(experiment.command, control_points=n)
        again = Manipulation(name, (command,), tuple(shapes))
        found = identify([again], replace(experiment.guess, rod=rod)).estimate
        off[name] = found.specific_modulus / true - 1.0
        assert abs(off[name]) < 0.004
        assert abs(off[name]) * true < 3.0 * found.specific_modulus_std
    assert abs(off["ten"] - off["seven"]) < 0.002
