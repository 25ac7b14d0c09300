# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Equilibria against closed forms, boundary value problems and stability theory."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command, held_start, settled, straight
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from dlo_ros.command import Motion
from dlo_ros.errors import SimulationError
from dlo_ros.observation import Observation
from dlo_ros.parameters import RodParameters, Settings
from dlo_ros.rod.model_registry import simulation_of
from dlo_ros.rod.motion_rehearsal import at_rest, slack
from dlo_ros.rod.resolution import build, choose
from dlo_ros.rod.sensitivity_parameters import MATERIAL
from dlo_ros.rod.state import refined, twist_angle
from dlo_ros.rod.statics import settle
from dlo_ros.spline import SplineBasis
from dlo_ros.synthesis.discrete_rod import DiscreteRod
from dlo_ros.synthesis.rod_simulation import DiscreteRodSimulation, ImposedNodes

UNREACHABLE = pytest.raises(SimulationError, match="apart")


def elastica(settings):
    """Extensible cantilever under its own weight, clamped along x, as a boundary value problem.

    Unknowns: angle (from x towards -z), moment, x, z over the material coordinate. The energy per
    reference length is B/2 (curvature per deformed length)^2 + EA/2 (stretch)^2, as the rod's.
    """
    rod = settings.rod
    b, w, length = rod.bending_stiffness, rod.linear_density * 9.81, rod.length
    ea = rod.young_modulus * rod.area

    def slope(s, y, w):
        angle, moment = y[0], y[1]
        tension = w * (length - s) * np.sin(angle)
        stretch = (ea + tension) / (ea - moment**2 / b)
        return np.vstack(
            [moment / b * stretch**2, -w * (length - s) * np.cos(angle) * stretch,
             np.cos(angle) * stretch, -np.sin(angle) * stretch]
        )  # fmt: skip

    def ends(a, b):
        return np.array([a[0], b[1], a[2], a[3]])

    # From weak gravity to the full one: a soft rod has no other way to its solution.
    s, y = np.linspace(0.0, length, 200), np.zeros((4, 200))
    y[2] = s
    for share in np.geomspace(1e-3, 1.0, 8):
        found = solve_bvp(
            lambda s, y, w=share * w: slope(s, y, w), ends, s, y, tol=1e-8, max_nodes=50000
        )
        assert found.success
        s, y = found.x, found.y
    return found.sol


def distance_to(reference, model, state):
    u, weight = model.basis.quadrature(6)
    r = model.basis.evaluate(state.q, u)
    y = reference(u)
    return float(weight @ np.hypot(r[:, 0] - y[2], r[:, 2] - y[3])) / model.basis.length**2


@pytest.mark.parametrize(
    ("young_modulus", "spans", "limit"),
    [(5e7, 7, 8e-4), (5e7, 28, 2e-5), (1e6, 56, 5e-4), (1e10, 7, 1e-5)],
)
def test_cantilever_is_the_elastica(young_modulus, spans, limit):
    settings = PAPER.with_material(young_modulus, 2500.0)
    model, _, found = settled(settings, held_start(), spans)
    assert found.stable
    assert distance_to(elastica(settings), model, found.state) < limit


def test_refinement_converges():
    reference = elastica(PAPER)
    errors = []
    for spans in (7, 14, 28):
        model, _, found = settled(PAPER, held_start(), spans)
        errors.append(distance_to(reference, model, found.state))
    assert errors[0] > 5.0 * errors[1] > 15.0 * errors[2]


def test_small_deflection_under_own_weight():
    settings = PAPER.with_material(1e11, 2500.0)
    _, _, found = settled(settings, held_start(), 10)
    rod = settings.rod
    expected = rod.linear_density * 9.81 * rod.length**4 / (8.0 * rod.bending_stiffness)
    assert -found.state.q[-1, 2] == pytest.approx(expected, rel=1e-3)


def test_without_bending_stiffness_it_is_a_catenary():
    settings = replace(
        PAPER, rod=RodParameters(1.0, 0.002, 2e7, 2000.0)
    )  # B/w so small that L/l is 100
    imposed = command(
        ["control_point_1", "control_point_10"],
        [0.0, 1.0],
        [[0, 0, 0], [0.98, 0, -0.05], [0, 0, 0], [0.6, 0, 0.0]],
    )
    model, boundary = build(settings, imposed, 56)
    state = settle(model, boundary, straight(model), imposed, 0).state
    found = settle(model, boundary, state, imposed, SECOND)
    u = np.linspace(0.0, 1.0, 21)
    r = model.basis.evaluate(found.state.q, u)
    # 2 a sinh(d / 2a) = L
    a = brentq(lambda a: 2 * a * np.sinh(0.3 / a) - 1.0, 0.05, 10.0)
    x = 0.3 + a * np.arcsinh((u - 0.5) / a)
    z = a * np.cosh((x - 0.3) / a) - a * np.cosh(0.3 / a)
    assert np.hypot(r[:, 0] - x, r[:, 2] - z).max() < 4e-3


def test_upright_column_buckles_under_its_own_weight():
    rod = PAPER.rod
    critical = (7.8373 * rod.bending_stiffness / (rod.linear_density * 9.81)) ** (1.0 / 3.0)
    upright = command(
        ["start"], [0.0], [[0.0, 0.0, 0.0]], [[0.0, -np.sqrt(0.5), 0.0, np.sqrt(0.5)]]
    )
    for share, stable in ((0.98, True), (1.02, False)):
        settings = replace(PAPER, rod=replace(rod, length=share * critical))
        _, _, found = settled(settings, upright, 14, direction=(0.0, 0.0, 1.0))
        assert found.buckled is not stable
        assert found.buckled or np.abs(found.state.q[:, 0]).max() < 1e-9


def test_twist_between_clamps_is_uniform_and_counts_full_turns():
    weightless = replace(PAPER, gravity=(0.0, 0.0, 0.0))
    turns = np.linspace(0.0, 1.5 * 2.0 * np.pi, 13)
    quarter = [[[0.0, 0.0, 0.0, 1.0], [np.sin(a / 2), 0.0, 0.0, np.cos(a / 2)]] for a in turns]
    # Pulled straight, so that the twist does not buckle it.
    imposed = command(["start", "end"], np.arange(13.0), [[[0, 0, 0], [0.404, 0, 0]]] * 13, quarter)
    model, boundary = build(weightless, imposed, 14)
    state = straight(model)
    for k in range(13):
        state = settle(model, boundary, state, imposed, k * SECOND).state
    np.testing.assert_allclose(
        twist_angle(state, model)[[0, -1]], [0.0, 1.5 * 2.0 * np.pi], atol=1e-6
    )
    np.testing.assert_allclose(state.strains.other[:, 2], 1.5 * 2.0 * np.pi / 0.4, rtol=1e-6)


def test_twisted_rod_buckles_where_stability_theory_says():
    """A rod clamped at both ends with free end distance buckles at C twist / B = 8.9868 / L.

    Here the ends are held at the distance L, where the tension that arises after buckling does
    not matter for the onset.
    """
    weightless = replace(PAPER, gravity=(0.0, 0.0, 0.0))
    rod = weightless.rod
    ratio = rod.bending_stiffness / (rod.shear_modulus * 2.0 * rod.second_moment)
    critical = 8.9868 * ratio
    for share, stable in ((0.97, True), (1.03, False)):
        steps = np.linspace(0.0, share * critical, 9)
        turned = [[[0.0, 0.0, 0.0, 1.0], [np.sin(a / 2), 0.0, 0.0, np.cos(a / 2)]] for a in steps]
        imposed = command(["start", "end"], np.arange(9.0), [[[0, 0, 0], [0.4, 0, 0]]] * 9, turned)
        model, boundary = build(weightless, imposed, 28)
        state = straight(model)
        for k in range(9):
            found = settle(model, boundary, state, imposed, k * SECOND)
            state = found.state
        assert found.buckled is not stable


@pytest.mark.parametrize("across", [0.0, 0.05], ids=["in the plane", "in space"])
@pytest.mark.parametrize(("x", "ends"), [(0.25, nullcontext()), (0.6, UNREACHABLE)])
def test_the_state_it_began_from_stays_what_it_was(x, ends, across):
    near, far = ([[0.0, 0.0, 0.0], [end, across, -0.15]] for end in (0.3, x))
    names = ["start", "control_point_10"]
    model, boundary, found = settled(PAPER, command(names, [0.0], near), 14)
    arrays = [found.state.q, found.state.frames, *found.state.reference, found.state.strains.other]
    kept = [array.copy() for array in arrays]
    with ends:
        settle(model, boundary, found.state, command(names, [0.0], far), 0, parameters=MATERIAL)
    for now, before in zip(arrays, kept, strict=True):
        np.testing.assert_array_equal(now, before)


def derivatives(model, boundary, found, imposed):
    """By ln E and ln mu, shape (2, n, 4)."""
    return settle(
        model, boundary, found.state, imposed, 0, parameters=MATERIAL[:2]
    ).state.sensitivity.q


@pytest.mark.parametrize(
    "end", [[0.3, 0.0, -0.15], [0.3, 0.05, -0.15]], ids=["in the plane", "in space"]
)
def test_sensitivities_agree_with_differences(end):
    imposed = command(["start", "control_point_10"], [0.0], [[0.0, 0.0, 0.0], end])
    model, boundary, found = settled(PAPER, imposed, 14)
    derivative = derivatives(model, boundary, found, imposed)
    step = 1e-4
    for k, (e, mu) in enumerate(((1.0, 0.0), (0.0, 1.0))):
        shapes = []
        for sign in (1.0, -1.0):
            changed = PAPER.with_material(
                5e7 * np.exp(sign * step * e), 2500.0 * np.exp(sign * step * mu)
            )
            other = model.with_settings(changed)
            shapes.append(settle(other, boundary, found.state, imposed, 0).state.q)
        expected = (shapes[0] - shapes[1]) / (2.0 * step)
        np.testing.assert_allclose(
            derivative[k, :, :3], expected[:, :3], atol=1e-6 * np.abs(expected).max()
        )


def test_only_the_ratio_of_stiffness_and_density_shapes_a_settled_rod():
    model, boundary, found = settled(PAPER, held_start(), 14)
    derivative = derivatives(model, boundary, found, held_start())
    np.testing.assert_allclose(derivative[0], -derivative[1], atol=1e-9)


@pytest.mark.parametrize(
    "law",
    [
        {"nonlinear_stiffness": {"half_curvature": 4.0}},
        {"plasticity": {"yield_curvature": 4.0, "hardening": 0.2}},
    ],
    ids=["softening", "yield"],
)
def test_at_rest_a_rod_that_creeps_is_a_softer_one(law):
    """Moments are proportional to the stiffness that has not relaxed, whatever their law."""
    share = 0.7
    weaker = replace(PAPER.rod, young_modulus=(1.0 - share) * PAPER.rod.young_modulus)
    creeps = {"viscoelasticity": {"share": share, "time": 0.1}}
    _, _, softer = settled(replace(PAPER.with_effects(law), rod=weaker), held_start(), 14)
    _, _, found = settled(PAPER.with_effects({**law, **creeps}), held_start(), 14)
    # The stretch of the weaker rod is larger: 2.5e-4 of the length, without any law as well.
    assert np.abs(found.state.q[:, :3] - softer.state.q[:, :3]).max() < 3e-4 * PAPER.rod.length


def test_held_points_are_held_exactly():
    imposed = command(
        ["start", "control_point_6", "control_point_10"],
        [0.0],
        [[0.0, 0.0, 0.0], [0.2, 0.0, -0.05], [0.33, 0.0, 0.0]],
    )
    model, boundary, found = settled(PAPER, imposed, 14)
    q = found.state.q
    np.testing.assert_allclose(q[0, :3], [0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(q[-1, :3], [0.33, 0.0, 0.0], atol=1e-12)
    tangent = model.basis.evaluate(q, 0.0, 1)[0, :3]
    np.testing.assert_allclose(tangent, [1.0, 0.0, 0.0], atol=1e-12)
    pin = model.basis.evaluate(q, boundary.pin_abscissae)[0, :3]
    np.testing.assert_allclose(pin, [0.2, 0.0, -0.05], atol=1e-10)


def test_a_dlo_that_hangs_from_pins_alone_is_where_a_discrete_rod_is():
    settings = PAPER.with_material(1e7, 2500.0)
    length, edges = settings.rod.length, 280
    places = {edges // 7: np.zeros(2), 6 * edges // 7: np.array([0.15, 0.03])}  # Greville abscissae
    rod = DiscreteRod.uniform(settings.rod, settings.damping, edges=edges)
    boundary = ImposedNodes(places)
    bow = np.column_stack([rod.u - length / 7, -0.5 * np.sin(np.pi * rod.u / length)])
    nodes = DiscreteRodSimulation(rod, lambda _: boundary, bow).settle()
    imposed = command(["control_point_3", "control_point_8"], [0.0], [[0, 0, 0], [0.15, 0, 0.03]])
    shape = at_rest(settings, imposed, None).prediction().control_points
    found = SplineBasis(10, length).evaluate(shape, rod.u)[:, [0, 2]]
    assert np.linalg.norm(found - nodes, axis=1).max() < 2e-3 * length  # of ten control points


@pytest.mark.parametrize("off_plane", [0.0, 0.05])
def test_a_dlo_that_hangs_from_one_pin_has_its_weight_below_it(off_plane):
    imposed = command(["control_point_4"], [0.0], [[0.1, off_plane, 0.2]])
    shape = slack(PAPER, imposed)
    shape[:, 1] += off_plane * np.linspace(-1.0, 1.0, 10)

    def started(modulus):
        settings = PAPER.with_material(modulus, 2500.0)
        result = simulation_of(settings, Motion([imposed]), parameters=("young_modulus",), spans=14)
        result.start([Observation(0, shape)])
        return result

    simulation, modulus, step = started(5e7), 5e7, 0.01
    basis, q = simulation.basis, simulation.state.q
    u, weight = basis.quadrature(6)
    middle = weight @ basis.evaluate(q, u)[:, :3] / PAPER.rod.length
    assert middle[:2] == pytest.approx([0.1, off_plane], abs=1e-6)
    pin = basis.evaluate(q, np.array([2.0 / 7.0 * PAPER.rod.length]))[0, :3]
    assert pin == pytest.approx([0.1, off_plane, 0.2], abs=1e-9)
    above, below = (
        started(modulus * np.exp(by)).prediction().control_points for by in (step, -step)
    )
    apart = (above - below)[:, :3] / (2.0 * step)
    assert simulation.prediction().sensitivity[0] == pytest.approx(apart, abs=1e-2 * apart.max())


def test_ends_out_of_reach_are_refused():
    imposed = command(["start", "end"], [0.0], [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]])
    with pytest.raises(SimulationError, match=r"0\.6 m apart.*0\.4 m long"):
        settled(PAPER, imposed, 7)


def test_resolution_is_as_fine_as_the_tolerance_asks():
    shape = np.zeros((10, 4))
    shape[:, 0] = np.linspace(0.0, 0.4, 10)
    soft = PAPER.with_material(1e6, 2000.0)
    spans = []
    for tolerance in (1e-2, 2e-4):
        asked = replace(soft, simulation=replace(soft.simulation, tolerance=tolerance))
        found = choose(asked, held_start(), shape, [0])
        assert found.error <= tolerance
        spans.append(found.spans)
    assert spans[0] < spans[1]
    model, _, equilibrium = settled(soft, held_start(), spans[1])
    assert distance_to(elastica(soft), model, equilibrium.state) < 3e-4


def test_long_soft_and_short_stiff_rods_settle_with_the_same_settings():
    for length, young_modulus in ((1.0, 2e5), (0.1, 1e9)):
        settings = Settings(rod=RodParameters(length, 0.004, young_modulus, 2000.0))
        _, _, found = settled(settings, held_start(), 28)
        assert found.stable
        assert np.all(np.isfinite(found.state.q))


LENGTH = PAPER.rod.length


def random_motion(rng, kind):
    """A straight rod whose ends are led at random; settings, command and its first direction."""
    ratio = np.exp(rng.uniform(np.log(0.5), np.log(15.0)))  # L/l
    stiffness = PAPER.rod.linear_density * 9.81 * (LENGTH / ratio) ** 3
    settings = PAPER.with_material(stiffness / PAPER.rod.second_moment, 2500.0)
    base = Rotation.from_rotvec([0.0, rng.uniform(-np.pi, np.pi), 0.0])
    turn = [0.0, rng.uniform(-2.0, 2.0), 0.0]
    if "space" in kind:
        base, turn = Rotation.from_rotvec(rng.normal(0.0, 2.0, 3)), rng.normal(0.0, 0.8, 3)
    if "weightless" in kind:  # nothing decides to which side it goes
        settings, turn = replace(settings, gravity=(0.0, 0.0, 0.0)), [0.0, 0.0, 0.0]
    if "twisted" in kind:
        turn = [rng.uniform(1.0, 5.0) * np.pi, 0.0, 0.0]
    times = np.linspace(0.0, 1.0, 13 if "twisted" in kind else int(rng.integers(5, 14)))
    shares = 1.0 - (1.0 - rng.uniform(0.7 if "twisted" in kind else 0.2, 0.98)) * times
    axis = base.apply([1.0, 0.0, 0.0])
    names = ["control_point_1", "control_point_10"] if "pinned" in kind else ["start", "end"]
    ends = [[np.zeros(3), share * LENGTH * axis] for share in shares]
    turns = [base * Rotation.from_rotvec(t * np.asarray(turn)) for t in times]
    frames = [[base.as_quat(), r.as_quat()] for r in turns]
    return settings, command(names, times, ends, frames), axis


@pytest.mark.parametrize(
    "kind",
    ["pushed", "pushed in space", "pinned", "weightless", "weightless in space",
     "weightless pinned", "weightless twisted"],
)  # fmt: skip
def test_equilibria_are_found_whatever_is_done_to_a_straight_rod(kind):
    """The branch is followed through every loss of stability, and what is left is stable.

    A bow in the plane may tip over sideways: that is reported, since the plane is kept.
    """
    rng = np.random.default_rng(sum(kind.encode()))
    for _ in range(12):
        settings, imposed, axis = random_motion(rng, kind)
        model, boundary = build(settings, imposed, 28)
        state, buckled = straight(model, axis), False
        for k, time in enumerate(imposed.times):
            stamp = round(time * SECOND)
            found = settle(model, boundary, state, imposed, stamp, fresh=k == 0)
            state, buckled = found.state, buckled or found.buckled
            planar = np.abs(state.q[:, [1, 3]]).max() < 1e-9
            assert found.stable or planar
        assert buckled or "weightless" not in kind


def test_a_fold_in_a_simulated_shape_is_no_fault_of_the_input():
    model, _, found = settled(PAPER, held_start(), 7)
    finer, _ = build(PAPER, held_start(), 14)
    folded = found.state.q.copy()
    folded[4:7, :3] = folded[4, :3]
    with pytest.raises(SimulationError, match=r"folded: .* coincide at u = "):
        refined(replace(found.state, q=folded), model, finer)
