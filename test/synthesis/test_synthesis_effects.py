# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Each hidden effect of the discrete rod on its own, against an independent answer."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from elastica import Cantilever, hinged
from ordinary import some_of

from dlo_ros.parameters import DampingParameters, RodParameters, Settings
from dlo_ros.synthesis.experiment import find_experiment, read_experiment
from dlo_ros.synthesis.hidden_effects import HiddenEffects, read_effects
from dlo_ros.synthesis.hidden_rod import build_rod
from dlo_ros.synthesis.rod_laws import bend, yield_to
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation, ImposedNodes
from dlo_ros.synthesis.rod_steps import evaluate
from dlo_ros.synthesis.true_motion import build_simulation, simulate

LENGTH = 0.4
ROPE = RodParameters(length=LENGTH, diameter=0.004, young_modulus=2e7, density=2500.0)
SETTINGS = Settings(ROPE, damping=DampingParameters(air_drag=0.02, relaxation_time=0.002))
WEIGHTLESS = replace(SETTINGS, gravity=(0.0, 0.0, 0.0))
B, EA, W = ROPE.bending_stiffness, ROPE.young_modulus * ROPE.area, ROPE.linear_density * 9.81
ORIGIN = np.zeros(2)
CLAMPED = ImposedNodes({0: ORIGIN}, start=0.0)


def hidden(name: str, **values) -> HiddenEffects:
    return HiddenEffects(read_effects({name: values}, "test"))


def settled(
    settings: Settings, what: HiddenEffects, hold: ImposedNodes = CLAMPED, edges: int = 200
):
    """The rod and its nodes in equilibrium as a cantilever."""
    rod = build_rod(settings, what, edges=edges)
    a = hold.start or 0.0
    x = rod.u[:, None] * np.array([np.cos(a), -np.sin(a)])
    simulation = DiscreteRodSimulation(rod, lambda _: hold, x)
    simulation.settle()
    return rod, simulation


def hanging(s):
    return 0.0 * s, -W * (LENGTH - s)


def uniform(s):
    return np.full_like(s, B)


def tapered(away):
    """1 within 0.025 m, 0 beyond 0.075 m, and half a wave of a cosine in between."""
    return 0.5 + 0.5 * np.cos(np.pi * np.clip((np.abs(away) - 0.025) / 0.05, 0.0, 1.0))


def cantilever(**changes) -> Cantilever:
    return Cantilever(
        **({"length": LENGTH, "stiffness": uniform, "stretch": EA, "force": hanging} | changes)
    )


MASS = 0.02
HALF = 4.0
STATIC = {
    "none": (HiddenEffects(), cantilever()),
    "point_mass": (
        hidden("point_mass", mass=MASS, position=0.27),
        cantilever(
            force=lambda s: (0.0 * s, -W * (LENGTH - s) - 9.81 * MASS * (s < 0.27)), breaks=[0.27]
        ),
    ),
    "point_mass at the tip": (
        hidden("point_mass", mass=MASS, position=LENGTH),
        cantilever(force=lambda s: (0.0 * s, -W * (LENGTH - s) - 9.81 * MASS)),
    ),
    "stiff_segment": (
        hidden("stiff_segment", centre=0.12, extent=0.1, ratio=5.0),
        cantilever(
            stiffness=lambda s: B * np.where(np.abs(s - 0.12) < 0.05, 5.0, 1.0), breaks=[0.07, 0.17]
        ),
    ),
    "stiff_segment with tapered ends": (
        hidden("stiff_segment", centre=0.12, extent=0.1, ratio=5.0, taper=0.5),
        cantilever(
            stiffness=lambda s: B * 5.0 ** tapered(s - 0.12), breaks=[0.045, 0.095, 0.145, 0.195]
        ),
    ),
    "stiffness_gradient": (
        hidden("stiffness_gradient", change=-1.2),
        cantilever(stiffness=lambda s: B * (1.0 - 1.2 * (s / LENGTH - 0.5))),
    ),
    "intrinsic_curvature": (
        hidden("intrinsic_curvature", curvature=-6.0),
        cantilever(rest=lambda s: np.full_like(s, -6.0)),
    ),
    "intrinsic_curvature of several values": (
        hidden("intrinsic_curvature", curvature=[8.0, -4.0, 2.0]),
        cantilever(rest=lambda s: np.interp(s, [0.0, 0.2, 0.4], [8.0, -4.0, 2.0]), breaks=[0.2]),
    ),
    "intrinsic_curvature as a kink": (
        hidden("intrinsic_curvature", kink=-0.6, position=0.15),
        cantilever(breaks=[0.15], kinks={0.15: -0.6}),
    ),
    "nonlinear_stiffness": (
        hidden("nonlinear_stiffness", half_curvature=HALF),
        cantilever(curvature=lambda m, b: HALF * np.tan(m / (b * HALF))),
    ),
    "gravity_tilt": (
        hidden("gravity_tilt", angle=0.2),
        cantilever(
            force=lambda s: (-W * np.sin(0.2) * (LENGTH - s), -W * np.cos(0.2) * (LENGTH - s))
        ),
    ),
    "constant_force": (
        hidden("constant_force", x=0.1, z=0.15),
        cantilever(force=lambda s: (0.1 * (LENGTH - s), (0.15 - W) * (LENGTH - s))),
    ),
    "clamp_angle": (None, cantilever(direction=0.15)),
    "clamp_compliance": (hidden("clamp_compliance", start=8.0), hinged(cantilever(), 8.0, W)),
    "connector": (
        hidden("connector", mass=MASS, extent=0.08),
        cantilever(
            force=lambda s: (
                0.0 * s,
                -W * (LENGTH - s) - 9.81 * MASS * np.clip((LENGTH - s) / 0.08, 0.0, 1.0),
            ),
            stiffness=lambda s: B * np.where(s > LENGTH - 0.08, 500.0, 1.0),
            breaks=[LENGTH - 0.08],
        ),
    ),
}


@pytest.mark.parametrize("name", some_of(STATIC, [*STATIC][::3]))
def test_equilibrium_is_that_of_the_elastica(name):
    what, answer = STATIC[name]
    settings, hold = SETTINGS, CLAMPED
    if what is None:
        what, hold = HiddenEffects(), replace(CLAMPED, start=0.15)
    if name == "nonlinear_stiffness":  # the moment of so soft a law is bounded
        settings = replace(SETTINGS, gravity=(0.0, 0.0, -0.5))
        full = answer.force
        answer = replace(answer, force=lambda s: tuple(0.5 / 9.81 * f for f in full(s)))
    rod, simulation = settled(settings, what, hold)
    expected = answer.solve(rod.u)
    without = STATIC["none"][1].solve(rod.u)
    error = np.linalg.norm(simulation.x - expected, axis=1)
    assert error.max() < 6e-5  # of 400 mm
    if name != "none":
        assert np.abs(expected - without).max() > 100 * error.max()
    simulation.advance(0.2)  # and it stays there
    assert np.linalg.norm(simulation.x - expected, axis=1).max() < 6e-5


def released(simulation: DiscreteRodSimulation, until: float) -> np.ndarray:
    """Nodes at rest after a time without any clamp at the end."""
    simulation.boundary = lambda _: CLAMPED
    return simulation.advance(simulation.time + until)


PATH_TIME = 40.0  # [s] so slow that the bend is even at every moment


def bent(what: HiddenEffects, angles) -> DiscreteRodSimulation:
    """A weightless stiff rod bent evenly by its end's direction, along a path of angles [rad]."""
    damping = DampingParameters(air_drag=0.05, relaxation_time=0.5)  # lets go gently
    settings = replace(WEIGHTLESS, rod=replace(ROPE, young_modulus=2e9), damping=damping)
    rod = build_rod(settings, what, edges=60)
    x = np.column_stack([rod.u, np.zeros(len(rod.u))])

    def hold(t):
        end = np.interp(t, PATH_TIME * np.arange(len(angles)), angles)
        return replace(CLAMPED, end=float(end))

    simulation = DiscreteRodSimulation(rod, hold, x, step=0.04)
    simulation.settle()
    simulation.advance(PATH_TIME * (len(angles) - 1) + 1.0)
    return simulation


def curvature(simulation: DiscreteRodSimulation) -> np.ndarray:
    e = np.diff(simulation.x, axis=0)
    angle = np.unwrap(np.arctan2(-e[:, 1], e[:, 0]))
    return np.diff(angle) / simulation.rod.lengths[1:]


@pytest.mark.parametrize("hardening", [0.0, 0.3, 1.0])
def test_plasticity_leaves_the_rest_curvature_of_kinematic_hardening(hardening):
    """Bent evenly to 10 / m and let go: (1 - h) (10 - yield) stays."""
    what = hidden("plasticity", yield_curvature=6.0, hardening=hardening)
    simulation = bent(what, [0.0, 10.0 * LENGTH])
    released(simulation, 6.0)
    np.testing.assert_allclose(curvature(simulation), (1.0 - hardening) * 4.0, atol=0.02)


def test_plasticity_starts_with_the_first_shape_and_yields_both_ways():
    # A first shape beyond the yield has been reached by one steady bend.
    what = hidden("plasticity", yield_curvature=2.0, hardening=0.5)
    simulation = bent(what, [5.0 * LENGTH])
    np.testing.assert_allclose(curvature(simulation), 5.0, atol=1e-6)
    released(simulation, 6.0)
    np.testing.assert_allclose(curvature(simulation), 0.5 * 3.0, atol=5e-3)
    # Back from 5 to -5 with plastic curvature p and back stress Hp p = B p (h = 1/2): moment
    # B (-5 - p) = B p - 2 B, so p = -1.5 whatever came before.
    simulation = bent(what, [5.0 * LENGTH, -5.0 * LENGTH])
    released(simulation, 6.0)
    np.testing.assert_allclose(curvature(simulation), -1.5, atol=5e-3)


def test_below_the_yield_nothing_stays():
    simulation = bent(hidden("plasticity", yield_curvature=6.0, hardening=0.1), [0.0, 5.5 * LENGTH])
    released(simulation, 6.0)
    np.testing.assert_allclose(curvature(simulation), 0.0, atol=5e-3)


@pytest.mark.parametrize(("time", "stays"), [(0.05, 10.0 - 3.0 / 0.5), (1e4, 10.0 - 3.0)])
def test_what_creeps_yields_by_the_spring_in_series(time, stays):
    """Slow bending leaves half of the elastic curvature to the spring, fast bending all of it."""
    blocks = {
        "plasticity": {"yield_curvature": 3.0, "hardening": 0.0},
        "viscoelasticity": {"share": 0.5, "time": time},
    }
    simulation = bent(HiddenEffects(read_effects(blocks, "test")), [0.0, 10.0 * LENGTH])
    released(simulation, 6.0)
    np.testing.assert_allclose(curvature(simulation), stays, atol=0.05)


def test_what_creeps_and_softens_goes_back():
    blocks = {
        "nonlinear_stiffness": {"half_curvature": 1.5},
        "viscoelasticity": {"share": 0.6, "time": 0.2},
    }
    simulation = bent(HiddenEffects(read_effects(blocks, "test")), [0.0, 10.0 * LENGTH])
    released(simulation, 30.0)
    np.testing.assert_allclose(curvature(simulation), 0.0, atol=0.03)


@pytest.mark.parametrize("half", [np.inf, 3.0])
@pytest.mark.parametrize("yields", [np.inf, 2.0])
@pytest.mark.parametrize("drag", [0.0, 1.5])
def test_moment_and_tangent_are_derivatives_of_the_energy(half, yields, drag):
    rod = build_rod(SETTINGS, HiddenEffects(), edges=10)
    rod = replace(rod, half_curvature=half, yield_curvature=yields, hardening=0.2)
    rod = replace(rod, hysteresis=drag, hysteresis_width=2.0)
    law = rod.bending_law()
    if not law.active:
        assert np.isinf(half) and np.isinf(yields) and not drag
        return
    v = rod.vertex_lengths
    for kappa in (3.0, -4.0, 6.0):  # a history
        yield_to(law, kappa * v)
    for kappa in np.linspace(-12.0, 12.0, 17) + 0.1:
        step = 1e-4 * v[5]
        energies, moments, tangents = zip(
            *(bend(law, 5, kappa * v[5] + k * step) for k in (-1, 0, 1)), strict=True
        )
        slope = (energies[2] - energies[0]) / (2 * step)
        assert moments[1] == pytest.approx(slope, abs=1e-5 * B)
        slope = (moments[2] - moments[0]) / (2 * step)
        assert tangents[1] == pytest.approx(slope, rel=1e-3, abs=1e-5 * B / v[5])


def test_saturating_spring_and_hysteresis_in_pure_bending():
    v = 0.01
    rod = replace(build_rod(SETTINGS, HiddenEffects(), edges=40), half_curvature=3.0)
    _, moment, _ = bend(rod.bending_law(), 5, 7.0 * v)
    assert moment == pytest.approx(B * 3.0 * np.arctan(7.0 / 3.0), rel=1e-9)
    # Dahl's element: a cycle that is wide against its width loses 4 M (amplitude - ...) as heat.
    rod = replace(
        build_rod(SETTINGS, HiddenEffects(), edges=40), hysteresis=1.5, hysteresis_width=0.5
    )
    law, work = rod.bending_law(), 0.0
    path = np.concatenate(
        [np.linspace(0, 8, 801), np.linspace(8, -8, 1601), np.linspace(-8, 8, 1601)]
    )
    moments = []
    for kappa in path:
        moments.append(bend(law, 5, kappa * v)[1])
        yield_to(law, np.full(41, kappa * v))
    loop = slice(801, None)
    work = np.trapezoid(np.array(moments)[loop], path[loop])
    # Each branch of length 16 has mean moment 1.5 B (1 - 2 width / 16).
    assert work == pytest.approx(2 * 16 * 1.5 * B * (1 - 2 * 0.5 / 16), rel=2e-3)


FRICTION = 0.5


def lying(force):
    """A straight rod on the board under an even force along z [N/m] (no gravity, no clamps)."""
    settings = replace(WEIGHTLESS, damping=DampingParameters(air_drag=0.0, relaxation_time=0.0))
    rod = build_rod(settings, hidden("surface_friction", force=FRICTION), edges=40)
    rod.force[:, 1] = force * rod.vertex_lengths
    x = np.column_stack([rod.u, np.zeros(len(rod.u))])
    return DiscreteRodSimulation(rod, lambda _: ImposedNodes({}), x, step=5e-4)


def test_friction_holds_what_pulls_less_and_slides_under_more():
    held = lying(0.9 * FRICTION)
    held.advance(1.0)
    assert np.abs(held.x[:, 1]).max() < 2e-5 and np.abs(held.v).max() < 1e-5
    pulled = lying(1.5 * FRICTION)
    pulled.advance(0.2)
    acceleration = 0.5 * FRICTION / ROPE.linear_density
    np.testing.assert_allclose(pulled.x[:, 1], 0.5 * acceleration * 0.2**2, rtol=5e-3)


def test_friction_stops_a_sliding_rod_where_its_work_is_done():
    sliding = lying(3.0 * FRICTION)
    sliding.advance(0.1)
    sliding.rod.force[:] = 0.0
    sliding.advance(0.5)
    pushed = 0.5 * 2.0 * FRICTION / ROPE.linear_density * 0.1**2
    np.testing.assert_allclose(sliding.x[:, 1], 3.0 * pushed, rtol=0.01)
    resting = sliding.x.copy()
    sliding.advance(1.0)
    np.testing.assert_allclose(sliding.x, resting, atol=1e-6)


def test_friction_lets_a_cantilever_stick_away_from_its_equilibrium():
    """Lifted slowly by an even force and let down: it stops high where it was low before."""
    what = hidden("surface_friction", force=0.4 * W)
    rod, simulation = settled(SETTINGS, what, edges=80)
    start = simulation.x.copy()
    rest = rod.force.copy()
    for t in np.arange(1, 41) * 0.05:
        share = min(t, 2.0 - t)
        rod.force = rest + share * np.column_stack([0 * rod.u, 1.8 * W * rod.vertex_lengths])
        simulation.advance(t)
    simulation.advance(3.0)
    stopped = simulation.x.copy()
    assert stopped[-1, 1] - start[-1, 1] > 0.01
    simulation.advance(4.0)
    np.testing.assert_allclose(simulation.x, stopped, atol=2e-6)
    # The force that holds it up is within Coulomb's limit and not zero.
    free = build_rod(SETTINGS, HiddenEffects(), edges=80)
    potential = free.potential(CLAMPED.held(81), CLAMPED.clamps)
    gradient, band = np.empty((81, 2)), np.empty((6, 162))
    evaluate(stopped, potential, gradient, band)
    load = np.linalg.norm(gradient, axis=1) / free.vertex_lengths
    assert load.max() < 0.4 * W * 1.01 and load.mean() > 0.1 * W


def test_a_plug_that_is_held_turns_with_its_gripper():
    """All of a rigid part turns at once, by more than a full step of Newton's method can follow."""
    made = yaml.safe_load(find_experiment("two_grippers").read_text())
    made["parameters"]["effects"] = {"connector": {"mass": 0.002, "extent": 0.08}}
    made["duration"] = 0.2
    experiment = read_experiment(made, "test", "test.yaml")
    simulation, _ = build_simulation(experiment)
    truth = simulate(simulation, experiment.stamps, experiment.truth.rod.length)
    plug = truth.nodes[-1][truth.u > 0.33]
    along = np.diff(plug, axis=0) / np.linalg.norm(np.diff(plug, axis=0), axis=1, keepdims=True)
    assert np.all(along @ along[-1] > 1.0 - 1e-5)
    moved = truth.nodes[-1, -1] - truth.nodes[0, -1]
    assert np.linalg.norm(moved) > 1e-3
