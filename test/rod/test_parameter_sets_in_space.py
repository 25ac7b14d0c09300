# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Many parameter sets at once in space, with twist, against the same sets one by one."""

from dataclasses import replace

import numpy as np
import pytest
from parameter_sets import (
    LENGTH,
    STAMPS,
    TOLERANCE,
    assert_as_alone,
    by_itself,
    varied,
    with_tolerance,
)
from rods import PAPER, command, straight
from scipy.spatial.transform import Rotation

from dlo_ros.rod import dynamics
from dlo_ros.rod.batch.layout import Layout
from dlo_ros.rod.batch.parameter_sets import follow_many
from dlo_ros.rod.boundary.conditions import BODY, DIRECTOR
from dlo_ros.rod.elements import rod_forces
from dlo_ros.rod.elements.constitutive_law import room
from dlo_ros.rod.lanes import simd_kernels, simd_solver, spatial_kernels, spatial_strains
from dlo_ros.rod.resolution import build
from dlo_ros.rod.simd.eight_lanes import LANES, rows
from dlo_ros.rod.statics import NO_INTERNAL_VARIABLES, hold, material_at_rest

TURNING = [0.0, 0.2, 0.5]
# Clamps that start with a jerk: either run is off by some 3e-4 at most, with other steps otherwise.
JERKY = 6e-4  # of L


def turning_clamp():
    """A clamp that leaves the plane and turns about all axes, by up to 2 rad about the DLO."""
    along, aside = np.array([0.0, 0.8, 2.0]), np.array([0.0, 0.3, -0.2])
    turned = Rotation.from_euler("ZYX", np.stack([aside, 0.5 * aside, along], axis=1)).as_quat()
    still = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    return command(
        ["start", "end"], TURNING,
        [[[0, 0, 0], [0.4, 0, 0]], [[0.02, 0.05, 0], [0.36, 0, 0]],
         [[0.04, 0.02, 0], [0.3, 0, 0]]],
        np.stack([turned, still], axis=1),
    )  # fmt: skip


def gripped(model, boundary, imposed):
    """The straight rod as its clamps have taken it at the start."""
    state = straight(model)
    return replace(state, frames=hold(model, boundary, state, imposed, 0).frames)


@pytest.mark.slow
@pytest.mark.parametrize("first", [True, False])
def test_equations_in_space_are_those_of_one_rod(first):
    """The linear solution of each lane against the rod's own matrix and gradient."""
    imposed = command(["start", "control_point_10"], [0.0], [[0, 0, 0], [0.39, 0, 0]])
    model, boundary = build(PAPER, imposed, 6)
    n, nb = model.basis.control_points, len(model.rule.weight)
    rng = np.random.default_rng(0)
    base, single = straight(model), []
    for _ in range(LANES):
        factor, rest = rng.uniform(0.5, 2.0, 3), rng.normal(size=(nb, 3))
        stiff = model.stiffness
        stiff = stiff._replace(
            stretch=factor[0] * stiff.stretch, bend=factor[1] * stiff.bend,
            bend_rest=rest[:, :2].copy(), twist=factor[2] * stiff.twist,
            twist_rest=model.discretisation.span_twists(rest[:, 2]),
        )  # fmt: skip
        one = replace(model)
        one.__dict__["stiffness"] = stiff
        bent = base.q + np.column_stack([1e-2 * rng.normal(size=(n, 3)), rng.normal(size=n)])
        single.append((one, bent))
    layout = Layout([one for one, _ in single], boundary, flat=False)
    tables, sets, room_ = layout.tables, layout.sets, layout.room
    law = simd_kernels.BatchLaw(*(x[0] for x in sets.law))
    motion = layout.unpacked(layout.motion([replace(base, q=bent) for _, bent in single]))
    q, frame = motion.q[0].copy(), simd_kernels.Frame(*(x[0].copy() for x in motion.frame))
    carried = simd_kernels.Frame(*(x.copy() for x in frame))
    stretch, other, tension = rows(nb), rows(3 * nb), rows(nb)
    spatial_strains.advance_frame(q, tables, carried, stretch, other)
    simd_kernels.tensions(stretch, law, tables, tension)
    inertia, spin, rhs = 1e3 * model.mass, 1e3 * model.spin, rng.normal(size=(n, 4))
    room_.matrix[:] = np.concatenate([inertia.ravel(), spin.ravel()])[:, None]
    room_.rhs[:] = rhs.ravel()[:, None]
    assembled = (q, tables, frame, law, room_.scratch, room_.matrix)
    spatial_kernels.assemble(*assembled, tension, True)
    if not first:  # what the last linear solution promised is where we are
        spatial_kernels.assemble(*assembled, np.nan * tension, False)
    simd_solver.residual(q, room_.matrix, room_.rhs, room_.scratch, tables)
    assert np.isfinite(simd_solver.solve(room_.scratch, tables))
    for k, (one, bent) in enumerate(single):
        gradient, band = np.empty(4 * n), np.empty((4 * n, 16))
        matter = material_at_rest(one, NO_INTERNAL_VARIABLES)._replace(stiffness=one.stiffness)
        grad_s, grad_o = np.empty((nb, 3)), np.zeros((nb, 3, 8))
        rod_forces.assemble(
            bent, one.rule, base.reference, matter, room(nb), np.empty(0), gradient, band, grad_s,
            grad_o,
        )  # fmt: skip
        rod_forces.add_scalar_band(band, inertia, spin, 1.0)
        product = np.empty((n, 4))
        rod_forces.multiply_scalar(inertia, spin, bent, product)
        full = np.zeros((4 * n, 4 * n))
        for i in range(4 * n):
            for j in range(max(0, i - 15), i + 1):
                full[i, j] = full[j, i] = band[i, 15 - i + j]
        free = np.flatnonzero(~boundary.fixed)
        missing = rhs.ravel() - product.ravel() - gradient
        expected = np.linalg.solve(full[np.ix_(free, free)], missing[free])
        found = room_.scratch.step[:, k]
        np.testing.assert_allclose(found[free], expected, atol=1e-8 * np.abs(expected).max())
        held = np.flatnonzero(boundary.fixed[4 * tables.lo : 4 * tables.hi]) + 4 * tables.lo
        assert not found[held].any()
        there, strains = rod_forces.transport(bent, one.rule, base.reference), other[:, k]
        alone = rod_forces.strains(bent, one.rule, base.reference)
        np.testing.assert_allclose(stretch[:, k], alone[0], atol=1e-12)
        np.testing.assert_allclose(strains.reshape(-1, 3), alone[1], atol=1e-9)
        for mine, own in zip(carried, there, strict=True):
            np.testing.assert_allclose(mine[:, k], np.ravel(own), atol=1e-9)


def test_sets_in_space_move_as_each_does_alone():
    imposed = turning_clamp()
    model, boundary = build(with_tolerance(PAPER), imposed, 8)
    models = list(varied(model, 5))
    models[1] = replace(models[1], rest=lambda u: np.outer(1.0 + 0.0 * u, [3.0, 2.0, 4.0]))
    models[2] = replace(models[2], point_forces=((0.2, (0.0, 0.03, 0.0)),))
    states = [gripped(m, boundary, imposed) for m in models]
    tracks = follow_many(models, boundary, states, imposed, STAMPS)
    assert_as_alone(tracks, models, boundary, states, imposed, STAMPS, JERKY)
    assert np.abs(tracks.shapes[:, -1, :, 1]).max() > 0.02
    assert np.abs(tracks.state(0).strains.other[:, 2]).max() > 1.0
    middle = follow_many(models, boundary, states, imposed, STAMPS[:2])
    onwards = [middle.state(k) for k in range(5)]
    second = follow_many(models, boundary, onwards, imposed, STAMPS[2:])
    np.testing.assert_allclose(second.shapes[:, 0], tracks.shapes[:, 2], atol=JERKY * LENGTH)


def test_one_rod_in_space_is_followed_in_lanes():
    imposed = turning_clamp()
    model, boundary = build(with_tolerance(PAPER), imposed, 8)
    state = gripped(model, boundary, imposed)
    found = dynamics.follow(model, boundary, state, imposed, STAMPS)
    alone = by_itself(model, boundary, state, imposed, STAMPS)
    np.testing.assert_allclose(
        found.shapes[..., :3], alone.shapes[..., :3], atol=TOLERANCE * LENGTH
    )
    np.testing.assert_allclose(found.twists, alone.twists, atol=2e-3)
    assert found.steps == alone.steps


def test_tips_held_out_of_the_plane_keep_their_angle():
    imposed = command(
        ["control_point_1", "control_point_10"], [0.0, 0.5],
        [[[0, 0, 0], [0.4, 0, 0]], [[0.02, 0.03, 0.01], [0.36, 0, 0]]],
    )  # fmt: skip
    model, boundary = build(with_tolerance(PAPER), imposed, 8)
    models = list(varied(model, 3))
    states = [straight(m) for m in models]
    states[1].q[:, 3] = 0.2
    tracks = follow_many(models, boundary, states, imposed, STAMPS)
    assert_as_alone(tracks, models, boundary, states, imposed, STAMPS, JERKY)
    np.testing.assert_array_equal(tracks.shapes[:, :, 0, 3], [[0.0] * 3, [0.2] * 3, [0.0] * 3])


def test_a_set_whose_clamp_has_turned_otherwise_goes_alone():
    imposed = turning_clamp()
    model, boundary = build(with_tolerance(PAPER), imposed, 8)
    models, state = list(varied(model, 3)), gripped(model, boundary, imposed)
    frames = state.frames.copy()
    turn = Rotation.from_rotvec([0.7, 0.0, 0.0])  # another reference director, the same clamp
    frames[:, DIRECTOR:BODY] = turn.apply(frames[:, DIRECTOR:BODY])
    # In its own coordinates the clamp holds the same material director, at another angle.
    reference = state.reference._replace(director=turn.apply(state.reference.director))
    q = state.q + np.array([0.0, 0.0, 0.0, -0.7])
    other = replace(state, q=q, frames=frames, reference=reference)
    states = [state, other, state]
    tracks = follow_many(models, boundary, states, imposed, STAMPS)
    assert list(tracks.ends.alone) == [1]
    assert_as_alone(tracks, models, boundary, states, imposed, STAMPS, JERKY)
