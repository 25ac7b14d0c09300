"""The strain energy's gradient, Hessian and frames against differences and rigid motion."""

import numpy as np
import pytest
from rods import PAPER
from scipy.spatial.transform import Rotation

from dlo_ros.rod import banded
from dlo_ros.rod.frames import twist_free
from dlo_ros.rod.kernels import assemble, strains, transport
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.tables import BAND, Reference, Stiffness
from dlo_ros.spline import SplineBasis


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
        6e-4 * (1 + rng.random((nb, 2))),
        3.0 * rng.normal(size=(nb, 2)),
        a_span(4e-4 * (1 + rng.random(spans))),
        model.span_twists(2.0 * rng.normal(size=nb)),
    )
    q = np.zeros((n, 4))
    q[:, 0] = model.basis.greville
    q[:, :3] += 0.012 * rng.normal(size=(n, 3))
    q[:, 3] = rng.normal(size=n)
    ref, _ = twist_free(q, model.basis, model.points)
    ref = Reference(ref.tangent, ref.rate, ref.director, rng.normal(size=nb))
    return model.rule, stiff, ref, q + 0.01 * rng.normal(size=(n, 4))


def evaluate(rule, stiff, ref, q):
    gradient, band = np.empty(q.size), np.empty((q.size, BAND + 1))
    stretch, other = np.empty((rule.weight.size, 3)), np.zeros((rule.weight.size, 3, 8))
    energy = assemble(q, rule, stiff, ref, gradient, band, stretch, other)
    return energy, gradient, band


def test_gradient_and_hessian_are_the_derivatives_of_the_energy(rod):
    rule, stiff, ref, q = rod
    _, gradient, band = evaluate(rule, stiff, ref, q)
    step = 1e-6
    for i in range(q.size):
        change = np.zeros(q.size)
        change[i] = step
        up, g_up, _ = evaluate(rule, stiff, ref, q + change.reshape(q.shape))
        down, g_down, _ = evaluate(rule, stiff, ref, q - change.reshape(q.shape))
        assert (up - down) / (2 * step) == pytest.approx(
            gradient[i], abs=2e-8 * np.abs(gradient).max()
        )
        row = np.zeros(q.size)
        for j in range(q.size):
            if abs(i - j) <= BAND:
                row[j] = band[max(i, j), BAND - abs(i - j)]
        np.testing.assert_allclose(
            (g_up - g_down) / (2 * step), row, atol=1e-8 * np.abs(band).max()
        )


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
    points = np.linspace(0.05, 0.35, 3)
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
    energy, gradient, _ = evaluate(rule, stiff, ref, q)
    energy2, gradient2, _ = evaluate(rule, stiff, turned, moved)
    assert energy2 == pytest.approx(energy, rel=1e-11)
    expected = gradient.reshape(-1, 4).copy()
    expected[:, :3] = expected[:, :3] @ turn.T
    np.testing.assert_allclose(
        gradient2.reshape(-1, 4), expected, atol=1e-10 * np.abs(gradient).max()
    )


def test_banded_factorisation_solves_and_counts_negative_eigenvalues():
    rng = np.random.default_rng(0)
    size, w = 40, BAND
    full = rng.normal(size=(size, size))
    full = full + full.T
    full[np.abs(np.subtract.outer(np.arange(size), np.arange(size))) > w] = 0.0
    full += 3.0 * np.eye(size)
    band = np.zeros((size, w + 1))
    for i in range(size):
        for j in range(max(0, i - w), i + 1):
            band[i, w - i + j] = full[i, j]
    product, x = np.empty(size), rng.normal(size=size)
    banded.multiply(band, x, product)
    np.testing.assert_allclose(product, full @ x)
    diagonal = np.empty(size)
    negative = banded.factorise(band, diagonal)
    assert negative == np.count_nonzero(np.linalg.eigvalsh(full) < 0.0) > 0
    banded.solve(band, diagonal, product)
    np.testing.assert_allclose(product, x, atol=1e-8)
