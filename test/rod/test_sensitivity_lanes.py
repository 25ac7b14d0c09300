# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sensitivities in vector lanes, and spans in them, against the same one by one."""

from dataclasses import replace

import numpy as np
import pytest
from ordinary import some_of
from rods import PAPER, SECOND, command, straight
from scipy.spatial.transform import Rotation

from dlo_ros.errors import SimulationError
from dlo_ros.rod import dynamics, integration
from dlo_ros.rod.batch import single_rod
from dlo_ros.rod.batch.layout import Layout
from dlo_ros.rod.lanes import simd_kernels, spatial_kernels
from dlo_ros.rod.packing import insensitive
from dlo_ros.rod.resolution import build
from dlo_ros.rod.simd.eight_lanes import rows
from dlo_ros.rod.solve.generalised_alpha import NO_CONVERGENCE
from dlo_ros.rod.statics import hold

NAMES = (
    "young_modulus", "density", "air_drag", "relaxation_time", "gravity", "length", "start.x",
    "start.z", "start.angle", "end.x", "end.angle",
    "effects.intrinsic_curvature.curvature[0]", "effects.point_mass.mass",
)  # fmt: skip
EFFECTS = {
    "intrinsic_curvature": {"curvature": (0.5, 0.0, -1.0)},
    "point_mass": {"mass": 0.01, "position": 0.21},
}
STAMPS = [SECOND // 20, SECOND // 5, 2 * SECOND // 5, SECOND]


def moved(*, space, free=False):
    """The rod between two clamps that turn and approach, or with a free end; and its state."""
    names = ["start"] if free else ["start", "end"]
    turns = np.array([[0.0, 0.0, 0.0], [-0.4, 0.0, 0.0], [0.2, 0.0, 0.0]])
    if space:
        turns[1:, 1:] = [[0.3, 0.8], [-0.2, 2.0]]
    aside = 0.05 if space else 0.0
    places = np.array([[[0, 0, 0], [0.4, 0, 0]], [[0.02, aside, 0], [0.36, 0, 0.02]],
                       [[0.04, 0, 0.01], [0.3, -aside, 0]]])  # fmt: skip
    # Yaw out of the plane, pitch within, roll about the DLO.
    turned = Rotation.from_euler("YZX", turns).as_quat()[:, None].repeat(2, axis=1)
    turned[:, 1] = [0.0, 0.0, 0.0, 1.0]
    count = len(names)
    imposed = command(names, [0.0, 0.2, 0.5], places[:, :count], turned[:, :count])
    model, boundary = build(PAPER.with_effects(EFFECTS), imposed, 9)
    state = straight(model)
    state = replace(state, frames=hold(model, boundary, state, imposed, 0).frames)
    return model, boundary, insensitive(state, len(NAMES)), imposed


@pytest.fixture
def exact(monkeypatch):
    """Newton's method leaves next to nothing."""
    monkeypatch.setattr(integration, "NEWTON_SHARE", 1e-9)


@pytest.mark.parametrize("free", some_of([False, True], [False]), ids=["clamped", "free end"])
@pytest.mark.parametrize("space", [False, True], ids=["plane", "space"])
def test_sensitivities_are_those_of_the_scalar_engine(exact, space, free):
    names = tuple(n for n in NAMES if not (free and n.startswith("end")))
    model, boundary, state, imposed = moved(space=space, free=free)
    state = insensitive(state, len(names))
    asked = (model, boundary, state, imposed, STAMPS, names)
    lanes, alone = dynamics.follow(*asked), integration.integrate(*asked, flat=not space)
    assert lanes.steps == alone.steps
    scale = np.abs(alone.derivatives).max(axis=(0, 2, 3), keepdims=True)
    assert np.all(scale > 0.0)
    np.testing.assert_allclose(lanes.derivatives / scale, alone.derivatives / scale, atol=1e-6)
    np.testing.assert_allclose(lanes.shapes, alone.shapes, atol=1e-9)
    np.testing.assert_allclose(lanes.speeds, alone.speeds, atol=1e-7)
    # They go on from there as the other engine does.
    further = [STAMPS[-1] + SECOND // 10]
    again = integration.integrate(
        model, boundary, lanes.state, imposed, further, names, flat=not space
    )
    expected = integration.integrate(
        model, boundary, alone.state, imposed, further, names, flat=not space
    )
    np.testing.assert_allclose(again.derivatives / scale, expected.derivatives / scale, atol=1e-5)


def test_what_the_lanes_cannot_follow_the_scalar_engine_does(monkeypatch):
    model, boundary, state, imposed = moved(space=False)
    asked = (model, boundary, state, imposed, STAMPS[:2], NAMES)
    march = single_rod.march

    def failing(*arguments):
        return NO_CONVERGENCE, march(*arguments)[1]

    monkeypatch.setattr(single_rod, "march", failing)
    found, alone = dynamics.follow(*asked), integration.integrate(*asked, flat=True)
    np.testing.assert_array_equal(found.derivatives, alone.derivatives)
    np.testing.assert_array_equal(found.state.sensitivity.q, alone.state.sensitivity.q)


@pytest.mark.parametrize("space", [False, True], ids=["plane", "space"])
def test_a_motion_without_stamps_keeps_its_sensitivities(space):
    model, boundary, state, imposed = moved(space=space)
    found = dynamics.follow(model, boundary, state, imposed, [], NAMES)
    assert found.derivatives.shape == (0, len(NAMES), *state.q.shape)
    np.testing.assert_array_equal(found.state.sensitivity.q, state.sensitivity.q)


def test_a_jump_fails_with_sensitivities_too():
    model, boundary, state, imposed = moved(space=False)
    jump = replace(imposed, positions=imposed.positions + np.array([30.0, 0.0, 0.0]))
    with pytest.raises(SimulationError, match="does not converge"):
        dynamics.follow(model, boundary, state, jump, STAMPS, NAMES)


def columns_of(band, n, d, *, together):
    """Columns of a matrix of n control points with d numbers each, (d n, 4 d), from A[k, k] on."""
    if together or d == 2:
        numbers = band.ravel() if together else band[:, 0]
        return numbers[: 4 * d * d * n].reshape(d * n, 4 * d)
    blocks = band[:, 0].reshape(n, 16, 4)  # 16 rows from the control point's own on
    columns = np.zeros((n, 4, 16))
    for c in range(4):
        columns[:, c, : 16 - c] = blocks[:, c:, c]
    return columns.reshape(4 * n, 16)


@pytest.mark.parametrize("spans", some_of([3, 9, 18, 21], [9]))
@pytest.mark.parametrize("free", [False, True], ids=["clamped", "free end"])
@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("flat", [True, False], ids=["plane", "space"])
def test_spans_together_are_those_one_by_one(flat, first, free, spans):
    model, boundary, state, _ = moved(space=not flat, free=free)
    imposed = command(["start"] if free else ["start", "end"], [0.0], np.zeros((2 - free, 3)))
    model, boundary = build(model.settings, imposed, spans)
    state, rng = straight(model), np.random.default_rng(spans)
    n, nb, d = model.basis.control_points, len(model.rule.weight), 2 if flat else 4
    bent = np.zeros((n, 4))
    bent[:, [0, 2] if flat else range(4)] = 1e-2 * rng.normal(size=(n, d))
    state = replace(state, q=state.q + bent)
    tension, matrix = rows(nb), rows(2 * n * d)
    tension[...], matrix[...] = rng.normal(size=(nb, 1)), rng.normal(size=(2 * n * d, 1))
    counted = (model.rule.stretch_linear[:, None] | (np.arange(3) == 1)).ravel()
    tension[~counted] = 0.0
    results = []
    for models in ([model], [model, model]):
        layout = Layout(models, boundary, flat=flat)
        tables, scratch = layout.tables, layout.room.scratch
        assert (tables.together.size > 0) == (len(models) == 1)
        scratch.tangent[...] = np.random.default_rng(0).normal(size=(len(scratch.tangent), 1))
        motion = layout.unpacked(layout.motion([state] * len(models)))
        law = simd_kernels.BatchLaw(*(x[0] for x in layout.sets.law))
        rest = (law, scratch, matrix, tension, first)
        if flat:
            simd_kernels.assemble(motion.q[0], tables, *rest)
        else:
            frame = simd_kernels.Frame(*(x[0].copy() for x in motion.frame))
            spatial_kernels.assemble(motion.q[0].copy(), tables, frame, *rest)
        free_rows = slice(d * tables.lo, d * tables.hi)
        band = columns_of(scratch.band, n, d, together=len(models) == 1)[free_rows]
        tangents = scratch.tangent.reshape(nb, -1)[counted]
        results.append((scratch.gradient[free_rows].copy(), band.copy(), tangents))
    for together, one_by_one in zip(*results, strict=True):
        np.testing.assert_allclose(
            together, one_by_one, rtol=1e-12, atol=1e-13 * np.abs(one_by_one).max()
        )
