# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Many parameter sets at once against the same sets one by one."""

from dataclasses import replace

import numpy as np
import pytest
from numba import njit
from parameter_sets import (
    LENGTH,
    STAMPS,
    TOLERANCE,
    assert_as_alone,
    by_itself,
    varied,
    with_tolerance,
)
from rods import PAPER, SECOND, Nothing, command, held_start, settled, straight

from dlo_ros.command import Command
from dlo_ros.errors import CommandError, InputError, SimulationError
from dlo_ros.parameters import DampingParameters
from dlo_ros.rod import dynamics
from dlo_ros.rod.batch.parameter_sets import ParameterSets, follow_many
from dlo_ros.rod.elements import rod_forces
from dlo_ros.rod.elements.constitutive_law import room
from dlo_ros.rod.lanes import simd_kernels, simd_solver, simd_tables
from dlo_ros.rod.resolution import build
from dlo_ros.rod.simd.eight_lanes import LANES, largest, load, root, rows, smaller, spread, store
from dlo_ros.rod.statics import NO_INTERNAL_VARIABLES, material_at_rest


def test_vectors_compute_in_every_lane():
    @njit
    def compute(a, b, out):
        x, y = load(a, 1), load(b, 0)
        z = (2.0 * x + y) / (y - x * 0.25) - spread(1)
        z *= smaller(x, y)
        z += root(y) + 1
        store(out, 1, z)
        return largest(z)

    rng = np.random.default_rng(1)
    a, b, out = rows(2), rows(1), rows(2)
    a[:], b[:] = rng.uniform(1.0, 2.0, a.shape), rng.uniform(1.0, 2.0, b.shape)
    found = compute(a, b, out)
    x, y = a[1], b[0]
    expected = ((2.0 * x + y) / (y - 0.25 * x) - 1.0) * np.minimum(x, y) + np.sqrt(y) + 1.0
    np.testing.assert_allclose(out[1], expected, rtol=1e-14)
    assert not out[0].any()
    assert found == out[1].max()
    b[0, 3] = np.nan
    assert np.isnan(compute(a, b, out))


@pytest.mark.slow
@pytest.mark.parametrize("held", [(2, 0), (1, 1), (2, 2), (0, 0)])
@pytest.mark.parametrize("first", [True, False])
def test_equations_are_those_of_one_rod(held, first):
    """The linear solution of each lane against the planar rod's own matrix and gradient."""
    model, _ = build(PAPER, held_start(), 6)
    model = replace(model, full_start=held[0] < 2, full_end=held[1] < 2)
    n, nb = model.basis.control_points, len(model.rule.weight)
    lo, hi = held[0], n - held[1]
    rng = np.random.default_rng(0)
    q, matrix, rhs = rows(2 * n), rows(4 * n), rows(2 * n)
    law = simd_kernels.BatchLaw(rows(nb), rows(nb), rows(nb), rows(nb))
    many = 2 * n + 7
    scratch = simd_kernels.Scratch(
        rows(2 * n), rows(many), rows(8 * many), rows(42), rows(16), rows(2 * nb)
    )
    u = model.basis.greville
    single = []
    for k in range(LANES):
        bent = np.column_stack([u, -0.1 * (k + 1) * u**2]) + 1e-3 * rng.normal(size=(n, 2))
        factor = rng.uniform(0.5, 2.0, 2)
        rest = rng.normal(size=nb)
        stiff = model.stiffness._replace(
            stretch=factor[0] * model.stiffness.stretch,
            bend=factor[1] * model.stiffness.bend,
            bend_rest=np.column_stack([rest, np.zeros(nb)]),
        )
        single.append((bent, stiff, 1e3 * factor[0] * model.mass))
        q[:, k], rhs[:, k] = bent.ravel(), rng.normal(size=2 * n)
        matrix[:, k] = single[-1][2].ravel()
        law.stretch[:, k] = model.rule.weight * stiff.stretch
        law.bend[:, k], law.bend_rest[:, k] = model.rule.weight * stiff.bend[:, 0], rest
    fixed = np.ones((n, 2))
    fixed[lo:hi] = 0.0
    tables = simd_tables.tables_of(model.rule, fixed)
    stretch, bend, tension = rows(nb), rows(nb), rows(nb)
    simd_kernels.strains(q, tables, stretch, bend)
    simd_kernels.tensions(stretch, law, tables, tension)
    simd_kernels.assemble(q, tables, law, scratch, matrix, tension, True)
    if not first:  # what the last linear solution promised is where we are
        simd_kernels.assemble(q, tables, law, scratch, matrix, np.nan * tension, False)
    simd_solver.residual(q, matrix, rhs, scratch, tables)
    assert np.isfinite(simd_solver.solve(scratch, tables))
    for k, (bent, stiff, mass) in enumerate(single):
        gradient, band = np.empty(2 * n), np.empty((2 * n, 8))
        matter = material_at_rest(model, NO_INTERNAL_VARIABLES)._replace(stiffness=stiff)
        rod_forces.assemble(
            bent, model.rule, straight(model).reference, matter, room(nb), np.empty(0), gradient,
            band, np.empty((nb, 2)), np.zeros((nb, 1, 4)),
        )  # fmt: skip
        basis, full = np.zeros((n, n)), np.zeros((2 * n, 2 * n))
        for i in range(n):
            for j in range(max(0, i - 3), i + 1):
                basis[i, j] = basis[j, i] = mass[i, 3 - i + j]
        for i in range(2 * n):
            for j in range(max(0, i - 7), i + 1):
                full[i, j] = full[j, i] = band[i, 7 - i + j]
        full += np.kron(basis, np.eye(2))
        inner = slice(2 * lo, 2 * hi)
        missing = rhs[:, k] - gradient - (basis @ bent).ravel()
        expected = np.linalg.solve(full[inner, inner], missing[inner])
        np.testing.assert_allclose(
            scratch.step[inner, k], expected, atol=1e-9 * np.abs(expected).max()
        )


def test_falling_rods_move_as_each_does_alone():
    imposed = held_start()
    model, boundary = build(with_tolerance(PAPER), imposed, 10)
    models = list(varied(model, LANES + 3))
    states = [straight(m) for m in models]
    tracks = follow_many(models, boundary, states, imposed, STAMPS)
    assert tracks.shapes.shape == (LANES + 3, len(STAMPS), model.basis.control_points, 4)
    assert_as_alone(tracks, models, boundary, states, imposed, STAMPS)
    # They differ by far more than they may be wrong.
    assert np.ptp(tracks.shapes[:, -1, -1, 2]) > 0.05


def test_moving_turning_clamps_rest_curvature_and_hung_masses():
    times = [0.0, 0.25, 0.4]
    angle = np.array([0.0, 0.5, 0.3])
    turned = np.stack([0.0 * angle, np.sin(angle / 2), 0.0 * angle, np.cos(angle / 2)], axis=1)
    still = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    imposed = command(
        ["start", "end"], times,
        [[[0, 0, 0], [0.39, 0, 0]], [[0.05, 0, 0.02], [0.36, 0, 0]], [[0.1, 0, 0], [0.3, 0, 0]]],
        np.stack([turned, still], axis=1),
    )  # fmt: skip
    model, boundary, found = settled(with_tolerance(PAPER), imposed, 12)
    models = list(varied(model, 5))
    models[1] = replace(models[1], rest=lambda u: np.outer(3.0 + 0.0 * u, [1.0, 0.0, 0.0]))
    models[2] = replace(models[2], point_forces=((0.2, (0.0, 0.0, -0.05)),))
    states = [found.state if hasattr(found, "state") else found] * 5
    tracks = follow_many(models, boundary, states, imposed, STAMPS)
    assert_as_alone(tracks, models, boundary, states, imposed, STAMPS)


def test_rods_held_at_their_tips():
    imposed = command(
        ["control_point_1", "control_point_10"], [0.0, 0.5],
        [[[0, 0, 0], [0.4, 0, 0]], [[0.02, 0, 0.01], [0.36, 0, 0]]],
    )  # fmt: skip
    model, boundary = build(with_tolerance(PAPER), imposed, 8)
    models = list(varied(model, 3))
    states = [straight(m) for m in models]
    tracks = follow_many(models, boundary, states, imposed, STAMPS)
    assert_as_alone(tracks, models, boundary, states, imposed, STAMPS)


def test_free_rods_fall_to_their_own_terminal_speed():
    model, boundary = build(with_tolerance(PAPER), held_start(), 8)
    boundary = replace(boundary, names=())
    drags = (1.0, 2.0, 4.0)
    models = [
        replace(model, full_start=True, full_end=True).with_settings(
            replace(model.settings, damping=DampingParameters(air_drag=c, relaxation_time=0.0))
        )
        for c in drags
    ]
    tracks = follow_many(models, boundary, [straight(m) for m in models], Nothing(), STAMPS)
    for k, drag in enumerate(drags):
        terminal = PAPER.rod.linear_density * 9.81 / drag
        np.testing.assert_allclose(tracks.state(k).velocity[:, 2], -terminal, rtol=1e-3)
        np.testing.assert_allclose(tracks.state(k).velocity[:, 0], 0.0, atol=1e-9)


def test_motion_goes_on_from_where_it_ended(monkeypatch):
    imposed = held_start()
    model, boundary = build(with_tolerance(PAPER), imposed, 8)
    models = list(varied(model, 3))
    sets = ParameterSets(models, boundary)
    states = [straight(m) for m in models]
    whole = sets.follow(states, imposed, STAMPS)
    first = sets.follow(states, imposed, STAMPS[:2])
    second = sets.follow([first.state(k) for k in range(3)], imposed, STAMPS[2:])
    # In one go the stamps lie within steps, between the ends of which the motion is interpolated.
    np.testing.assert_allclose(
        second.shapes[:, 0], whole.shapes[:, 2], rtol=0.0, atol=0.1 * TOLERANCE * LENGTH
    )
    assert second.steps.max() < whole.steps.min()
    alone = by_itself(models[1], boundary, first.state(1), imposed, STAMPS[2:])
    apart = np.linalg.norm(whole.shapes[1, 2] - alone.shapes[0], axis=1).mean()
    assert apart < TOLERANCE * LENGTH
    # Where every stamp ends a step it is the same motion.
    ends = np.array(STAMPS) / SECOND
    monkeypatch.setattr(Command, "corners", lambda *_: ends)
    whole = sets.follow(states, imposed, STAMPS)
    first = sets.follow(states, imposed, STAMPS[:2])
    second = sets.follow([first.state(k) for k in range(3)], imposed, STAMPS[2:])
    np.testing.assert_allclose(second.shapes[:, 0], whole.shapes[:, 2], atol=1e-9 * LENGTH)


def test_a_set_that_fails_spoils_no_other():
    imposed = held_start()
    model, boundary = build(with_tolerance(PAPER, 2e-4), imposed, 8)
    models = list(varied(model, LANES + 1))
    states = [straight(m) for m in models]
    states[2] = replace(states[2], q=np.full_like(states[2].q, np.nan))
    tracks = follow_many(models, boundary, states, imposed, STAMPS)
    assert list(tracks.failures) == [2]
    assert np.isnan(tracks.shapes[2]).all()
    with pytest.raises(SimulationError, match=r"parameter set 2: .* does not converge"):
        tracks.state(2)
    for k in (0, 1, LANES - 1, LANES):
        alone = by_itself(models[k], boundary, states[k], imposed, STAMPS)
        np.testing.assert_allclose(tracks.shapes[k], alone.shapes, atol=2e-4 * LENGTH)
        np.testing.assert_allclose(tracks.state(k).q, alone.state.q, atol=2e-4 * LENGTH)


def test_a_looser_tolerance_takes_fewer_steps():
    imposed = held_start()
    model, boundary = build(with_tolerance(PAPER), imposed, 8)
    steps = []
    for tolerance in (2e-5, 2e-3):
        models = [m.with_settings(with_tolerance(m.settings, tolerance)) for m in varied(model, 3)]
        tracks = follow_many(models, boundary, [straight(m) for m in models], imposed, STAMPS)
        steps.append(tracks.steps[0])
    assert steps[1] < 0.5 * steps[0]


def test_unusable_sets_are_refused():
    imposed = held_start()
    model, boundary = build(PAPER, imposed, 8)
    state = straight(model)
    with pytest.raises(InputError, match="there is none"):
        ParameterSets([], boundary)
    finer, _ = build(PAPER, imposed, 9)
    with pytest.raises(InputError, match="set 1 has another basis"):
        ParameterSets([model, finer], boundary)
    with pytest.raises(InputError, match="boundary has another basis"):
        ParameterSets([finer], boundary)
    coupled = replace(model)
    coupled.stiffness.bend[:, 2] = 1e-3 * coupled.stiffness.bend[:, 0]
    with pytest.raises(InputError, match=r"directions of bending of set 1 are coupled"):
        ParameterSets([model, coupled], boundary)
    assert not dynamics.in_lanes(coupled, boundary)
    pinned = command(["start", "control_point_6"], [0.0], [[0, 0, 0], [0.2, 0, 0]])
    with pytest.raises(InputError, match="in the middle"):
        ParameterSets([model], build(PAPER, pinned, 8)[1])
    sets = ParameterSets([model, model], boundary)
    with pytest.raises(InputError, match="1 states for 2 sets"):
        sets.follow([state], imposed, STAMPS)
    with pytest.raises(InputError, match="state of set 1"):
        sets.follow([state, replace(state, stamp=5)], imposed, STAMPS)
    together = command(["control_point_1", "control_point_2"], [0.0], [[0, 0, 0], [0, 0, 0]])
    _, directed = build(PAPER, together, 8)
    with pytest.raises(CommandError, match="coincide"):
        ParameterSets([model], directed).follow([state], together, STAMPS)
