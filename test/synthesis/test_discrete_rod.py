# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The discrete rod behind simulated experiments against independent answers."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from dlo_ros.errors import InputError, SimulationError
from dlo_ros.parameters import DampingParameters, RodParameters
from dlo_ros.synthesis import rod_kernels
from dlo_ros.synthesis.discrete_rod import DiscreteRod, centreline, lay_along, mesh
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation, ImposedNodes

ROPE = RodParameters(length=0.4, diameter=0.004, young_modulus=5e7, density=2500.0)
NO_DAMPING = DampingParameters(air_drag=0.0, relaxation_time=0.0)
ORIGIN = np.zeros(2)
WEIGHTLESS = (0.0, 0.0)


def clamped(_: float) -> ImposedNodes:
    return ImposedNodes({0: ORIGIN}, start=0.0)


def free(_: float) -> ImposedNodes:
    return ImposedNodes({})


def straight(rod: DiscreteRod) -> np.ndarray:
    return np.column_stack([rod.u, np.zeros(len(rod.u))])


def elastica(rope: RodParameters, tip_load: float, weight: float, u: np.ndarray) -> np.ndarray:
    """Extensible cantilever, clamped along +x, by a boundary value solver; shape (m, 2)."""
    b, ea = rope.bending_stiffness, rope.young_modulus * rope.area

    def rate(s, y):
        force = -weight * (rope.length - s) - tip_load
        grown = 1.0 + force * np.sin(y[0]) / ea
        return np.vstack(
            [y[1], -grown * np.cos(y[0]) * force / b, grown * np.cos(y[0]), grown * np.sin(y[0])]
        )

    def ends(a, e):
        return np.array([a[0], e[1], a[2], a[3]])

    s = np.linspace(0.0, rope.length, 400)
    turn = np.exp(-s / (b / (weight + tip_load)) ** (1 / 3))
    guess = np.vstack([0.5 * np.pi * (turn - 1.0), -turn, s * turn, -s * (1.0 - turn)])
    solution = solve_bvp(rate, ends, s, guess, tol=1e-9, max_nodes=200000)
    assert solution.success
    return solution.sol(u)[2:].T


def test_gradient_and_hessian_are_exact():
    rod = DiscreteRod.uniform(ROPE, NO_DAMPING, edges=9)
    rng = np.random.default_rng(1)
    nodes = len(rod.u)
    x = straight(rod) + rng.normal(0.0, 0.006, (nodes, 2))
    clamps = np.array([0.3, -0.4])
    offsets = (rng.normal(0.0, 1e-3, nodes - 1), rng.normal(0.0, 1e-3, nodes))

    def evaluate(flat):
        gradient, band = np.zeros((nodes, 2)), np.zeros((rod_kernels.BANDS, 2 * nodes))
        value = rod_kernels.elastic(
            flat.reshape(-1, 2),
            rod.lengths,
            clamps,
            rod.stiffness(),
            offsets,
            rod.bending_law(),
            gradient,
            band,
        )
        return value, gradient.ravel(), band

    _, gradient, band = evaluate(x.ravel())
    hessian = np.zeros((2 * nodes, 2 * nodes))
    for d in range(rod_kernels.BANDS):
        for j in range(2 * nodes - d):
            hessian[j + d, j] = hessian[j, j + d] = band[d, j]
    for i in range(2 * nodes):
        step = np.zeros(2 * nodes)
        step[i] = 1e-7
        up, gradient_up, _ = evaluate(x.ravel() + step)
        down, gradient_down, _ = evaluate(x.ravel() - step)
        assert gradient[i] == pytest.approx((up - down) / 2e-7, abs=1e-7 * abs(gradient).max())
        differences = (gradient_up - gradient_down) / 2e-7
        np.testing.assert_allclose(hessian[i], differences, atol=1e-7 * abs(hessian).max())


@pytest.mark.parametrize("young_modulus", [1e6, 5e7, 2e9])
def test_cantilever_under_its_own_weight(young_modulus):
    rope = RodParameters(0.4, 0.004, young_modulus, 2500.0)
    rod = DiscreteRod.uniform(rope, NO_DAMPING, edges=160)
    x = DiscreteRodSimulation(rod, clamped, straight(rod)).settle()
    expected = elastica(rope, 0.0, rope.linear_density * 9.81, rod.u)
    error = np.linalg.norm(x - expected, axis=1)
    assert error.mean() < 3e-4 * rope.length  # L/l = 11.6, 3.15 and 0.9
    assert abs(expected[-1, 1]) > 0.01


def test_tip_load_large_and_small():
    for load in (0.05, 1e-5):
        rod = DiscreteRod.uniform(ROPE, NO_DAMPING, gravity=WEIGHTLESS, edges=160)
        rod.force[-1, 1] = -load
        x = DiscreteRodSimulation(rod, clamped, straight(rod)).settle()
        error = np.linalg.norm(x - elastica(ROPE, load, 0.0, rod.u), axis=1).max()
        assert error < 2e-4 * np.abs(x[-1, 1])
        if load < 1e-4:
            small = -load * ROPE.length**3 / (3.0 * ROPE.bending_stiffness)
            assert x[-1, 1] == pytest.approx(small, rel=1e-3)


def test_error_falls_with_the_square_of_the_edge_length():
    errors = []
    for edges in (20, 40, 80):
        rod = DiscreteRod.uniform(ROPE, NO_DAMPING, edges=edges)
        x = DiscreteRodSimulation(rod, clamped, straight(rod)).settle()
        expected = elastica(ROPE, 0.0, ROPE.linear_density * 9.81, rod.u)
        errors.append(np.linalg.norm(x - expected, axis=1).mean())
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(rates > 1.8) and np.all(rates < 2.3)


def test_both_ends_clamped_agree_with_a_mesh_that_differs():
    """The clamp at u = L mirrors the one at u = 0, whatever the mesh."""

    def settle(nodes_at, edges):
        rod = DiscreteRod.uniform(ROPE, NO_DAMPING, edges=edges, nodes_at=nodes_at)
        last = len(rod.u) - 1
        hold = ImposedNodes({0: ORIGIN, last: np.array([0.25, 0.0])}, start=0.0, end=0.0)
        x = lay_along([(0, 0), (0.125, -0.15), (0.25, 0)], rod)
        x = DiscreteRodSimulation(rod, lambda _: hold, x).settle()
        return centreline(rod, x, np.linspace(0, ROPE.length, 41))

    even, uneven = settle((), 160), settle((0.0191, 0.31), 173)
    np.testing.assert_allclose(even[:, 0], 0.25 - even[::-1, 0], atol=1e-7)
    np.testing.assert_allclose(even, uneven, atol=1e-4 * ROPE.length)


def test_soft_rope_hangs_as_a_catenary():
    soft = RodParameters(0.4, 0.001, 5e6, 2500.0)
    rod = DiscreteRod.uniform(soft, NO_DAMPING, edges=160)
    rod.bending_stiffness *= 1e-3
    hold = ImposedNodes({0: ORIGIN, 160: np.array([0.3, 0.0])})
    x = lay_along([(0, 0), (0.15, -0.13), (0.3, 0)], rod)
    x = DiscreteRodSimulation(rod, lambda _: hold, x).settle()
    low, high = 0.01, 1.0  # 2 a sinh(span / 2a) = L
    for _ in range(60):
        a = 0.5 * (low + high)
        low, high = (a, high) if 2 * a * np.sinh(0.15 / a) > 0.4 else (low, a)
    sag = a * (np.cosh(0.15 / a) - 1.0)
    assert -x[80, 1] == pytest.approx(sag, rel=2e-3)


def test_rest_curvature_gives_a_circle():
    rod = DiscreteRod.uniform(ROPE, NO_DAMPING, gravity=WEIGHTLESS, edges=160)
    rod.rest_curvature[:] = 8.0
    x = DiscreteRodSimulation(rod, clamped, straight(rod)).settle()
    radius = np.linalg.norm(x - np.array([0.0, -1.0 / 8.0]), axis=1)
    np.testing.assert_allclose(radius, 1.0 / 8.0, rtol=1e-4)
    assert x[40, 1] < 0.0  # positive curvature turns from x towards -z


def vibrate(relaxation_time: float) -> tuple[np.ndarray, np.ndarray]:
    """First bending mode of a clamped-free rod released from a small bend: times, amplitude."""
    damping = DampingParameters(air_drag=0.0, relaxation_time=relaxation_time)
    rod = DiscreteRod.uniform(ROPE, damping, gravity=WEIGHTLESS, edges=120)
    rod.force[-1, 1] = -1e-5
    simulation = DiscreteRodSimulation(rod, clamped, straight(rod), step=4e-3)
    simulation.settle()
    rod.force[-1, 1] = 0.0
    s = rod.u / ROPE.length * 1.8751040687
    shape = np.cosh(s) - np.cos(s) - 0.7340955 * (np.sinh(s) - np.sin(s))
    times = np.arange(1, 101) * 0.04
    values = [rod.mass * shape @ simulation.advance(t)[:, 1] for t in times]
    return times, np.array(values)


def fit_decay(times: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Angular frequency and decay rate by linear prediction (exact for one damped sinusoid)."""
    dt = times[1] - times[0]
    columns = np.column_stack([values[1:-1], values[:-2]])
    a, b = np.linalg.lstsq(columns, values[2:], rcond=None)[0]
    root = np.roots([1.0, -a, -b])[0]
    exponent = np.log(root) / dt
    return abs(exponent.imag), -exponent.real


def test_first_frequency_and_internal_damping():
    omega = (1.8751040687 / 0.4) ** 2 * np.sqrt(ROPE.bending_stiffness / ROPE.linear_density)
    frequency, decay = fit_decay(*vibrate(0.0))
    assert frequency == pytest.approx(omega, rel=1e-3)
    assert abs(decay) < 1e-3 * omega
    frequency, decay = fit_decay(*vibrate(0.02))
    assert decay == pytest.approx(0.5 * omega**2 * 0.02, rel=0.01)


def test_free_fall_through_air_keeps_the_shape():
    drag = DampingParameters(air_drag=0.05, relaxation_time=0.002)
    rod = DiscreteRod.uniform(ROPE, drag, edges=60)
    x = straight(rod)
    simulation = DiscreteRodSimulation(rod, free, x, step=1e-3)
    simulation.advance(0.8)
    rate = 0.05 / ROPE.linear_density
    speed = -9.81 / rate * (1.0 - np.exp(-rate * 0.8))
    np.testing.assert_allclose(simulation.v[:, 1], speed, rtol=1e-3)
    np.testing.assert_allclose(np.diff(simulation.x, axis=0), np.diff(x, axis=0), atol=1e-10)


def test_energy_lost_is_the_work_of_drag():
    rod = DiscreteRod.uniform(ROPE, DampingParameters(air_drag=0.02, relaxation_time=0.0))
    simulation = DiscreteRodSimulation(rod, clamped, straight(rod), step=5e-4)
    energies, powers = [], []
    clamps = clamped(0.0).clamps
    for k in range(401):
        simulation.advance(k * 2e-3) if k else None
        energies.append(rod.energy(simulation.x, simulation.v, clamps))
        powers.append(np.sum(rod.drag[:, None] * simulation.v**2))
    assert np.all(np.diff(energies) < 0.0)
    assert energies[0] - energies[-1] == pytest.approx(np.trapezoid(powers, dx=2e-3), rel=0.01)


def test_imposed_nodes_are_met_exactly_while_moving():
    nodes_at = (0.15,)
    rod = DiscreteRod.uniform(ROPE, DampingParameters(), nodes_at=nodes_at)
    pin = int(np.argmin(np.abs(rod.u - 0.15)))
    assert rod.u[pin] == pytest.approx(0.15, abs=1e-15)

    def boundary(t):
        return ImposedNodes({0: ORIGIN, pin: np.array([0.1 - 0.05 * t, -0.05])}, start=0.0)

    simulation = DiscreteRodSimulation(
        rod, boundary, lay_along([(0, 0), (0.1, -0.05), (0.2, -0.3)], rod)
    )
    simulation.settle()
    x = simulation.advance(0.5)
    np.testing.assert_array_equal(x[pin], [0.1 - 0.05 * 0.5, -0.05])
    np.testing.assert_array_equal(x[0], ORIGIN)


def test_mesh_and_bad_input():
    assert mesh(0.4, 100).sum() == pytest.approx(0.4)
    assert np.min(mesh(0.4, 100, (0.123,))) > 0.003
    rod = DiscreteRod.uniform(ROPE, NO_DAMPING)
    with pytest.raises(InputError, match="no length"):
        lay_along([(0.1, 0.1), (0.1, 0.1)], rod)
    balanced = DiscreteRod.uniform(ROPE, NO_DAMPING, gravity=(9.81, 0.0))
    pushed = ImposedNodes({0: ORIGIN, 160: np.array([0.399, 0.0])}, start=0.0, end=0.0)
    with pytest.raises(SimulationError, match="stable equilibrium"):
        DiscreteRodSimulation(balanced, lambda _: pushed, straight(balanced)).settle()
