# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The planar form is the spatial rod with fewer coordinates; what cannot be followed is held."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command, held_start, straight

from dlo_ros.command import Motion
from dlo_ros.errors import SimulationError
from dlo_ros.observation import Observation
from dlo_ros.rod import LiveSimulation, dynamics
from dlo_ros.rod.planar_model import in_plane
from dlo_ros.rod.resolution import build
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod.statics import settle
from dlo_ros.spline import SplineBasis


def curved(u):
    """Curved at rest about y."""
    return np.column_stack([3.0 * np.sin(8.0 * u), np.zeros_like(u), np.zeros_like(u)])


def motion():
    return command(
        ["start", "control_point_6", "control_point_10"],
        [0.0, 0.3],
        [
            [[0, 0, 0], [0.2, 0, -0.1], [0.36, 0, -0.05]],
            [[0, 0, 0], [0.2, 0, -0.09], [0.35, 0, -0.07]],
        ],
    )


def both(monkeypatch, work):
    """The same work in the plane and, forced, in space."""
    flat = work()
    for module in ("dynamics", "statics", "simulation"):
        monkeypatch.setattr(f"dlo_ros.rod.{module}.in_plane", lambda *_: False)
    return flat, work()


def test_motion_and_sensitivities_agree_with_those_in_space(monkeypatch):
    imposed = motion()
    model, boundary = build(PAPER, imposed, 14)
    model = replace(model, rest=curved)
    # In space it would tip over on the way from straight.
    first = settle(model, boundary, straight(model), imposed, 0).state

    def work():
        state = settle(model, boundary, first, imposed, 0, parameters=MATERIAL).state
        stamps = [k * SECOND // 20 for k in range(1, 11)]
        return dynamics.follow(model, boundary, state, imposed, stamps, MATERIAL)

    flat, space = both(monkeypatch, work)
    np.testing.assert_allclose(flat.shapes, space.shapes, atol=1e-9)
    scale = np.abs(space.derivatives).max()
    np.testing.assert_allclose(flat.derivatives, space.derivatives, atol=1e-6 * scale)
    for name in ("velocity", "auxiliary"):
        np.testing.assert_allclose(getattr(flat.state, name), getattr(space.state, name), atol=1e-4)
    np.testing.assert_allclose(
        flat.state.reference.tangent, space.state.reference.tangent, atol=1e-8
    )
    np.testing.assert_allclose(flat.state.strains.other, space.state.strains.other, atol=1e-5)


def test_what_leaves_the_plane_is_seen():
    imposed = held_start()
    model, _ = build(PAPER, imposed, 7)
    state = straight(model)
    assert in_plane(model, state, imposed)
    bent = state.q.copy()
    bent[-1, 1] = 1e-6
    assert not in_plane(model, replace(state, q=bent), imposed)
    sideways = replace(model, rest=lambda u: np.column_stack([0 * u, 0 * u + 1.0, 0 * u]))
    assert not in_plane(sideways, state, imposed)
    assert not in_plane(replace(model, point_forces=((0.4, (0.0, 0.1, 0.0)),)), state, imposed)
    windy = model.with_settings(replace(PAPER, gravity=(0.0, 0.5, -9.8)))
    assert not in_plane(windy, state, imposed)
    assert not in_plane(model, state, command(["start"], [0.0], [[0.0, 0.1, 0.0]]))
    rolled = command(["start"], [0.0], [[0.0, 0.0, 0.0]], [[[0.1, 0.0, 0.0, 0.995]]])
    assert not in_plane(model, state, rolled)


def test_an_equilibrium_that_would_leave_the_plane_is_called_unstable():
    """A rope that sags between two clamps in line: close together, it turns out of the plane."""
    shares = np.linspace(0.98, 0.1, 23)
    imposed = command(
        ["start", "end"], np.arange(23.0), [[[0, 0, 0], [0.4 * s, 0, 0]] for s in shares]
    )
    model, boundary = build(PAPER, imposed, 14)
    state = straight(model)
    state.q[:, 2] = -0.02 * np.sin(np.pi * model.basis.greville / 0.4) ** 2
    stable, left = [], []
    for k in range(23):
        found = settle(model, boundary, state, imposed, k * SECOND)
        state = found.state
        assert np.abs(state.q[:, 1]).max() < 1e-12
        stable.append(found.stable)
        pushed = replace(state, q=state.q + 0.0)
        pushed.q[4:-4, 1] += 1e-4
        left.append(
            np.abs(settle(model, boundary, pushed, imposed, k * SECOND).state.q[:, 1]).max()
        )
    assert stable[0]
    assert not stable[-1]
    # What is called unstable does leave the plane when it is pushed out of it, and nothing else.
    np.testing.assert_array_equal(np.array(left) > 1e-3, ~np.array(stable))


def test_an_unstable_start_is_told_of_the_dlo_and_not_of_a_hypothesis(caplog):
    """Clamps near each other: the rope between them would turn out of the plane."""
    motion = Motion([command(["start", "end"], [0.0], [[[0, 0, 0], [0.04, 0, 0]]])])
    u = SplineBasis(10, 0.4).greville / 0.4
    sagging = np.column_stack([0.04 * u, 0 * u, -0.19 * np.sin(np.pi * u), 0 * u])
    tried, whole = (Simulation(PAPER, motion, spans=14) for _ in range(2))
    list(tried.starting([Observation(0, sagging)]))
    assert not tried.stable and not caplog.records
    whole.start([Observation(0, sagging)])
    (record,) = caplog.records
    assert "unstable out of the plane y = 0" in record.getMessage()


def test_a_forecast_in_one_go_is_the_same_as_stamp_by_stamp(monkeypatch):
    basis = SplineBasis(10, 0.4)
    shape = np.zeros((10, 4))
    shape[:, 0] = basis.greville
    stamps = [k * SECOND // 30 for k in range(1, 25)]
    moves = [
        command(["start"], [0.0, 0.2], [[[0, 0, 0]], [[0.0, 0, 0.1]]]),
        command(["start"], [0.0], [[[0.0, 0, 0.1]]], stamp=SECOND // 2),
    ]

    def simulation():
        new = Simulation(PAPER, Motion(list(moves)),
                         parameters=MATERIAL[:2], spans=14)  # fmt: skip
        new.start([Observation(0, shape)])
        return new

    at_once = simulation().advance_through(stamps)
    single = simulation()
    for stamp, prediction in zip(stamps, at_once, strict=True):
        one = single.advance(stamp)
        assert one.stamp == prediction.stamp == stamp
        # Every call ends a step; in one go most of these lie within steps. The tolerance is 8e-5 m.
        np.testing.assert_allclose(
            one.control_points, prediction.control_points, rtol=0.0, atol=8e-5
        )
        # Against a tolerance of 1e-6 either of them is up to 4e-3 m off, the values up to 0.24 m.
        np.testing.assert_allclose(one.sensitivity, prediction.sensitivity, rtol=0.0, atol=1e-3)

    follow = dynamics.follow
    monkeypatch.setattr(dynamics, "follow", lambda *a, **k: follow(*a, **{**k, "stepwise": True}))
    stepwise, single = simulation().advance_through(stamps), simulation()
    for stamp, prediction in zip(stamps, stepwise, strict=True):
        one = single.advance(stamp)
        # Every call begins without the pace of Newton's method, which may leave a thousandth of
        # the tolerance, 8e-5 m.
        np.testing.assert_allclose(one.control_points, prediction.control_points, atol=8e-8)
        np.testing.assert_allclose(one.sensitivity, prediction.sensitivity, atol=2e-6)


def test_a_live_simulation_holds_and_recovers(caplog):
    shape = np.zeros((10, 4))
    shape[:, 0] = SplineBasis(10, 0.4).greville
    live = LiveSimulation(PAPER)
    live.set_command(held_start())
    live.start([Observation(0, shape)])
    before = live.advance(SECOND // 10).control_points
    live.set_command(
        command(["start", "end"], [0.0], [[[0, 0, 0], [0.9, 0, 0]]], stamp=SECOND // 10)
    )
    for k in (2, 3):
        with pytest.raises(SimulationError, match="apart"):
            live.advance(k * SECOND // 10)
    live.set_command(
        command(
            ["start", "control_point_10"],
            [0.0],
            [[[0, 0, 0], [0.2, 0, -0.2]]],
            stamp=4 * SECOND // 10,
        )
    )
    with caplog.at_level(logging.WARNING):
        after = live.advance(SECOND // 2).control_points
    np.testing.assert_allclose(after[-1, :3], [0.2, 0.0, -0.2], atol=1e-9)
    assert np.abs(before[-1, :3] - after[-1, :3]).max() > 0.01
    live.advance(SECOND)
    live.update(PAPER.with_material(2e7, 2500.0))
    assert np.all(np.isfinite(live.advance(SECOND + 1000).control_points))


def test_a_clamp_that_is_found_beside_the_plane_leaves_it_at_once():
    """Stops in one call are those one by one: axial twist is published, not theta."""
    soft = replace(PAPER, rod=replace(PAPER.rod, young_modulus=5e6))
    share = SplineBasis(10, 0.4).greville / 0.4
    first = np.zeros((10, 4))
    first[:, 0], first[:, 2] = 0.26 * share, -0.1 * np.sin(np.pi * share)
    imposed = command(
        ["start", "end"], [0.0, 0.2],
        [[[0.0, 0.0, 0.0], [0.26, 0.0, 0.0]], [[0.02, 0.0, 0.04], [0.26, 0.0, 0.0]]],
    )  # fmt: skip
    stops = [k * SECOND // 100 for k in (6, 7, 8, 9)]

    def seen(follow):
        simulation = Simulation(soft, Motion([imposed]), spans=12)
        simulation.start([Observation(0, first)])
        simulation.advance(SECOND // 20)
        simulation.update(soft.with_effects({"clamp_offset": {"end": (0.0, 0.003, 0.0)}}))
        return np.array([p.control_points for p in follow(simulation)])

    together = seen(lambda simulation: simulation.advance_through(stops))
    apart = seen(lambda simulation: [simulation.advance(stop) for stop in stops])
    assert np.abs(apart[:, :, 1]).max() > 2e-3
    np.testing.assert_allclose(together, apart, atol=2e-4)


def turned(angle, stamp):
    """The start held and turned downwards by an angle [rad]."""
    rotation = [0.0, np.sin(0.5 * angle), 0.0, np.cos(0.5 * angle)]
    return command(["start"], [0.0], [[[0, 0, 0]]], [[rotation]], stamp=stamp)


def test_a_first_shape_that_overtakes_its_command_does_no_harm():
    """A node may have started from it under the command of a recording before."""
    first = np.zeros((10, 4))
    first[:, 0] = SplineBasis(10, 0.4).greville
    stamp, later = 100 * SECOND, 100 * SECOND + SECOND // 4
    lives = [LiveSimulation(PAPER) for _ in range(2)]
    for live, commands in zip(lives, [(held_start(),), (turned(0.4, 0),)], strict=True):
        for imposed in commands:
            live.set_command(imposed)
        live.start([Observation(stamp, first)])
        live.advance(stamp + SECOND // 20)
        live.set_command(turned(0.0, stamp))
    right, overtaken = (live.advance(later).control_points for live in lives)
    np.testing.assert_allclose(overtaken, right, atol=1e-9)
    # Later commands go on from the present shape, as a robot's do that sends poses one by one.
    lives[1].set_command(turned(0.4, later))
    assert np.abs(lives[1].advance(later + 1000).control_points - right)[:, :3].max() < 1e-3
