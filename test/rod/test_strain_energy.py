# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The strain energy's gradient, Hessian and frames against differences and rigid motion."""

import numpy as np
import pytest
from rods import PAPER
from scipy.spatial.transform import Rotation

from dlo_ros.rod.boundary.twist_free_frame import twist_free
from dlo_ros.rod.elements import planar_assembly
from dlo_ros.rod.elements.constitutive_law import respond, room
from dlo_ros.rod.elements.rod_tables import (
    BAND,
    NO_SPRINGS,
    ConstitutiveLaw,
    InternalVariables,
    Material,
    Reference,
    Stiffness,
    Surroundings,
)
from dlo_ros.rod.elements.spatial_assembly import assemble, scatter_stress, strain_increments
from dlo_ros.rod.elements.strains import strains, transport
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.solve import banded_factorisation, constraints
from dlo_ros.spline import SplineBasis

NEVER = np.full(24, np.inf)
LINEAR = ConstitutiveLaw(0.0, NEVER, NEVER, 0.0, 0.0, 1.0, 0.0, NEVER)
SOFT = LINEAR._replace(active=1.0, half_curvature=np.full(24, 20.0))


@pytest.fixture
def rod():
    """A crumpled rod with rest strains and two bending stiffnesses, away from its reference."""
    rng = np.random.default_rng(5)
    n = 11
    model = RodModel(PAPER, SplineBasis(n, 0.4), False, True)
    nb = model.rule.weight.size

    def a_span(values):  # of stretch and twist: the same modulus all over a span
        return np.repeat(values, 3)

    spans = model.basis.spans
    stiff = Stiffness(
        a_span(600.0 + 50.0 * rng.random(spans)),
        a_span(0.01 * rng.normal(size=spans)),
        np.column_stack([6e-4 * (1 + rng.random((nb, 2))), np.full(nb, 1e-4)]),
        3.0 * rng.normal(size=(nb, 2)),
        a_span(4e-4 * (1 + rng.random(spans))),
        model.discretisation.span_twists(2.0 * rng.normal(size=nb)),
    )
    q = np.zeros((n, 4))
    q[:, 0] = model.basis.greville
    q[:, :3] += 0.012 * rng.normal(size=(n, 3))
    q[:, 3] = rng.normal(size=n)
    ref, _ = twist_free(q, model.basis, model.points)
    ref = Reference(ref.tangent, ref.rate, ref.director, rng.normal(size=nb))
    return model.rule, stiff, ref, q + 0.01 * rng.normal(size=(n, 4))


def material(stiff, law):
    nb = stiff.twist.size
    internal = InternalVariables(np.zeros((nb, 2)), np.zeros((nb, 2)), np.zeros((0, 6)))
    nothing = np.zeros((0, 3))
    around = Surroundings(
        0.0, 1.0, nothing, 0.0, np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros(0), nothing, 0.0,
        NO_SPRINGS,
    )  # fmt: skip
    return Material(stiff, 1.0, stiff.bend_rest, law, around, internal, 0.0, 0.0)


def evaluate(rule, stiff, ref, q, law=LINEAR):
    """Energy, gradient, band of the Hessian and the derivatives of the strains, in space."""
    gradient, band = np.full(q.size, np.nan), np.full((q.size, BAND + 1), np.nan)
    by_stretch, by_other = np.empty((rule.weight.size, 3)), np.empty((rule.weight.size, 3, 8))
    stretch, other = strains(q, rule, ref)
    response = room(rule.weight.size)
    energy = respond(stretch, other, rule.weight, material(stiff, law), response)
    assemble(q, rule, ref, other, response, gradient, band, by_stretch, by_other)
    return energy, gradient, band, by_stretch, by_other


def evaluate_flat(rule, stiff, q):
    """The same in the plane."""
    gradient, band = np.full(q.size, np.nan), np.full((q.size, 8), np.nan)
    by_stretch, by_other = np.empty((rule.weight.size, 2)), np.empty((rule.weight.size, 1, 4))
    stretch, other = planar_assembly.strains(q, rule)
    response = room(rule.weight.size)
    energy = respond(stretch, other, rule.weight, material(stiff, LINEAR), response)
    planar_assembly.assemble(q, rule, other, response, gradient, band, by_stretch, by_other)
    return energy, gradient, band, by_stretch, by_other


def dense(band):
    """A symmetric matrix of its lower rows."""
    size, last = band.shape[0], band.shape[1] - 1
    full = np.zeros((size, size))
    for i in range(size):
        for j in range(max(0, i - last), i + 1):
            full[i, j] = full[j, i] = band[i, last - i + j]
    return full


def assert_derivatives(function, q):
    """Gradient and Hessian of `function` are those of its energy, by differences of order 4."""
    _, gradient, band, *_ = function(q)
    hessian, step = dense(band), 2e-6
    for i in range(q.size):
        energy_slope, gradient_slope = 0.0, np.zeros(q.size)
        for k, weight in ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0)):
            moved = q.copy()
            moved.flat[i] += k * step
            energy, g, *_ = function(moved)
            energy_slope += weight * energy / (12.0 * step)
            gradient_slope += weight * g / (12.0 * step)
        assert energy_slope == pytest.approx(gradient[i], abs=1e-8 * np.abs(gradient).max())
        np.testing.assert_allclose(gradient_slope, hessian[i], atol=1e-8 * np.abs(band).max())


@pytest.mark.parametrize("law", [LINEAR, SOFT], ids=["linear", "softening"])
def test_gradient_and_hessian_are_the_derivatives_of_the_energy(rod, law):
    rule, stiff, ref, q = rod
    assert_derivatives(lambda x: evaluate(rule, stiff, ref, x, law), q)


def test_gradient_and_hessian_in_the_plane_are_the_derivatives_of_the_energy(rod):
    rule, stiff, _, q = rod
    assert_derivatives(lambda x: evaluate_flat(rule, stiff, x), q[:, [0, 2]].copy())


def test_the_plane_is_space_without_what_leaves_it(rod):
    rule, stiff, ref, q = rod
    q = q * [1.0, 0.0, 1.0, 0.0]
    nb = rule.weight.size
    tangent = ref.tangent * [1.0, 0.0, 1.0]
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    across = np.tile([0.0, 1.0, 0.0], (nb, 1))
    flat_ref = Reference(tangent, 0.0 * across, across, np.zeros(nb))
    straight = stiff._replace(bend_rest=stiff.bend_rest * [1.0, 0.0], twist_rest=np.zeros(nb))
    energy, gradient, band, *_ = evaluate(rule, straight, flat_ref, q)
    flat = evaluate_flat(rule, straight, np.ascontiguousarray(q[:, [0, 2]]))
    kept = np.flatnonzero(np.arange(q.size) % 2 == 0)  # x and z
    scale = np.abs(band).max()
    assert flat[0] == pytest.approx(energy, rel=1e-13)
    np.testing.assert_allclose(flat[1], gradient[kept], atol=1e-13 * np.abs(gradient).max())
    np.testing.assert_allclose(dense(flat[2]), dense(band)[np.ix_(kept, kept)], atol=1e-13 * scale)


@pytest.mark.parametrize("flat", [False, True], ids=["space", "plane"])
def test_strain_increments_are_the_differences_of_the_strains_and_forces_their_transpose(rod, flat):
    rule, stiff, ref, q = rod
    rng = np.random.default_rng(8)
    nb = rule.weight.size
    if flat:
        q = np.ascontiguousarray(q[:, [0, 2]])
        *_, by_stretch, by_other = evaluate_flat(rule, stiff, q)
        forces, increments = planar_assembly.scatter_stress, planar_assembly.strain_increments
    else:
        *_, by_stretch, by_other = evaluate(rule, stiff, ref, q)
        forces, increments = scatter_stress, strain_increments

    def all_strains(x):
        return planar_assembly.strains(x, rule) if flat else strains(x, rule, ref)

    direction, step = rng.normal(size=q.shape), 1e-6
    stretch, other = np.full(nb, np.nan), np.full((nb, 3), np.nan)
    increments(rule, by_stretch, by_other, direction, stretch, other)
    up, down = all_strains(q + step * direction), all_strains(q - step * direction)
    for found, high, low in zip((stretch, other), up, down, strict=True):
        wanted = (high - low) / (2 * step)
        np.testing.assert_allclose(found, wanted, atol=1e-7 * np.abs(wanted).max())
    # Stresses of stretch and twist are those of whole spans, straight lines at the most.
    along = np.tile([-1.0, 0.0, 1.0], nb // 3)
    whole = np.repeat(rng.normal(size=nb // 3), 3)
    stress_s = whole + along * np.repeat(rule.stretch_linear, 3)
    stress_o = rng.normal(size=(nb, 3))
    stress_o[:, 2] = whole + along * np.repeat(rule.twist_linear, 3)
    force = np.ones(q.size)
    forces(rule, by_stretch, by_other, stress_s, stress_o, force)
    power = np.sum(rule.weight * (stress_s * stretch + np.sum(stress_o * other, axis=1)))
    assert (force - 1.0) @ direction.ravel() == pytest.approx(power, rel=1e-11)


def test_carrying_the_frame_along_changes_no_strain(rod):
    rule, _, ref, q = rod
    before = strains(q, rule, ref)
    after = strains(q, rule, transport(q, rule, ref))
    np.testing.assert_allclose(after[0], before[0], atol=1e-12)
    np.testing.assert_allclose(after[1], before[1], atol=1e-10)


def test_twist_of_the_transported_frame_is_that_of_its_directors():
    """The twist the formula gives is d1' . d2 of the transported directors, by differences in u."""
    basis = SplineBasis(9, 0.4)
    model = RodModel(PAPER, basis)
    rng = np.random.default_rng(2)
    q0 = np.zeros((9, 4))
    q0[:, 0] = basis.greville
    q0[:, :3] += 0.01 * rng.normal(size=(9, 3))
    q1 = q0.copy()
    q1[:, :3] += 0.02 * rng.normal(size=(9, 3))
    points = np.array([0.05, 0.21, 0.35])  # with their neighbours in one knot span each
    step = 1e-5
    u = np.sort(np.concatenate([points - step, points, points + step]))
    ref, _ = twist_free(q0, basis, u)
    rule = model.rule._replace(
        span=np.minimum((u / basis.span_length).astype(np.int64), basis.spans - 1),
        weight=np.ones(len(u)),
    )
    local = [
        np.array([basis.matrix(x, k)[0, s : s + 4] for x, s in zip(u, rule.span, strict=True)])
        for k in range(3)
    ]
    rule = rule._replace(b=local[0], b1=local[1], b2=local[2])
    new = transport(q1, rule, ref)
    for k in (1, 4, 7):
        slope = (new.director[k + 1] - new.director[k - 1]) / (2 * step)
        second = np.cross(new.tangent[k], new.director[k])
        assert slope @ second == pytest.approx(new.twist[k], rel=1e-4, abs=1e-3)


def test_forces_do_not_change_with_rigid_motion(rod):
    rule, stiff, ref, q = rod
    turn = Rotation.from_quat([0.3, -0.5, 0.2, 0.7]).as_matrix()
    moved = q.copy()
    moved[:, :3] = q[:, :3] @ turn.T + np.array([1.0, -2.0, 3.0])
    turned = Reference(ref.tangent @ turn.T, ref.rate @ turn.T, ref.director @ turn.T, ref.twist)
    energy, gradient, *_ = evaluate(rule, stiff, ref, q)
    energy2, gradient2, *_ = evaluate(rule, stiff, turned, moved)
    assert energy2 == pytest.approx(energy, rel=1e-11)
    expected = gradient.reshape(-1, 4).copy()
    expected[:, :3] = expected[:, :3] @ turn.T
    np.testing.assert_allclose(
        gradient2.reshape(-1, 4), expected, atol=1e-10 * np.abs(gradient).max()
    )


def banded_matrix(rng, size, width, shift):
    """A random symmetric banded matrix and its lower rows."""
    full = rng.normal(size=(size, size))
    full = full + full.T + shift * np.eye(size)
    full[np.abs(np.subtract.outer(np.arange(size), np.arange(size))) >= width] = 0.0
    band = np.zeros((size, width))
    for i in range(size):
        for j in range(max(0, i - width + 1), i + 1):
            band[i, width - 1 - i + j] = full[i, j]
    return full, band


@pytest.mark.parametrize("width", [16, 8])
@pytest.mark.parametrize("size", [6, 16, 17, 40, 161])
@pytest.mark.parametrize("shift", [0.0, 3.0, 60.0])
def test_banded_factorisation_solves_and_counts_negative_eigenvalues(width, size, shift):
    rng = np.random.default_rng(size + width)
    full, band = banded_matrix(rng, size, width, shift)
    full[3, :], full[:, 3], full[3, 3] = 0.0, 0.0, 1.0  # an imposed unknown
    for i in range(size):
        for j in range(max(0, i - width + 1), i + 1):
            band[i, width - 1 - i + j] = full[i, j]
    values = np.linalg.eigvalsh(full)
    x = rng.normal(size=size)
    product, diagonal = full @ x, np.empty(size)
    assert banded_factorisation.factorise(band, diagonal) == np.count_nonzero(values < 0.0)
    banded_factorisation.solve(band, diagonal, product)
    condition = np.abs(values).max() / np.abs(values).min()
    np.testing.assert_allclose(product, x, atol=1e-12 * condition)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_banded_factorisation_reports_a_pivot_that_is_none(value):
    full, band = banded_matrix(np.random.default_rng(1), 24, 16, 30.0)
    band[7, :] = 0.0
    for i in range(8, 23):
        band[i, 15 - i + 7] = 0.0
    band[7, 15] = value
    assert banded_factorisation.factorise(band, np.empty(24)) == -1
    assert not np.isnan(full).any()


@pytest.mark.parametrize("size", [1, 2, 6])
def test_small_dense_systems_are_solved_with_row_pivots(size):
    rng = np.random.default_rng(size)
    matrix, right = rng.normal(size=(size, size)) * 1e-4, rng.normal(size=size)
    if size > 1:
        matrix[0, 0] = 0.0
    x = right.copy()
    assert constraints._solve_pivoted.py_func(matrix.copy(), x)
    np.testing.assert_allclose(x, np.linalg.solve(matrix, right), rtol=1e-10)
    for entries in (0.0, 3.0 if size > 1 else 0.0):
        singular = np.full((size, size), entries)
        assert not constraints._solve_pivoted.py_func(singular, right.copy())


def test_banded_factorisation_refuses_other_widths():
    with pytest.raises(ValueError, match="16 or 8"):
        banded_factorisation.factorise(np.ones((20, 12)), np.empty(20))
