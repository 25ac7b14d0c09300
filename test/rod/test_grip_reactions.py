# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Forces of the grips, tension and bend radius against closed forms and balances of their own."""

from dataclasses import replace

import numpy as np
import pytest
from elastica import Cantilever
from rods import PAPER, SECOND, command, held_start, settled, straight
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from dlo_ros.command import Command, Motion
from dlo_ros.observation import Observation
from dlo_ros.parameters import RodParameters, Settings
from dlo_ros.rod.loads.grip_reactions import (
    STRAIGHT,
    _Held,
    balance_of,
    growth_of,
    instants_of,
    loadings,
)
from dlo_ros.rod.resolution import build
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod.statics import settle
from dlo_ros.spline import SplineBasis

ROD = PAPER.rod
WEIGHT = ROD.linear_density * 9.81 * ROD.length
WEIGHTLESS = replace(PAPER, gravity=(0.0, 0.0, 0.0))
CLOSE = 1e-3
DOWN = [0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4)]
HELD_DOWN = command(["start"], [0.0], [[0.0, 0.0, 0.0]], [DOWN])


def borne(settings, imposed, spans, direction=(1.0, 0.0, 0.0)):
    """What the DLO bears in the equilibrium to which a straight one is led."""
    model, boundary, found = settled(settings, imposed, spans, direction)
    return loadings(model, boundary, [found.state], imposed)[0]


@pytest.mark.parametrize(
    ("effects", "weight"),
    [
        ({}, WEIGHT),
        ({"point_mass": {"mass": 0.02, "position": 0.25}}, WEIGHT + 0.02 * 9.81),
        ({"connector": {"mass": 0.03, "extent": 0.05}}, WEIGHT + 0.03 * 9.81),
        ({"constant_force": {"x": 0.0, "z": -0.2}}, WEIGHT + 0.2 * ROD.length),
        ({"length_error": {"difference": 0.02}}, WEIGHT * (1.0 + 0.02 / ROD.length)),
    ],
    ids=lambda x: "-".join(x) or "plain" if isinstance(x, dict) else "",
)
def test_the_grip_of_a_hanging_dlo_bears_its_weight(effects, weight):
    found = borne(PAPER.with_effects(effects), HELD_DOWN, 14, (0.0, 0.0, -1.0))
    assert found.end is None
    assert found.start.force == pytest.approx([0.0, 0.0, weight], abs=1e-6 * weight)
    assert np.abs(found.start.torque).max() < 1e-6 * weight * ROD.length
    assert found.tension == pytest.approx(weight, rel=1e-6) and found.tension_at == 0.0
    assert found.bend_radius > 1e3 * ROD.length


def test_a_straight_dlo_has_a_radius_that_a_message_can_carry():
    found = borne(WEIGHTLESS, HELD_DOWN, 7, (0.0, 0.0, -1.0))
    assert found.bend_radius == pytest.approx(STRAIGHT * ROD.length)
    assert np.abs(found.start.force).max() < 1e-9 * WEIGHT and abs(found.tension) < 1e-6 * WEIGHT


def test_an_end_without_direction_is_held_by_a_force_alone_and_a_tilt_turns_it():
    tilted = PAPER.with_effects({"gravity_tilt": {"angle": 0.1}})
    tip = command(["control_point_1"], [0.0], [[0.0, 0.0, 0.0]])
    found = borne(tilted, tip, 14, (0.0, 0.0, -1.0))
    # Positive from x towards -z: what points down is turned to the left.
    expected = WEIGHT * np.array([np.sin(0.1), 0.0, np.cos(0.1)])
    assert found.start.force == pytest.approx(expected, abs=1e-6 * WEIGHT)
    assert not found.start.torque.any()


def test_a_catenary_pulls_most_at_its_ends():
    """The extensible catenary: its horizontal pull from the distance of the ends."""
    length, apart = 2.0, 1.2
    settings = Settings(rod=RodParameters(length, 0.001, 2e7, 2000.0))
    w, ea = settings.rod.linear_density * 9.81, settings.rod.young_modulus * settings.rod.area
    imposed = command(["control_point_1", "control_point_10"], [0.0, 1.0], [
        [[0.0, 0.0, 0.0], [length, 0.0, 0.0]], [[0.0, 0.0, 0.0], [apart, 0.0, 0.0]],
    ])  # fmt: skip
    model, boundary = build(settings, imposed, 56)
    start = straight(model)
    bent = start.q.copy()
    bent[:, 2] = -1e-2 * np.sin(np.pi * bent[:, 0] / length)
    state = settle(model, boundary, replace(start, q=bent), imposed, SECOND).state
    found = loadings(model, boundary, [state], imposed)[0]

    def span(pull):
        return pull * length / ea + 2.0 * pull / w * np.arcsinh(w * length / (2.0 * pull))

    pull = brentq(lambda h: span(h) - apart, 1e-4 * w, 1e2 * w)
    most = np.hypot(pull, w * length / 2.0)
    assert found.tension == pytest.approx(most, rel=CLOSE)
    assert found.tension_at in (0.0, length)
    up = w * length / 2.0
    assert found.start.force == pytest.approx([-pull, 0.0, up], rel=CLOSE, abs=1e-9)
    assert found.end.force == pytest.approx([pull, 0.0, up], rel=CLOSE, abs=1e-9)
    # Its lowest point is bent most, with radius H / w but for its stretch.
    assert found.bend_radius == pytest.approx(pull / w, rel=1e-2)
    assert found.bend_at == pytest.approx(length / 2.0, abs=0.05)


@pytest.mark.parametrize("young_modulus", [5e7, 1e7])
def test_the_torque_at_the_clamp_of_a_cantilever_is_that_of_the_heavy_elastica(young_modulus):
    settings = PAPER.with_material(young_modulus, 2500.0)
    rod = settings.rod
    w = rod.linear_density * 9.81
    found = borne(settings, held_start(), 28)
    problem = Cantilever(
        rod.length, lambda s: np.full_like(s, rod.bending_stiffness),
        rod.young_modulus * rod.area,
        lambda s: (np.zeros_like(s), -w * (rod.length - s)),
    )  # fmt: skip
    s = np.linspace(0.0, rod.length, 4001)
    moment = w * np.trapezoid(problem.solve(s)[:, 0], s)
    # The grip holds against the weight, which turns the DLO about +y (from x towards -z).
    assert found.start.torque == pytest.approx([0.0, -moment, 0.0], rel=CLOSE, abs=1e-9)
    assert found.start.force == pytest.approx([0.0, 0.0, w * rod.length], rel=1e-6, abs=1e-9)
    assert found.bend_radius == pytest.approx(rod.bending_stiffness / moment, rel=3e-2)
    assert found.bend_at == 0.0


def test_a_dlo_whose_grip_gives_is_bent_no_more_than_its_moment_says():
    """It turns beside the grip, as about a hinge, which is no bend of the DLO."""
    settings = PAPER.with_material(5e7, 2500.0)
    stiff = settings.rod.bending_stiffness
    soft = settings.with_effects({"clamp_compliance": {"start": 0.3 * settings.rod.length / stiff}})
    rigid, gives = (borne(s, held_start(), 28) for s in (settings, soft))
    moment = np.linalg.norm(gives.start.torque)
    assert moment < 0.99 * np.linalg.norm(rigid.start.torque)
    assert 0.95 * stiff / moment < gives.bend_radius < 1.15 * stiff / moment
    assert 0.0 < gives.bend_at < 0.1 * settings.rod.length


def arc(turned, kappa):
    """A command that bends a straight DLO into an arc, in a plane turned about x [rad]."""
    angle = kappa * ROD.length
    about = Rotation.from_euler("x", turned)
    tip = about.apply([np.sin(angle) / kappa, 0.0, (np.cos(angle) - 1.0) / kappa])
    clamp = about * Rotation.from_euler("y", angle) * about.inv()
    straight_one = [[0.0, 0.0, 0.0], [ROD.length, 0.0, 0.0]]
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (2, 2, 1))
    rotations[1, 1] = clamp.as_quat()
    places = [straight_one, [[0.0, 0.0, 0.0], tip]]
    return command(["start", "end"], [0.0, 1.0], places, rotations), about


@pytest.mark.parametrize("turned", [0.0, 0.7, -1.9])
def test_an_arc_is_held_by_a_pair_of_torques(turned):
    kappa = 5.0
    imposed, about = arc(turned, kappa)
    model, boundary = build(WEIGHTLESS, imposed, 14)
    state = settle(model, boundary, straight(model), imposed, SECOND).state
    found = loadings(model, boundary, [state], imposed)[0]
    moment = ROD.bending_stiffness * kappa
    axis = about.apply([0.0, 1.0, 0.0])
    assert found.start.torque == pytest.approx(-moment * axis, abs=CLOSE * moment)
    assert found.end.torque == pytest.approx(moment * axis, abs=CLOSE * moment)
    assert np.abs(found.start.force).max() < 1e-2 * moment / ROD.length
    assert found.bend_radius == pytest.approx(1.0 / kappa, rel=5e-3)  # a spline's own error


def test_a_twisted_dlo_is_held_by_the_torque_of_its_stiffness():
    angle = 2.0
    places = [[0.0, 0.0, 0.0], [ROD.length, 0.0, 0.0]]
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (2, 2, 1))
    rotations[1, 1] = [np.sin(angle / 2.0), 0.0, 0.0, np.cos(angle / 2.0)]
    imposed = command(["start", "end"], [0.0, 1.0], [places, places], rotations)
    model, boundary = build(WEIGHTLESS, imposed, 14)
    first = settle(model, boundary, straight(model), imposed, 0).state
    state = settle(model, boundary, first, imposed, SECOND).state
    found = loadings(model, boundary, [state], imposed)[0]
    torque = ROD.shear_modulus * 2.0 * ROD.second_moment * angle / ROD.length
    assert found.end.torque == pytest.approx([torque, 0.0, 0.0], abs=CLOSE * torque)
    assert found.start.torque == pytest.approx([-torque, 0.0, 0.0], abs=CLOSE * torque)


def stretched(share):
    """A command that holds the tips of a straight DLO at other than its length."""
    places = [[0.0, 0.0, 0.0], [ROD.length * (1.0 + share), 0.0, 0.0]]
    return command(["control_point_1", "control_point_10"], [0.0], [places])


def test_a_pulled_dlo_has_the_tension_of_its_stiffness():
    found = borne(WEIGHTLESS, stretched(0.003), 56)
    pull = ROD.young_modulus * ROD.area * 0.003
    assert found.end.force == pytest.approx([pull, 0.0, 0.0], abs=CLOSE * pull)
    assert found.start.force == pytest.approx([-pull, 0.0, 0.0], abs=CLOSE * pull)
    assert found.tension == pytest.approx(pull, rel=CLOSE)


def test_a_dlo_that_has_just_buckled_pushes_with_eulers_load():
    found = borne(WEIGHTLESS, stretched(-4e-4), 14)
    push = np.pi**2 * ROD.bending_stiffness / ROD.length**2
    assert found.end.force == pytest.approx([-push, 0.0, 0.0], abs=CLOSE * push)
    assert found.tension < 0.0


def spatial():
    """Two clamps that bend and twist a DLO out of its plane, by equal steps."""
    steps = np.linspace(0.0, 1.0, 9)
    places = np.zeros((9, 2, 3))
    places[:, 1] = np.array([ROD.length, 0.0, 0.0]) + steps[:, None] * [-0.15, 0.1, 0.06]
    turns = [Rotation.from_rotvec(s * np.array([1.5, 0.4, -0.8])).as_quat() for s in steps]
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (9, 2, 1))
    rotations[:, 1] = turns
    return command(["start", "end"], steps, places, rotations)


def test_forces_and_torques_in_space_balance_the_weight():
    """Moments about the origin: only a torque that is right in all its parts closes them."""
    imposed = spatial()
    model, boundary = build(PAPER, imposed, 28)
    state = straight(model)
    for k in range(9):
        state = settle(model, boundary, state, imposed, k * SECOND // 8).state
    found = loadings(model, boundary, [state], imposed)[0]
    total = found.start.force + found.end.force
    assert total == pytest.approx([0.0, 0.0, WEIGHT], abs=1e-6 * WEIGHT)
    u, weight = model.basis.quadrature()
    r = model.basis.evaluate(state.q[:, :3], u)
    down = np.array([0.0, 0.0, -ROD.linear_density * 9.81])
    moment = np.cross(r, down).T @ weight + found.start.torque + found.end.torque
    moment += np.cross(state.q[-1, :3], found.end.force)
    assert np.abs(moment).max() < CLOSE * np.linalg.norm(found.end.torque)


PEG = {"obstacle": {"x": 0.15, "z": -0.085, "radius": 0.02}}
EFFECTS = {
    "softening": {"nonlinear_stiffness": {"half_curvature": 4.0}},
    "yielding": {"plasticity": {"yield_curvature": 3.0, "hardening": 0.3}},
    "hysteresis": {"hysteresis": {"moment": 1e-3, "curvature": 1.0}},
    "relaxing": {"viscoelasticity": {"share": 0.4, "time": 0.3}},
    "friction": {"surface_friction": {"force": 0.02}},
    "peg": PEG,
    "wall": {"wall": {"offset": -0.09, "angle": 0.0}},
    "drag": {"quadratic_drag": {"coefficient": 0.3}},
    "slip": {"clamp_slip": {"length": 0.03}},
    "slip beside a kink": {"clamp_slip": {"length": 0.03},
                           "intrinsic_curvature": {"kink": 1.0, "position": 0.2},
                           "clamp_compliance": {"start": 3.0, "end": 3.0}},
    "curved": {"intrinsic_curvature": {"curvature": 3.0}},
    "compliant": {"clamp_compliance": {"start": 3.0, "end": 3.0}},
    "flat": {"anisotropy": {"ratio": 0.5, "angle": 0.4}},
    "long": {"length_error": {"difference": -0.01}},
    "anything": {"point_mass": {"mass": 0.02, "position": 0.1},
                 "stiff_segment": {"centre": 0.2, "extent": 0.1, "ratio": 2.0}},
}  # fmt: skip


def shaken(ends=1, *, off_plane=0.0, points=101):
    """A command of one second in which the start, held along x, swings smoothly from rest."""
    t = np.linspace(0.0, 1.0, points)
    names = ("start", "end")[:ends]
    position, velocity = np.zeros((points, ends, 3)), np.zeros((points, ends, 3))
    move, speed = 0.02 * (1 - np.cos(6 * t)) ** 2, 0.24 * (1 - np.cos(6 * t)) * np.sin(6 * t)
    for c, share in enumerate((-1.0, off_plane, 0.5)):
        position[:, 0, c], velocity[:, 0, c] = share * move, share * speed
    if ends == 2:
        position[:, 1, 0] = 0.3
    rotation = np.tile([0.0, 0.0, 0.0, 1.0], (points, ends, 1))
    return Command(SECOND, names, t, position, rotation, velocity, 10)


def started(settings, imposed, spans=14, **keywords):
    """A simulation that has started from a slack DLO."""
    n = settings.rod.control_points
    u = SplineBasis(n, ROD.length).greville
    shape = np.zeros((n, 4))
    shape[:, 0] = u if len(imposed.names) == 1 else 0.75 * u
    shape[:, 2] = -0.05 * np.sin(np.pi * u / ROD.length) * (len(imposed.names) - 1)
    simulation = Simulation(settings, Motion([imposed]), spans=spans, loads=True, **keywords)
    simulation.start([Observation(SECOND, shape)])
    return simulation


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_are_part_of_the_balance(name):
    """What is free accelerates as the integrator has it, by forces that are added up anew."""
    settings = replace(
        PAPER.with_effects(EFFECTS[name]), simulation=replace(PAPER.simulation, tolerance=1e-6)
    )
    simulation = started(settings, shaken(2))
    first = simulation.prediction().loading
    model, boundary = simulation.model, simulation.boundary
    points, weight = model.basis.quadrature()
    along = np.sqrt(weight)[:, None] * model.basis.matrix(points)
    assert first.start.force[2] + first.end.force[2] == pytest.approx(
        -model.load[:, 2].sum() if name not in ("peg", "wall") else first.start.force[2]
        + first.end.force[2], rel=1e-5,
    )  # fmt: skip
    off, size = [], []
    for k in range(1, 11):
        simulation.advance(SECOND + k * SECOND // 10)
        state = simulation.state
        followed = simulation._timeline.following
        now = instants_of([state], growth_of(model, boundary, followed, state.stamp))
        found = balance_of(model, boundary).solve(now)[0].acceleration[0]
        off.append(along @ (found - state.acceleration[:, :3]))
        size.append(along @ state.acceleration[:, :3])
    assert np.sqrt(np.mean(np.square(off))) < 0.05 * np.sqrt(np.mean(np.square(size)))


@pytest.mark.parametrize("ends", [1, 2])
@pytest.mark.parametrize("off_plane", [0.0, 0.6])
def test_the_impulse_of_a_shaken_dlo_is_its_change_of_momentum(ends, off_plane):
    exact = replace(PAPER, simulation=replace(PAPER.simulation, tolerance=1e-5))
    simulation = started(exact, shaken(ends, off_plane=off_plane))
    momentum, force, every = [], [], SECOND // 200
    for k in range(160):
        if k:
            simulation.advance(SECOND + k * every)
        state, model = simulation.state, simulation.model
        found = simulation.prediction().loading
        speed = model.basis.gram.sum(axis=0) @ state.velocity[:, :3]
        momentum.append(model.body.line_density * speed)
        drag = model.body.air_drag * speed
        grips = found.start.force + (found.end.force if found.end else 0.0)
        force.append(grips + model.load[:, :3].sum(axis=0) - drag)
    impulse = np.trapezoid(force, dx=every * 1e-9, axis=0)
    gained = momentum[-1] - momentum[0]
    assert np.abs(impulse - gained).max() < CLOSE * np.abs(momentum).max()
    assert np.abs(gained).max() > 0.1 * np.abs(momentum).max()


def test_many_instants_at_once_are_those_one_by_one():
    imposed = shaken(2)
    stamps = [SECOND + k * SECOND // 50 for k in range(1, 51)]
    together = started(PAPER, imposed).advance_through(stamps)
    alone = started(PAPER, imposed)
    each = [alone.advance(stamp) for stamp in stamps]
    assert [p.stamp for p in together] == stamps
    for what in ("force", "torque"):
        a, b = (
            np.array([getattr(p.loading.start, what) for p in track]) for track in (together, each)
        )
        assert np.abs(a - b).max() < 0.01 * np.abs(b).max()
    a, b = (np.array([p.loading.tension for p in track]) for track in (together, each))
    assert a == pytest.approx(b, rel=0.01)


def test_a_pin_beside_the_clamp_takes_its_share():
    """Between clamp and pin the DLO hangs; behind it nothing is borne by the clamp."""
    places = [[0.0, 0.0, 0.0], [float(SplineBasis(10, ROD.length).greville[4]), 0.0, 0.0]]
    imposed = command(["start", "control_point_5"], [0.0], [places])
    model, boundary, found = settled(PAPER, imposed, 28)
    state = found.state
    hung = loadings(model, boundary, [state], imposed)[0]
    motion, _ = balance_of(model, boundary).solve(instants_of([state]))
    pin = motion.forces[0, -1]
    assert hung.start.force + pin == pytest.approx([0.0, 0.0, WEIGHT], abs=1e-6 * WEIGHT)
    # Moments about the clamp, of weight, pin and torque.
    u, weight = model.basis.quadrature()
    r = model.basis.evaluate(state.q[:, :3], u)
    down = np.array([0.0, 0.0, -ROD.linear_density * 9.81])
    moment = np.cross(r, down).T @ weight + np.cross(places[1], pin) + hung.start.torque
    assert np.abs(moment).max() < CLOSE * np.abs(np.cross(places[1], pin)).max()


def test_what_is_not_asked_for_is_not_computed():
    simulation = Simulation(PAPER, Motion([shaken()]), spans=7)
    shape = np.zeros((10, 4))
    shape[:, 0] = SplineBasis(10, ROD.length).greville
    simulation.start([Observation(SECOND, shape)])
    assert simulation.prediction().loading is None
    assert simulation.advance(SECOND + 1_000_000).loading is None


def test_pins_that_hold_the_same_share_it():
    """Of a DLO that is pinned twice at one place the clamp bears what it does with one pin."""
    mass, held = np.diag([2.0, 1.0, 1.0]), np.array([True, False, False])
    pin = np.array([[0.0, 1.0, 0.0]])
    once, twice = (_Held.of(mass, held, np.repeat(pin, k, axis=0)) for k in (1, 2))
    assert twice.reactions == pytest.approx(once.reactions)
    forces = [x.free(np.ones((1, 3, 1)), np.zeros((1, 3, 1)))[1].sum() for x in (once, twice)]
    assert forces[0] == pytest.approx(forces[1]) == pytest.approx(1.0)
