# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Motion against closed forms, an independent discrete rod, and conservation laws."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, Nothing, command, dense_stiffness, held_start, straight
from scipy.linalg import eigh

from dlo_ros.command import Command, Motion
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.observation import Observation
from dlo_ros.parameters import DampingParameters
from dlo_ros.rod import dynamics, integration
from dlo_ros.rod.elements import rod_forces
from dlo_ros.rod.elements.constitutive_law import room
from dlo_ros.rod.resolution import build
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod.statics import material_at_rest
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis import discrete_rod, rod_simulation

UNDAMPED = replace(PAPER, damping=DampingParameters(air_drag=0.0, relaxation_time=0.0))
WEIGHTLESS = replace(UNDAMPED, gravity=(0.0, 0.0, 0.0))


def tolerant(settings, tolerance):
    return replace(settings, simulation=replace(settings.simulation, tolerance=tolerance))


def first_shape(settings=PAPER):
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    shape = np.zeros((basis.control_points, 4))
    shape[:, 0] = basis.greville
    return [Observation(0, shape)]


def test_first_frequencies_of_a_clamped_rod():
    model, boundary = build(WEIGHTLESS, held_start(), 20)
    state = straight(model)
    free = ~boundary.fixed
    stiffness = dense_stiffness(model, state)[np.ix_(free, free)]
    mass = (
        np.kron(model.basis.gram, np.diag([1.0, 1.0, 1.0, 0.0])) * model.settings.rod.linear_density
    )
    polar = model.settings.rod.density * 2.0 * model.settings.rod.second_moment
    mass += np.kron(model.basis.gram, np.diag([0.0, 0.0, 0.0, 1.0])) * polar
    values = eigh(stiffness, mass[np.ix_(free, free)], eigvals_only=True)
    rod = WEIGHTLESS.rod
    found = np.sqrt(values[:6:2])  # bending in both planes: every frequency twice
    expected = (np.array([1.8751041, 4.6940911, 7.8547574]) / rod.length) ** 2 * np.sqrt(
        rod.bending_stiffness / rod.linear_density
    )
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_a_free_rod_falls_without_changing_shape():
    model, boundary = build(UNDAMPED, held_start(), 10)
    free = replace(boundary, names=())
    state = straight(model)
    state = dynamics.with_consistent_acceleration(model, free, state, Nothing())
    for k in range(1, 6):
        state = dynamics.advance(model, free, state, Nothing(), k * SECOND // 10)
    expected = np.zeros((model.basis.control_points, 4))
    expected[:, 0] = model.basis.greville
    expected[:, 2] = -0.5 * 9.81 * 0.25
    np.testing.assert_allclose(state.q, expected, atol=1e-9)


def total_energy(model, state):
    velocity = np.empty_like(state.velocity)
    rod_forces.multiply_scalar(model.mass, model.spin, state.velocity, velocity)
    elastic = rod_forces.energy_of(
        state.q, model.rule, state.reference, material_at_rest(model, state.internal),
        room(model.rule.weight.size),
    )  # fmt: skip
    return 0.5 * np.sum(velocity * state.velocity) + elastic - np.sum(model.load * state.q)


@pytest.mark.parametrize(("drag", "relaxation"), [(0.0, 0.0), (0.05, 0.0), (0.0, 0.005)])
def test_energy_never_grows(drag, relaxation):
    settings = tolerant(
        replace(PAPER, damping=DampingParameters(air_drag=drag, relaxation_time=relaxation)), 2e-5
    )
    model, boundary = build(settings, held_start(), 14)
    imposed = held_start()
    state = dynamics.with_consistent_acceleration(model, boundary, straight(model), imposed)
    energies = [total_energy(model, state)]
    for k in range(1, 51):
        state = dynamics.advance(model, boundary, state, imposed, k * SECOND // 50)
        energies.append(total_energy(model, state))
    scale = np.ptp([np.sum(model.load * state.q), 0.0]) + 1e-3
    assert np.diff(energies).max() < 5e-4 * scale
    lost = (energies[0] - energies[-1]) / scale
    assert lost < 2e-3 if drag == relaxation == 0.0 else lost > 0.02


def test_drag_slows_a_falling_rod_to_its_terminal_speed():
    settings = replace(PAPER, damping=DampingParameters(air_drag=2.0, relaxation_time=0.0))
    model, boundary = build(settings, held_start(), 7)
    free = replace(boundary, names=())
    state = dynamics.with_consistent_acceleration(model, free, straight(model), Nothing())
    state = dynamics.advance(model, free, state, Nothing(), SECOND // 2)
    terminal = settings.rod.linear_density * 9.81 / 2.0
    np.testing.assert_allclose(state.velocity[:, 2], -terminal, rtol=1e-3)


def test_a_falling_cantilever_moves_as_the_discrete_rod_does():
    """The same fall in a discretisation of another kind (turning angles, BDF2)."""
    settings = tolerant(PAPER, 2e-5)
    length = settings.rod.length
    other = discrete_rod.DiscreteRod.uniform(settings.rod, settings.damping, edges=160)
    hold = rod_simulation.ImposedNodes({0: np.zeros(2)}, start=0.0)
    nodes = np.column_stack([other.u, np.zeros(len(other.u))])
    reference = rod_simulation.DiscreteRodSimulation(other, lambda _: hold, nodes, step=5e-4)
    model, boundary = build(settings, held_start(), 28)
    state = dynamics.with_consistent_acceleration(model, boundary, straight(model), held_start())
    u = np.linspace(0.0, length, 81)
    for k in range(1, 11):
        reference.advance(0.1 * k)
        state = dynamics.advance(model, boundary, state, held_start(), k * SECOND // 10)
        r = model.basis.evaluate(state.q, u)
        distance = np.linalg.norm(r[:, :3] - discrete_rod.centreline(other, reference.x, u), axis=1)
        assert distance.mean() < 1e-3 * length


def test_sensitivities_of_a_motion_agree_with_differences(monkeypatch):
    # Without error control every run takes the same steps.
    monkeypatch.setattr(dynamics, "in_lanes", lambda *_: False)
    monkeypatch.setattr(integration, "STEP_SHARE", 1e3)
    monkeypatch.setattr(integration, "NEWTON_SHARE", 1e-11)
    monkeypatch.setattr(Command, "corners", lambda command, *_: command.times)
    settings = tolerant(PAPER, 0.1)
    imposed = command(
        ["start", "control_point_10"], [0.0, 0.4],
        [[0.0, 0.0, 0.0], [0.3, 0.0, -0.2], [0.0, 0.0, 0.0], [0.2, 0.0, -0.1]],
    )  # fmt: skip

    def run(changed, parameters=()):
        simulation = Simulation(changed, Motion([imposed]), parameters=parameters, spans=14)
        simulation.start(first_shape())
        return simulation.advance(SECOND // 2)

    base = run(settings, MATERIAL)
    step = 5e-4
    for k, name in enumerate(MATERIAL):
        group = "rod" if k < 2 else "damping"
        shapes = []
        for sign in (1.0, -1.0):
            old = getattr(settings, group)
            value = getattr(old, name) * np.exp(sign * step)
            changed = replace(settings, **{group: replace(old, **{name: value})})
            shapes.append(run(changed).control_points[:, :3])
        expected = (shapes[0] - shapes[1]) / (2.0 * step)
        scale = np.abs(expected).max()
        assert scale > 1e-5
        np.testing.assert_allclose(base.sensitivity[k], expected, atol=3e-6 * scale)


def test_smaller_tolerance_gives_a_truer_motion():
    model, boundary = build(tolerant(PAPER, 1e-6), held_start(), 10)
    shapes = {}
    for tolerance in (1e-3, 1e-4, 1e-6):
        model = model.with_settings(tolerant(PAPER, tolerance))
        state = dynamics.with_consistent_acceleration(
            model, boundary, straight(model), held_start()
        )
        shapes[tolerance] = dynamics.advance(model, boundary, state, held_start(), SECOND // 2).q
    coarse, fine = (
        np.abs(shapes[t] - shapes[1e-6]).mean() / PAPER.rod.length for t in (1e-3, 1e-4)
    )
    assert fine < 0.4 * coarse
    assert coarse < 2e-3


def test_simulation_starts_as_asked_and_holds_its_state_on_a_bad_command():
    imposed = held_start()
    for mode, count in (("equilibrium", 1), ("observed", 1), ("moving", 2)):
        settings = replace(PAPER, simulation=replace(PAPER.simulation, start=mode))
        observations = first_shape()
        if count == 2:
            lower = observations[0].control_points.copy()
            lower[:, 2] -= 0.02 * (lower[:, 0] / 0.4) ** 2
            observations.append(Observation(SECOND // 50, lower))
        simulation = Simulation(settings, Motion([imposed]))
        simulation.start(observations)
        shape = simulation.prediction().control_points
        velocity = simulation.state.velocity
        if mode == "equilibrium":
            assert shape[-1, 2] < -0.2
        else:
            assert abs(shape[-1, 2]) < 0.021
            assert np.abs(velocity).max() == pytest.approx(1.0 if count == 2 else 0.0, abs=0.05)
        before = simulation.state
        simulation.motion.add(
            command(["start", "end"], [0.0], [[0, 0, 0], [0.9, 0, 0]], stamp=SECOND // 25)
        )
        with pytest.raises(SimulationError, match="apart"):
            simulation.advance(SECOND)
        assert simulation.state is before
        with pytest.raises(InputError, match="cannot go back"):
            simulation.advance(before.stamp - 1)


def test_unusable_starts_are_refused():
    with pytest.raises(InputError, match="no dlo/command"):
        Simulation(PAPER, Motion()).start(first_shape())
    simulation = Simulation(PAPER, Motion([held_start()]))
    with pytest.raises(InputError, match="no initial shape"):
        simulation.advance(0)
    with pytest.raises(InputError, match=r"7 control points; rod\.control_points is 10"):
        simulation.start([Observation(0, np.zeros((7, 4)))])
    with pytest.raises(InputError, match="known are"):
        Simulation(PAPER, Motion(), parameters=("colour",))


def test_a_new_grip_and_finer_basis_go_on_from_the_present_shape():
    simulation = Simulation(PAPER, Motion([held_start()]))
    simulation.start(first_shape())
    simulation.advance(SECOND // 10)
    tip = simulation.prediction().control_points[-1, :3]
    simulation.motion.add(
        command(["start", "control_point_10"], [0.0], [[0, 0, 0], tip], stamp=SECOND // 10)
    )
    after = simulation.advance(SECOND // 2).control_points
    np.testing.assert_allclose(after[-1, :3], tip, atol=1e-9)
    coarse = simulation.model.basis.spans
    shape = simulation.prediction().control_points
    simulation.update(PAPER.with_material(1e6, 2500.0))
    assert simulation.model.basis.spans > coarse
    np.testing.assert_allclose(simulation.prediction().control_points, shape, atol=1e-6)
    simulation.advance(SECOND)
