# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Every effect at rest, by itself, against an answer that does not come from this package's rod."""

from dataclasses import replace

import numpy as np
import pytest
from cantilevers import LINE, ROD, SPANS, STRETCH, B, U, apart, cantilever, elastica, own_weight
from elastica import Cantilever, hinged
from rods import PAPER, SECOND, command, dense_stiffness, held_start, settled, straight
from scipy.integrate import solve_bvp
from scipy.linalg import eigh

from dlo_ros.rod.resolution import build as build_rod
from dlo_ros.rod.state import rest_state
from dlo_ros.rod.statics import settle
from dlo_ros.spline import SplineBasis

WEIGHTLESS = replace(PAPER, gravity=(0.0, 0.0, 0.0))


def linear(_, moment):
    return moment / B


def test_without_effects_it_is_the_elastica():
    assert apart(cantilever(PAPER)[0], elastica(linear, own_weight)) < 2e-4


def test_curvature_at_rest_bends_a_weightless_rod_into_an_arc():
    kappa = 4.0
    shape, _ = cantilever(WEIGHTLESS, intrinsic_curvature={"curvature": kappa})
    arc = np.column_stack([np.sin(kappa * U), np.cos(kappa * U) - 1.0]) / kappa
    np.testing.assert_allclose(shape(U), arc, atol=2e-4 * ROD.length)


def test_values_of_curvature_are_joined_by_lines():
    values = (0.0, 6.0, -3.0)
    shape, _ = cantilever(WEIGHTLESS, intrinsic_curvature={"curvature": values})
    fine = np.linspace(0.0, ROD.length, 4001)
    kappa = np.interp(fine, np.linspace(0.0, ROD.length, 3), values)
    phi = np.concatenate([[0.0], np.cumsum(0.5 * (kappa[1:] + kappa[:-1]) * np.diff(fine))])

    def along(f):
        return np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1]) * np.diff(fine))])

    expected = np.column_stack([np.interp(U, fine, along(np.cos(phi))),
                                np.interp(U, fine, along(-np.sin(phi)))])  # fmt: skip
    np.testing.assert_allclose(shape(U), expected, atol=3e-4 * ROD.length)


def test_a_kink_turns_the_tangent_by_its_angle():
    shape, _ = cantilever(WEIGHTLESS, intrinsic_curvature={"kink": 0.6, "position": 0.2})
    end, before = shape(np.array([0.4]))[0], shape(np.array([0.3]))[0]
    turned = np.arctan2(-(end - before)[1], (end - before)[0])
    assert turned == pytest.approx(0.6, abs=1e-2)
    expected = np.array([0.2 + 0.2 * np.cos(0.6), -0.2 * np.sin(0.6)])
    np.testing.assert_allclose(end, expected, atol=2e-3)


def test_a_turned_clamp_is_a_turned_start():
    shape, _ = cantilever(PAPER, clamp_angle={"start": 0.2})
    assert apart(shape, elastica(linear, own_weight, start=0.2)) < 2e-4


@pytest.mark.parametrize("spans", [7, 14, 28, 56])
def test_a_grip_that_gives_way_is_a_torsional_spring(spans):
    compliance = 8.0
    shape, _ = cantilever(PAPER, spans, clamp_compliance={"start": compliance})
    stiff = Cantilever(ROD.length, lambda u: np.full_like(u, B), STRETCH, own_weight)
    spring = hinged(stiff, compliance, 9.81 * LINE)
    assert spring.direction == pytest.approx(0.09, abs=0.02)  # rad
    assert apart(shape, spring.solve) < 2e-4
    assert apart(shape, stiff.solve) > 0.015
    mirrored = command(
        ["end"], [0.0], [[[ROD.length, 0.0, 0.0]]], np.array([[[0.0, 0.0, 0.0, 1.0]]])
    )
    settings = PAPER.with_effects({"clamp_compliance": {"end": compliance}})
    model, _, found = settled(settings, mirrored, spans)
    there = model.basis.evaluate(found.state.q, ROD.length - U)[:, [0, 2]]
    np.testing.assert_allclose(
        there, [ROD.length, 0.0] + shape(U) * [-1.0, 1.0], atol=1e-6 * ROD.length
    )


def test_a_rigid_grip_is_the_limit_of_none_that_gives_way():
    shape, _ = cantilever(PAPER, clamp_compliance={"start": 1e-6})
    assert apart(shape, cantilever(PAPER)[0]) < 1e-4  # whose spline is not as fine at the clamp


def test_a_plug_is_a_weight_on_a_rigid_lever():
    mass, extent = 0.02, 0.08
    begin = ROD.length - extent

    def law(u, moment):
        return moment / (B * np.where(u > begin, 1e3, 1.0))

    def load(u):
        fx, fz = own_weight(u)
        return fx, fz - mass * 9.81 * np.clip((ROD.length - u) / extent, 0.0, 1.0)

    stiff = replace(PAPER, rod=replace(ROD, young_modulus=2e8))
    shape, _ = cantilever(stiff, spans=56, connector={"mass": mass, "extent": extent})
    answer = elastica(lambda u, moment: law(u, 0.25 * moment), load, breaks=[begin])
    assert apart(shape, answer) < 5e-4
    plug = shape(np.array([begin + 0.02, begin + 0.05, ROD.length]))
    directions = np.diff(plug, axis=0)
    assert np.ptp(np.arctan2(directions[:, 1], directions[:, 0])) < 2e-3  # it is straight


def hung_by_both_ends(apart, mass, extent):
    """A rod with a plug, its ends on hinges at one height, as a boundary value problem."""
    begin, edge = ROD.length - extent, 3e-4

    def rate(s, y, held):
        a, moment = y[0], y[1]
        rigid = 0.5 * (1.0 + np.tanh((s - begin) / edge))
        weight = 9.81 * (LINE * (ROD.length - s) + mass * np.clip((ROD.length - s) / extent, 0, 1))
        nx, nz = np.full_like(s, held[0]), held[1] - weight
        grown = 1.0 + (nx * np.cos(a) - nz * np.sin(a)) / STRETCH
        return np.vstack(
            [moment / (B * 1e3**rigid),
             grown * (nx * np.sin(a) + nz * np.cos(a)),
             grown * np.cos(a), -grown * np.sin(a)]
        )  # fmt: skip

    def ends(p, q, _):
        return np.array([p[1], p[2], p[3], q[1], q[2] - apart, q[3]])

    s = np.unique(np.r_[np.linspace(0.0, ROD.length, 201), begin + edge * np.linspace(-4, 4, 81)])
    angle = np.interp(s, [0.0, ROD.length], [0.8, -0.8])
    x = np.interp(s, [0.0, ROD.length], [0.0, apart])
    z = -0.1 * np.sin(np.pi * s / ROD.length)
    weight = 9.81 * (LINE * ROD.length + mass)
    guess = np.vstack([angle, 0.0 * s, x, z])
    found = solve_bvp(rate, ends, s, guess, p=[0.2 * weight, 0.5 * weight], tol=1e-5)
    assert found.success
    return lambda u: found.sol(u)[[2, 3]].T


@pytest.mark.parametrize("spans", [14, 20, 28, 56, 112])
def test_a_plug_between_two_hinges_lies_straight_whatever_bend_was_seen_in_it(spans):
    """A start that bends the plug must not end with the plug folded up between two knots."""
    mass, extent, apart_now = 0.01, 0.06, 0.32
    settings = PAPER.with_effects({"connector": {"mass": mass, "extent": extent}})
    ends = command(
        ["control_point_1", "control_point_10"], [0.0], [[0.0, 0.0, 0.0], [apart_now, 0.0, 0.0]]
    )
    model, boundary = build_rod(settings, ends, spans)
    truth = hung_by_both_ends(apart_now, mass, extent)
    published = SplineBasis(10, ROD.length)
    seen = np.zeros((10, 4))
    seen[:, [0, 2]] = truth(published.greville) + np.array([0.001, 0.002])
    seen[-2, [0, 2]] += [0.004, -0.004]
    start = rest_state(0, model.basis.projection(published) @ seen, model)
    found = settle(model, boundary, start, ends, 0, fresh=True)
    assert found.stable
    shape = model.basis.evaluate(found.state.q, U)[:, [0, 2]]
    assert np.abs(shape - truth(U)).max() < 2e-3 * ROD.length


def test_a_plug_swings_as_a_rigid_body_on_a_light_beam():
    """Lowest bending frequency of a weightless beam that carries a rigid bar."""
    mass, extent = 0.5, 0.1
    light = replace(WEIGHTLESS, rod=replace(ROD, young_modulus=5e9, density=1.0))
    settings = light.with_effects({"connector": {"mass": mass, "extent": extent}})
    model, boundary, found = settled(settings, held_start(), SPANS)
    n = model.basis.control_points
    free = [4 * i + 2 for i in range(n) if not boundary.fixed[4 * i + 2]]
    full = np.zeros((n, n))
    for i in range(n):
        for j in range(max(0, i - 3), i + 1):
            full[i, j] = full[j, i] = model.mass[i, 3 - i + j]
    inner = [k // 4 for k in free]
    stiffness = dense_stiffness(model, found.state)[np.ix_(free, free)]
    slowest = np.linalg.eigvals(np.linalg.solve(stiffness, full[np.ix_(inner, inner)])).real
    lowest = 1.0 / np.sort(slowest)[:-3:-1]
    bend, arm, lever = light.rod.bending_stiffness, ROD.length - extent, 0.5 * extent
    give = np.array([[arm**3 / 3.0, arm**2 / 2.0], [arm**2 / 2.0, arm]]) / bend
    inertia = mass * np.array([[1.0, lever], [lever, lever**2 + extent**2 / 12.0]])
    expected = eigh(np.linalg.inv(give), inertia, eigvals_only=True)
    np.testing.assert_allclose(lowest, expected, rtol=0.03)
    assert lowest[0] == pytest.approx(expected[0], rel=0.01)


def test_tilted_gravity_is_a_turned_load():
    angle = 0.3

    def load(u):
        weight = LINE * 9.81 * (ROD.length - u)
        # Gravity (0, -g), turned from x towards -z, points towards -x.
        return -weight * np.sin(angle), -weight * np.cos(angle)

    assert apart(cantilever(PAPER, gravity_tilt={"angle": angle})[0], elastica(linear, load)) < 3e-4


def test_a_hung_mass_is_a_point_load():
    mass, place = 0.02, 0.25

    def load(u):
        fx, fz = own_weight(u)
        return fx, fz - np.where(u < place, mass * 9.81, 0.0)

    shape, _ = cantilever(PAPER, point_mass={"mass": mass, "position": place})
    assert apart(shape, elastica(linear, load, breaks=[place])) < 5e-4


def test_a_stiff_segment_bends_less():
    def law(u, moment):
        stiff = np.where(np.abs(u - 0.15) < 0.05, 4.0, 1.0)
        return moment / (B * stiff)

    shape, _ = cantilever(PAPER, stiff_segment={"centre": 0.15, "extent": 0.1, "ratio": 4.0})
    assert apart(shape, elastica(law, own_weight, breaks=[0.1, 0.2])) < 1e-3


def test_stiffness_changes_along_the_rod():
    def law(u, moment):
        return moment / (B * (1.0 + 1.2 * (u / ROD.length - 0.5)))

    shape, _ = cantilever(PAPER, stiffness_gradient={"change": 1.2})
    assert apart(shape, elastica(law, own_weight)) < 5e-4


def test_a_softening_rod_follows_its_moment_law():
    half = 4.0

    def law(_, moment):
        return half * np.tan(moment / (B * half))

    soft = replace(PAPER, rod=replace(ROD, young_modulus=2e8))
    stiff = 4.0 * B

    def scaled(u, moment):
        return half * np.tan(np.clip(moment / (stiff * half), -1.5, 1.5))

    shape, _ = cantilever(soft, nonlinear_stiffness={"half_curvature": half})
    assert apart(shape, elastica(scaled, own_weight)) < 8e-4


def test_a_constant_force_is_a_uniform_load():
    def load(u):
        fx, fz = own_weight(u)
        return fx + 0.1 * (ROD.length - u), fz + 0.2 * (ROD.length - u)

    shape, _ = cantilever(PAPER, constant_force={"x": 0.1, "z": 0.2})
    assert apart(shape, elastica(linear, load)) < 3e-4


def test_a_longer_rod_is_the_elastica_of_its_true_length():
    more = 0.03
    length = ROD.length + more

    def load(u):
        return np.zeros_like(u), -LINE * 9.81 * (length - u)

    shape, _ = cantilever(PAPER, length_error={"difference": more})
    true = elastica(linear, load, length=length)
    assert np.abs(shape(U) - true(U * length / ROD.length)).max() < 2e-4 * length


def test_plastic_bending_leaves_the_curvature_past_the_yield():
    """Two clamps bend a weightless rod into an arc, and back: pure bending, one moment."""
    yields, hardening = 3.0, 0.25
    kappas = np.concatenate([np.arange(0.0, 8.0, 0.25), np.arange(8.0, -0.1, -0.25)])
    arcs = np.zeros((len(kappas), 2, 3))
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (len(kappas), 2, 1))
    for k, kappa in enumerate(kappas):
        angle = kappa * ROD.length
        arcs[k, 1] = (
            [np.sin(angle) / kappa, 0.0, (np.cos(angle) - 1.0) / kappa]
            if kappa else [ROD.length, 0.0, 0.0]
        )  # fmt: skip
        rotations[k, 1] = [0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)]
    imposed = command(["start", "end"], np.arange(float(len(kappas))), arcs, rotations)
    settings = WEIGHTLESS.with_effects(
        {"plasticity": {"yield_curvature": yields, "hardening": hardening}}
    )
    model, boundary = build_rod(settings, imposed, 14)
    state = straight(model)
    moments = []
    for k in range(len(kappas)):
        state = settle(model, boundary, state, imposed, k * SECOND).state
        elastic = state.strains.other[:, 0] - (1.0 - hardening) * state.internal.yield_centre[:, 0]
        moments.append(B * np.mean(elastic))
    # One-dimensional kinematic hardening, step by step.
    plastic, expected, back = 0.0, [], hardening / (1.0 - hardening)
    for kappa in kappas:
        trial = kappa - plastic - back * plastic
        if abs(trial) > yields:
            plastic += np.sign(trial) * (abs(trial) - yields) / (1.0 + back)
        expected.append(B * (kappa - plastic))
    np.testing.assert_allclose(moments, expected, atol=2e-3 * B * yields)
    found = (1.0 - hardening) * state.internal.yield_centre[:, 0].mean()
    assert found == pytest.approx(plastic, rel=5e-3)
    assert plastic > 1.0


def test_friction_holds_a_hanging_rod_up_to_its_sticking_angle():
    """A rod lies along gravity, then gravity turns: friction holds while it exceeds the pull."""
    weight = LINE * 9.81
    angle = 0.3
    stiff = replace(ROD, young_modulus=1e4)  # bending holds nothing
    hanging = command(
        ["start"], [0.0], [[[0.0, 0.0, 0.0]]],
        np.array([[[0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4)]]]),
    )  # fmt: skip

    def displaced(force):
        settings = replace(PAPER, rod=stiff).with_effects({"surface_friction": {"force": force}})
        model, boundary = build_rod(settings, hanging, 28)
        state = straight(model, (0.0, 0.0, -1.0))
        state = settle(model, boundary, state, hanging, 0, fresh=True).state
        before = state.q.copy()
        turned = (weight / LINE * np.sin(angle), 0.0, -weight / LINE * np.cos(angle))
        tilted = model.with_settings(replace(settings, gravity=turned))
        after = settle(tilted, boundary, state, hanging, 0).state.q
        return np.abs(after - before)[:, :3].max()

    sideways = weight * np.sin(angle)
    assert displaced(1.1 * sideways) < 1e-3 * ROD.length
    assert displaced(0.5 * sideways) > 0.02 * ROD.length


def test_a_peg_carries_the_difference_of_the_moments():
    """The peg's force, from equilibrium of forces at the clamp, and the gap from geometry."""
    peg = {"x": 0.2, "z": -0.06, "radius": 0.01}
    shape, state = cantilever(PAPER, spans=56, obstacle=peg)
    free, _ = cantilever(PAPER, spans=56)
    assert np.abs(shape(U) - free(U)).max() > 0.01
    fine = shape(np.linspace(0.0, ROD.length, 4001))
    reach = peg["radius"] + 0.5 * ROD.diameter
    gap = np.linalg.norm(fine - [peg["x"], peg["z"]], axis=1) - reach
    assert abs(gap.min()) < 2e-5
    # The moment at the clamp, from the curvature there, balances weight and contact.
    curvature = state.strains.other[0, 0]
    arm = np.trapezoid(shape(U)[:, 0], U) * LINE * 9.81
    at = fine[np.argmin(gap)]
    normal = (at - [peg["x"], peg["z"]]) / np.linalg.norm(at - [peg["x"], peg["z"]])
    moment = B * curvature
    # Moments about the clamp (about +y): z F_x - x F_z for a force at (x, z).
    lever = at[1] * normal[0] - at[0] * normal[1]
    force = (moment - arm) / lever
    assert force > 0.0
    # The same force lifts the rod in a boundary value problem.
    place = np.linspace(0.0, ROD.length, 4001)[np.argmin(gap)]

    def load(u):
        fx, fz = own_weight(u)
        beyond = np.where(u < place, force, 0.0)
        return fx + beyond * normal[0], fz + beyond * normal[1]

    assert apart(shape, elastica(linear, load, breaks=[place])) < 4e-3


def test_effects_combine_in_any_order():
    one = {"point_mass": {"mass": 0.01, "position": 0.3}, "gravity_tilt": {"angle": 0.2},
           "stiffness_gradient": {"change": 0.5}}  # fmt: skip
    other = dict(reversed(one.items()))
    np.testing.assert_allclose(
        cantilever(PAPER, **one)[0](U), cantilever(PAPER, **other)[0](U), atol=1e-10
    )
