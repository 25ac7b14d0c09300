# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The discrete rod in space behind simulated experiments, against independent answers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp
from scipy.linalg import eig_banded
from scipy.spatial.transform import Rotation

from dlo_ros.parameters import DampingParameters, RodParameters
from dlo_ros.synthesis.discrete_rod import DiscreteRod
from dlo_ros.synthesis.rod_laws import Contact
from dlo_ros.synthesis.spatial_boundary import SpatialBoundary
from dlo_ros.synthesis.spatial_energy import (
    Drag,
    EndFrames,
    Frames,
    SpatialPotential,
    evaluate,
    moved,
)
from dlo_ros.synthesis.spatial_rod import edges_of, first_director, in_space, twist_free
from dlo_ros.synthesis.spatial_rod_kernels import BANDS, DOF
from dlo_ros.synthesis.spatial_simulation import SpatialSimulation

ROPE = RodParameters(length=0.4, diameter=0.004, young_modulus=5e7, density=2500.0)
NO_DAMPING = DampingParameters(air_drag=0.0, relaxation_time=0.0)
WEIGHTLESS = np.zeros(3)
GRAVITY = np.array([0.0, 0.0, -9.81])
X, Y, Z = np.eye(3)


def rod_in_space(edges, rope=ROPE, damping=NO_DAMPING, gravity=GRAVITY):
    return in_space(DiscreteRod.uniform(rope, damping, edges=edges), rope, gravity)


def straight(rod):
    return rod.u[:, None] * X


def clamped(_):
    return SpatialBoundary({0: np.zeros(3)}, (X, None))


def spun(director, tangent, angle):
    """Directors (n, 3) turned about unit tangents by angles [rad], shape (n,)."""
    return Rotation.from_rotvec(angle[:, None] * tangent).apply(director)


def random_shape(edges, rng):
    x = np.arange(edges + 1)[:, None] * 0.05 * X + rng.normal(0.0, 0.01, (edges + 1, 3))
    tangent, _ = edges_of(x)
    director = twist_free(tangent, first_director(tangent[0]))
    return Frames(x, spun(director, tangent, rng.normal(0.0, 0.3, edges)))


@pytest.mark.parametrize("ends", ["clamped", "free"])
def test_gradient_and_hessian_are_exact(ends):
    rng, edges = np.random.default_rng(1), 4
    nodes, size = edges + 1, DOF * (edges + 1)
    shape = random_shape(edges, rng)
    tangents = np.array([[1.0, 0.1, 0.2], [1.0, -0.2, 0.1]])
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    root = rng.normal(0.0, 1.0, (nodes, 3, 3))
    stiffness = root @ root.transpose(0, 2, 1)
    soft = np.zeros_like(stiffness)
    soft[:, :2, :2] = stiffness[:, :2, :2]
    if ends == "free":
        tangents[:] = np.nan
        stiffness[[0, -1]], soft[[0, -1]] = 0.0, 1e-12 * np.eye(3)
    along = rng.normal(0.0, 1.0, (nodes, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    offset = rng.normal(0.0, 0.1, (nodes, 3))
    offset[[0, -1]] *= ends == "clamped"
    free = np.ones(size, dtype=np.bool_)
    free[[1, -1]] = False
    potential = SpatialPotential(
        free=free, lengths=np.full(edges, 0.05),
        ends=EndFrames(tangents, np.array([first_director(t) for t in tangents])),
        stretch=(rng.uniform(1.0, 2.0, edges), rng.normal(0.0, 0.1, edges)),
        stiffness=stiffness, offset=offset,
        softening=(soft, rng.normal(0.0, 0.1, (nodes, 3)), rng.uniform(0.1, 0.3, nodes)),
        spring=(rng.uniform(0.0, 1.0, nodes), rng.uniform(0.0, 1.0, edges)),
        load=(rng.normal(0.0, 1.0, (nodes, 3)), rng.normal(0.0, 1.0, edges)),
        contact=Contact(True, np.array([[0.1, -0.02, 0.05]]), 30.0, 0.01,
                        np.array([0.1, np.sqrt(0.99), 0.004])),
        drag=Drag(rng.uniform(0.0, 1.0, nodes), along, rng.normal(0.0, 1.0, (nodes, 3)), 3.0),
    )  # fmt: skip
    spin = rng.normal(0.0, 0.1, edges)
    _, gradient, band = evaluate(shape, spin, potential)

    def value(change):
        turned = spin + change.reshape(-1, DOF)[:-1, 3]
        return evaluate(moved(shape, change), turned, potential, slopes=False)[0]

    hessian = np.zeros((size, size))
    for d in range(BANDS):
        for j in range(size - d):
            hessian[j + d, j] = hessian[j, j + d] = band[d, j]
    unit = np.eye(size)
    slopes = np.array([(value(1e-6 * e) - value(-1e-6 * e)) / 2e-6 for e in unit])
    np.testing.assert_allclose(gradient[free], slopes[free], atol=2e-8 * np.abs(gradient).max())
    assert not gradient[~free].any()

    def second(a, b, h):
        corners = [value(h * (p * a + q * b)) * p * q for p in (1, -1) for q in (1, -1)]
        return sum(corners) / (4.0 * h * h)

    for i in np.nonzero(free)[0]:
        for j in np.nonzero(free[: i + 1])[0]:
            fine, coarse = (second(unit[i], unit[j], h) for h in (1e-4, 2e-4))
            difference = (4.0 * fine - coarse) / 3.0
            assert hessian[i, j] == pytest.approx(difference, abs=3e-6 * np.abs(hessian).max())


def test_helix_at_rest():
    """Curvature at rest that turns with u in the twist-free frame: a helix, free of any load."""
    curvature, torsion, edges = 12.0, 7.0, 200
    rod = rod_in_space(edges, gravity=WEIGHTLESS)
    rod.rest_curvature = curvature * np.cos(torsion * rod.u)
    rod.second_curvature = curvature * np.sin(torsion * rod.u)
    simulation = SpatialSimulation(rod, clamped, straight(rod))
    x = simulation.settle()
    # Frenet: curvature about the binormal, which begins along the first director, y.
    pace = np.hypot(curvature, torsion)

    def frenet(_, state):
        t, n, b = state[3:].reshape(3, 3)
        rates = curvature * n, -curvature * t + torsion * b, -torsion * n
        return np.concatenate([t, *rates])

    start = np.concatenate([np.zeros(3), X, np.cross(Y, X), Y])
    path = solve_ivp(frenet, (0.0, 0.401), start, t_eval=rod.u, rtol=1e-10, atol=1e-12).y[:3].T
    assert np.linalg.norm(x - path, axis=1).max() < 2e-5
    axis = (curvature * Y + torsion * X) / pace  # climbs by torsion over pace
    assert x[-1] @ axis == pytest.approx(0.4 * torsion / pace, rel=1e-3)
    assert np.abs(simulation.twist).max() < 1e-6


@pytest.mark.parametrize("share", [0.98, 1.02])
def test_twisted_ring_buckles_as_michell_says(share):
    """A closed ring leaves its plane beyond a twist of 2 pi sqrt(3) B / C.

    Michell, On the stability of a bent and twisted wire, 1889; Zajac, Stability of two planar loop
    elasticas, 1962.
    """
    edges = 120
    rope = replace(ROPE, young_modulus=2e8)
    rod = rod_in_space(edges, rope, gravity=WEIGHTLESS)
    stiff = rod.vertex_stiffness()
    ratio = rope.bending_stiffness / rod.twist_stiffness[0]
    # A vertex of a polygon bends by 2 tan(phi / 2), half as far at both clamps.
    angle = np.concatenate([[0.0], (np.arange(edges) + 0.5) * 2.0 * np.pi / edges])
    steps = rod.lengths[:, None] * np.column_stack(
        [np.cos(angle[1:]), np.zeros(edges), -np.sin(angle[1:])]
    )
    x = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    tangent, _ = edges_of(x)
    total = share * 2.0 * np.pi * np.sqrt(3.0) * ratio
    twist = total * (np.arange(edges) + 0.5) / edges
    director = spun(np.tile(Y, (edges, 1)), tangent, twist)
    end = np.cos(total) * Y + np.sin(total) * np.cross(X, Y)
    boundary = SpatialBoundary({0: np.zeros(3), edges: x[-1]}, (X, X))
    none = np.zeros(edges)
    potential = SpatialPotential(
        free=boundary.free(edges + 1), lengths=rod.lengths,
        ends=EndFrames(np.array([X, X]), np.array([Y, end])),
        stretch=(rod.stretch_stiffness * rod.lengths, none), stiffness=stiff,
        offset=np.zeros((edges + 1, 3)), softening=None,
        spring=(np.zeros(edges + 1), none), load=(np.zeros((edges + 1, 3)), none),
        contact=rod.contact(), drag=None,
    )  # fmt: skip
    assert np.linalg.norm(x[-1]) < 1e-12
    shape = Frames(x, director)
    for _ in range(4):  # the polygon is an equilibrium but for its first and last vertex
        _, gradient, band = evaluate(shape, none, potential)
        full = np.zeros((len(gradient), len(gradient)))
        for d in range(BANDS):
            at = np.arange(len(gradient) - d)
            full[at + d, at] = full[at, at + d] = band[d, : len(at)]
        shape = moved(shape, np.linalg.lstsq(full, -gradient, rcond=1e-13)[0])
    _, gradient, band = evaluate(shape, none, potential)
    assert np.abs(gradient).max() < 1e-6 * rope.bending_stiffness / 0.4**2
    lowest = eig_banded(band, lower=True, eigvals_only=True, select="i", select_range=(0, 2))
    # One mode costs nothing: the ring may roll about its tangent at the clamp.
    neutral = 1e-3 * np.abs(lowest).max()
    assert np.count_nonzero(np.abs(lowest) < neutral) == 1
    assert bool(lowest[0] < -neutral) == (share > 1.0)


def kirchhoff(rope, start, end, gravity, guess):
    """Centreline of a clamped, bent and twisted rod under its weight, by a boundary value solver.

    Args:
        start, end: position and rotation of the clamps; x along the rod.
        guess: positions at u, shape (m, 3), and rotations of the material frame, m of them.

    Returns:
        A function of u (m,) that returns positions (3, m).
    """
    b, c = rope.bending_stiffness, rope.shear_modulus * 2.0 * rope.second_moment
    ea, weight = rope.young_modulus * rope.area, rope.linear_density * gravity

    def rates(s, y):
        q, n, m = y[3:7], y[7:10], y[10:13]
        frames = Rotation.from_quat(q.T).as_matrix()  # columns: tangent and both directors
        t = frames[:, :, 0].T
        moment = np.einsum("kji,jk->ik", frames, m)
        bend = moment / np.array([c, b, b])[:, None]
        w = np.einsum("kij,jk->ik", frames, bend)  # in the board frame
        vector, scalar = q[:3], q[3]
        dq = 0.5 * np.vstack(
            [scalar * w + np.cross(w.T, vector.T).T, -np.sum(w * vector, axis=0)[None]]
        )
        dr = (1.0 + np.sum(n * t, axis=0) / ea) * t
        dn = np.tile(-weight[:, None], (1, len(s)))
        return np.vstack([dr, dq, dn, -np.cross(dr.T, n.T).T])

    def ends(a, e):
        turned = Rotation.from_quat(e[3:7]) * end[1].inv()
        return np.concatenate(
            [a[:3] - start[0], a[3:7] - start[1].as_quat(), e[:3] - end[0], turned.as_quat()[:3]]
        )

    x, rotations = guess
    s = np.linspace(0.0, rope.length, len(x))
    first = np.vstack([x.T, rotations.as_quat().T, np.zeros((6, len(x)))])
    for k in range(1, len(x)):  # no jump to the opposite quaternion
        first[3:7, k] *= np.sign(first[3:7, k] @ first[3:7, k - 1])
    first[3:7] *= np.sign(first[3:7, 0] @ start[1].as_quat())
    solution = solve_bvp(rates, ends, s, first, tol=1e-6, max_nodes=40000)
    assert solution.success, solution.message
    return lambda u: solution.sol(u)[:3]


def test_twisted_and_bent_rod_is_that_of_kirchhoffs_equations():
    edges, turn = 200, 4.0
    rope = replace(ROPE, young_modulus=2e7)
    tip = np.array([0.27, 0.06, 0.03])
    tilted = Rotation.from_euler("YZ", [-0.7, 0.5])
    rod = rod_in_space(edges, rope, DampingParameters(air_drag=0.5, relaxation_time=0.01))

    def boundary(time):
        rotation = tilted * Rotation.from_rotvec([turn * min(time, 1.0), 0.0, 0.0])
        along = rotation.as_matrix()[:, 0]
        return SpatialBoundary(
            {0: np.zeros(3), edges: tip}, (X, along), (np.eye(3), rotation.as_matrix())
        )

    curve = np.array([[0.0, 0.0, 0.0], [0.15, 0.03, -0.12], [0.27, 0.06, 0.03]])
    at = np.linspace(0.0, 0.4, 3)
    laid = np.column_stack([np.interp(rod.u, at, column) for column in curve.T])
    simulation = SpatialSimulation(rod, boundary, laid, step=5e-3)
    flat = simulation.settle()
    assert abs(simulation.twist[-1]) < 1e-8  # it begins free of twist
    simulation.advance(1.0)
    x = simulation.settle_here()
    assert simulation.twist[-1] == pytest.approx(turn, abs=0.6)  # the rest is writhe
    frames = np.stack(
        [
            edges_of(simulation.x)[0],
            simulation.director,
            np.cross(edges_of(simulation.x)[0], simulation.director),
        ],
        axis=-1,
    )
    first = np.column_stack([X, Y, Z])
    last = np.column_stack(
        [simulation.ends.tangent[1], simulation.ends.director[1],
         np.cross(simulation.ends.tangent[1], simulation.ends.director[1])]
    )  # fmt: skip
    middle = 0.5 * (x[1:] + x[:-1])
    points = np.vstack([np.zeros(3), middle[4::5], tip])
    rotations = Rotation.from_matrix(np.concatenate([first[None], frames[4::5], last[None]]))
    exact = kirchhoff(
        rope, (np.zeros(3), Rotation.from_matrix(first)), (tip, Rotation.from_matrix(last)),
        GRAVITY, (points, rotations),
    )  # fmt: skip
    assert np.linalg.norm(x - exact(rod.u).T, axis=1).mean() < 5e-5 * 0.4
    assert np.linalg.norm(x - flat, axis=1).max() > 0.015  # the twist has moved it


@pytest.mark.slow
def test_pendulum_in_space_follows_its_pivot():
    """A stiff rod whose pivot is moved along two axes: a rigid spherical pendulum."""
    rope = RodParameters(0.4, 0.01, 2e10, 2500.0)
    rod = rod_in_space(20, rope)

    def pivot(t):
        return np.array([0.06 * (1.0 - np.cos(5.0 * t)), 0.05 * np.sin(4.0 * t) ** 2, 0.0])

    def push(t):
        return np.array([1.5 * np.cos(5.0 * t), 1.6 * np.cos(8.0 * t), 0.0])

    simulation = SpatialSimulation(
        rod, lambda t: SpatialBoundary({0: pivot(t)}), -rod.u[:, None] * Z, step=2e-3
    )
    simulation.settle()

    def rates(t, y):
        n, rate = y[:3], y[3:]
        pull = 1.5 / rope.length * (GRAVITY - push(t))
        return np.concatenate([rate, pull - (pull @ n) * n - (rate @ rate) * n])

    times = np.linspace(0.1, 1.2, 12)
    start = np.concatenate([-Z, np.zeros(3)])
    exact = solve_ivp(rates, (0.0, 1.3), start, t_eval=times, rtol=1e-10, atol=1e-12).y[:3].T
    found = []
    for t in times:
        x = simulation.advance(t)
        found.append((x[-1] - x[0]) / rope.length)
    assert np.abs(exact[:, 1]).max() > 0.15 and np.abs(exact[:, 0]).max() > 0.3
    np.testing.assert_allclose(found, exact, atol=3e-3)


def bent_by_its_clamp(edges, step, until=0.05):
    """A rod whose clamp is turned about three axes, at a time [s]."""
    rod = rod_in_space(edges, damping=DampingParameters(air_drag=0.05, relaxation_time=0.003))

    def boundary(time):
        turn = Rotation.from_rotvec(np.sin(15.0 * time) ** 2 * np.array([1.0, -0.5, 0.7]))
        return SpatialBoundary(
            {0: np.zeros(3)}, (turn.as_matrix()[:, 0], None), (turn.as_matrix(), None)
        )

    simulation = SpatialSimulation(rod, boundary, straight(rod), step=step)
    simulation.settle()
    return simulation.advance(until)


@pytest.mark.slow
def test_error_falls_with_the_square_of_edge_and_step():
    def ratio(coarse, finer, finest):
        every = [len(x) // 20 for x in (coarse, finer, finest)]
        c, f, best = (x[::n] for x, n in zip((coarse, finer, finest), every, strict=True))
        errors = [np.linalg.norm(x - best, axis=1).mean() for x in (c, f)]
        return errors[0] / errors[1]

    assert 3.0 < ratio(*(bent_by_its_clamp(n, 2e-3) for n in (40, 80, 240))) < 5.0
    assert 3.0 < ratio(*(bent_by_its_clamp(20, h) for h in (2e-3, 1e-3, 1.25e-4))) < 5.0


def test_energy_is_kept_without_damping():
    """A rod that hangs, let go from a pull aside and twisted: BDF2 loses little, gains nothing."""
    rod = rod_in_space(20)
    rod.second_curvature[:] = 3.0
    simulation = SpatialSimulation(rod, clamped, straight(rod), step=5e-4)
    simulation.settle()
    simulation.rod.force[-1] = [0.0, 0.02, 0.01]
    start = simulation.energy
    simulation.advance(0.05)
    pushed = simulation.energy
    moved_by = np.abs(simulation.x[-1, 1])
    simulation.advance(0.2)
    assert moved_by > 1e-3
    # The force is dead, and has its potential in the energy.
    scale = 0.02 * moved_by
    assert abs(pushed - start) < 0.05 * scale
    assert -0.1 * scale < simulation.energy - start < 1e-3 * scale


def test_turning_a_clamp_twists_the_rod_by_full_turns():
    edges = 20
    rod = rod_in_space(edges, gravity=WEIGHTLESS)
    tip = 0.4 * 1.002 * X  # drawn tight, it stays straight

    def boundary(time):
        turned = Rotation.from_rotvec([9.0 * time, 0.0, 0.0]).as_matrix()
        return SpatialBoundary({0: np.zeros(3), edges: tip}, (X, X), (turned, np.eye(3)))

    simulation = SpatialSimulation(rod, boundary, straight(rod), step=5e-3)
    simulation.settle()
    simulation.advance(1.0)
    np.testing.assert_allclose(simulation.twist, 9.0 * (1.0 - rod.u / 0.4), atol=2e-3)
