# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Effects at rest at large angles, and their limits, against boundary value problems."""

from dataclasses import replace

import numpy as np
import pytest
from elastica import Cantilever, hinged
from rods import PAPER, SECOND, command, held_start, settled, straight
from scipy.integrate import solve_bvp

from dlo_ros.parameters import DampingParameters
from dlo_ros.rod import dynamics
from dlo_ros.rod.resolution import build
from dlo_ros.rod.statics import settle

ROD = PAPER.rod
B, WEIGHT = ROD.bending_stiffness, 9.81 * ROD.linear_density  # [N m^2], [N/m]
STRETCH = ROD.young_modulus * ROD.area
U = np.linspace(0.0, ROD.length, 161)
MOMENT, TURN = 2e-3, 1.5  # of the friction within the rod [N m, 1/m]


def apart(shape, answer):
    """Largest distance of two shapes in x and z, over L."""
    return np.abs(shape - answer).max() / ROD.length


class RubbingCantilever:
    """The elastica of Dahl's friction, whose state z (s) is carried along while the clamp turns.

    M = B kappa + m z with z = side - (side - z0) exp(-|kappa - kappa0| / w), where kappa0, z0 are
    those of the clamp's angle before; the first shape is free of friction.
    """

    def __init__(self):
        self.s = np.linspace(0.0, ROD.length, 401)
        self.kappa, self.friction = None, np.zeros_like(self.s)
        self.guess = np.vstack([0.0 * self.s, 0.0 * self.s, self.s, 0.0 * self.s])

    def curvature(self, moment, at):
        """Curvature under a moment, by Newton's method on the monotonic branch."""
        if self.kappa is None:
            return moment / B
        before, z = np.interp(at, self.s, self.kappa), np.interp(at, self.s, self.friction)
        side = np.where(moment < B * before + MOMENT * z, -1.0, 1.0)
        kappa = before.copy()
        for _ in range(60):
            left = (side - z) * np.exp(-np.abs(kappa - before) / TURN)
            slope = B + MOMENT * side * left / TURN
            kappa = kappa - (B * kappa + MOMENT * (side - left) - moment) / slope
        return kappa

    def turned(self, angle):
        """Points x, z [m] at `s` once the clamp points at an angle [rad], shape (401, 2)."""

        def rate(s, y, share):
            a, moment, _, _ = y
            nz = -share * WEIGHT * (ROD.length - s)
            grown = 1.0 - nz * np.sin(a) / STRETCH
            x, z = grown * np.cos(a), -grown * np.sin(a)
            return np.vstack([self.curvature(moment, s), nz * x, x, z])

        def ends(p, q):
            return np.array([p[0] - angle, q[1], p[2], p[3]])

        for share in (0.1, 0.3, 0.6, 1.0) if self.kappa is None else (1.0,):
            found = solve_bvp(
                lambda s, y, share=share: rate(s, y, share), ends, self.s, self.guess,
                tol=1e-6, max_nodes=20000,
            )  # fmt: skip
            assert found.success, found.message
            self.guess = found.sol(self.s)
        kappa = self.curvature(self.guess[1], self.s)
        if self.kappa is not None:
            side = np.sign(kappa - self.kappa)
            left = (side - self.friction) * np.exp(-np.abs(kappa - self.kappa) / TURN)
            self.friction = side - left
        self.kappa = kappa
        return self.guess[2:].T


@pytest.mark.parametrize("most", [-0.6, 0.0, 0.6], ids=["above", "never", "below"])
def test_where_a_rubbing_rod_rests_is_the_elastica_of_its_history(most):
    path = np.concatenate([[0.0], np.linspace(0.0, most, 9), np.linspace(most, 0.0, 9)])
    rotations = np.array([[[0.0, np.sin(a / 2), 0.0, np.cos(a / 2)]] for a in path])
    places = np.zeros((len(path), 1, 3))
    imposed = command(["start"], np.arange(float(len(path))), places, rotations)
    settings = PAPER.with_effects({"hysteresis": {"moment": MOMENT, "curvature": TURN}})
    model, boundary = build(settings, imposed, 28)
    state = settle(model, boundary, straight(model), imposed, 0, fresh=True).state
    answer = RubbingCantilever()
    for k, angle in enumerate(path):
        state = settle(model, boundary, state, imposed, k * SECOND).state
        expected = answer.turned(angle)
    shape = model.basis.evaluate(state.q, answer.s)[:, [0, 2]]
    assert apart(shape, expected) < 1e-4


def lifted_off(height):
    """A rod that is held level at a height above a table: free length [m], and shape at u.

    At the touching point angle and moment vanish, and the table's force is unknown, as the free
    length is. Nothing pulls along the table.
    """

    def rate(t, y, p):
        free, push = p
        a, moment, _, _ = y
        nz = push - WEIGHT * free * (1.0 - t)
        grown = 1.0 - nz * np.sin(a) / STRETCH
        x, z = grown * np.cos(a), -grown * np.sin(a)
        return free * np.vstack([moment / B, nz * x, x, z])

    def ends(p, q, _):
        return np.array([p[0], p[2], p[3], q[0], q[1], q[3] + height])

    free = (72.0 * B * height / WEIGHT) ** 0.25  # of a beam of small slope
    t = np.linspace(0.0, 1.0, 200)
    s = free * (1.0 - t)
    z = WEIGHT * (free * s**3 / 18.0 - s**4 / 24.0) / B - height
    a = -np.gradient(z, t * free)
    guess = np.vstack([a, B * np.gradient(a, t * free), t * free, z])
    found = solve_bvp(
        rate, ends, t, guess, p=[free, WEIGHT * free / 3.0], tol=1e-7, max_nodes=20000
    )
    assert found.success, found.message
    free = float(found.p[0])
    above = found.sol(np.clip(U / free, 0.0, 1.0))[2:].T
    lying = np.column_stack([found.y[2, -1] + U - free, np.full_like(U, -height)])
    return free, np.where((free > U)[:, None], above, lying)


@pytest.mark.parametrize("height", [0.005, 0.02, 0.05])
def test_a_rod_lifted_off_a_table_is_an_elastica_of_unknown_length(height):
    settings = PAPER.with_effects({"wall": {"offset": -height - 0.5 * ROD.diameter}})
    model, _, found = settled(settings, held_start(), 112)
    shape = model.basis.evaluate(found.state.q, U)[:, [0, 2]]
    free, expected = lifted_off(height)
    assert 0.3 * ROD.length < free < 0.9 * ROD.length
    assert apart(shape, expected) < 1e-5


def under_weight(settings, hung=lambda u: 0.0 * u, stiffer=lambda u: 1.0 + 0.0 * u, breaks=()):
    """The elastica of a level cantilever under its weight and what hangs beyond u [N]."""
    rod = settings.rod
    return Cantilever(
        rod.length, lambda u: stiffer(u) * rod.bending_stiffness, rod.young_modulus * rod.area,
        lambda u: (0.0 * u, -WEIGHT * (rod.length - u) - hung(u)), breaks=breaks,
    )  # fmt: skip


@pytest.mark.parametrize(("mass", "angle"), [(0.005, 0.47), (0.02, 0.90)])
def test_a_plug_hangs_from_a_rod_that_bends_far(mass, angle):
    """A rod that is a hundred thousand times as stiff within the plug, which is a rigid lever."""
    extent = 0.08
    begin = ROD.length - extent
    stiff = replace(PAPER, rod=replace(ROD, young_modulus=1e9))
    settings = stiff.with_effects({"connector": {"mass": mass, "extent": extent}})
    model, _, found = settled(settings, held_start(), 56)
    answer = under_weight(
        stiff, lambda u: mass * 9.81 * np.clip((ROD.length - u) / extent, 0.0, 1.0),
        lambda u: np.where(u > begin, 1e5, 1.0), [begin],
    ).solve(U)  # fmt: skip
    lever = answer[-1] - answer[np.searchsorted(U, begin)]
    assert np.arctan2(-lever[1], lever[0]) == pytest.approx(angle, abs=0.01)  # [rad]
    assert apart(model.basis.evaluate(found.state.q, U)[:, [0, 2]], answer) < 5e-5


@pytest.mark.parametrize("spans", [7, 14, 28, 56])
@pytest.mark.parametrize(("compliance", "angle", "slack"), [(30.0, 0.3, 3e-4), (60.0, 0.5, 1.5e-3)])
def test_a_soft_grip_is_a_torsional_spring(spans, compliance, angle, slack):
    settings = PAPER.with_effects({"clamp_compliance": {"start": compliance}})
    model, _, found = settled(settings, held_start(), spans)
    spring = hinged(under_weight(PAPER), compliance, WEIGHT)
    assert spring.direction == pytest.approx(angle, abs=0.01)  # [rad]
    assert apart(model.basis.evaluate(found.state.q, U)[:, [0, 2]], spring.solve(U)) < slack


# A thousandth of the length thick: the share that relaxes does so in bending alone.
THIN = replace(
    PAPER, rod=replace(ROD, diameter=5e-4, young_modulus=8**4 * 5e7, density=64 * 2500.0),
    simulation=replace(PAPER.simulation, tolerance=2e-5),
)  # fmt: skip


def away_from_damping(share, time):
    """Largest distance of what relaxes from internal damping in a smooth lift [m]."""
    seconds = np.linspace(0.0, 0.6, 61)
    x = seconds / 0.6
    positions = np.zeros((61, 1, 3))
    positions[:, 0, 2] = 0.1 * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    lifted = command(["start"], seconds, positions)
    bare = DampingParameters(air_drag=0.01, relaxation_time=0.0)
    damped = DampingParameters(air_drag=0.01, relaxation_time=share / (1.0 - share) * time)
    fast = replace(THIN.rod, young_modulus=THIN.rod.young_modulus / (1.0 - share))
    creeping = replace(THIN, damping=bare, rod=fast)
    creeping = creeping.with_effects({"viscoelasticity": {"share": share, "time": time}})
    shapes = []
    for settings in (creeping, replace(THIN, damping=damped)):
        model, boundary = build(settings, lifted, 14)
        state = settle(model, boundary, straight(model), lifted, 0, fresh=True).state
        stamps = [k * SECOND // 20 for k in range(1, 17)]
        shapes.append(dynamics.follow(model, boundary, state, lifted, stamps).shapes)
    return np.abs(shapes[0] - shapes[1]).max()


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_the_faster_the_share_relaxes_the_nearer_it_is_to_internal_damping(share):
    off = np.array([away_from_damping(share, time) for time in (8e-3, 4e-3, 2e-3, 1e-3)])
    assert np.all(off[:-1] / off[1:] > 2.0)
    assert off[-1] < 1e-4 * ROD.length
