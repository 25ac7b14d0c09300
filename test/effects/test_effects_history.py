# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Bending that remembers: internal friction and what relaxes, against closed forms.

A weightless rod between two clamps that bend it evenly into an arc: one moment, one curvature.
"""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command, straight

from dlo_ros.parameters import DampingParameters
from dlo_ros.rod import dynamics
from dlo_ros.rod.resolution import build
from dlo_ros.rod.statics import settle

ROD = PAPER.rod
B = ROD.bending_stiffness
WEIGHTLESS = replace(PAPER, gravity=(0.0, 0.0, 0.0))
MOMENT, TURN = 2e-3, 1.5


def arcs(kappas, step=1.0):
    """A command that bends a straight rod into arcs one after the other, `step` apart [s]."""
    ends = np.zeros((len(kappas), 2, 3))
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (len(kappas), 2, 1))
    for k, kappa in enumerate(kappas):
        angle = kappa * ROD.length
        ends[k, 1] = (
            [np.sin(angle) / kappa, 0.0, (np.cos(angle) - 1.0) / kappa]
            if kappa else [ROD.length, 0.0, 0.0]
        )  # fmt: skip
        rotations[k, 1] = [0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)]
    return command(["start", "end"], step * np.arange(len(kappas)), ends, rotations)


def cyclic(most, steps=32):
    up = np.linspace(0.0, most, steps + 1)
    once = np.concatenate([up[:-1], up[::-1][:-1], -up[:-1], -up[::-1][:-1]])
    return np.concatenate([once, once, [0.0]])


def test_cyclic_bending_closes_a_loop_whose_area_is_the_energy_lost():
    kappas = cyclic(6.0)
    imposed = arcs(kappas)
    settings = WEIGHTLESS.with_effects({"hysteresis": {"moment": MOMENT, "curvature": TURN}})
    model, boundary = build(settings, imposed, 14)
    state = settle(model, boundary, straight(model), imposed, 0, fresh=True).state
    moments, bends = [], []
    for k in range(len(kappas)):
        state = settle(model, boundary, state, imposed, k * SECOND).state
        moments.append(MOMENT * state.internal.inner[:, 2].mean())
        bends.append(state.strains.other[:, 0].mean())
    # Dahl: along a branch from (x0, M0) towards larger x, M = m - (m - M0) exp(-(x - x0) / w).
    expected, before, moment = [], 0.0, 0.0
    for kappa in bends:
        side = np.sign(kappa - before)
        moment = side * MOMENT - (side * MOMENT - moment) * np.exp(-abs(kappa - before) / TURN)
        expected.append(moment)
        before = kappa
    np.testing.assert_allclose(moments, expected, atol=1e-3 * MOMENT)
    cycle = slice(len(kappas) // 2, None)  # the second one
    assert moments[-1] == pytest.approx(moments[len(kappas) // 2], abs=2e-2 * MOMENT)
    area = -np.trapezoid(np.array(bends)[cycle], np.array(moments)[cycle])
    tip = np.tanh(6.0 / TURN)  # largest moment of the closed loop, over MOMENT
    lost = 4.0 * MOMENT * (6.0 - TURN * tip)
    assert area == pytest.approx(lost, rel=0.01)


def test_where_a_rod_rests_is_chosen_by_its_history():
    """From above or from below to one clamp angle, it hangs on either side of its first shape."""
    angles = {"above": [-0.6, 0.0], "below": [0.6, 0.0], "never": [0.0, 0.0]}
    heights = {}
    settings = PAPER.with_effects({"hysteresis": {"moment": MOMENT, "curvature": TURN}})
    for name, way in angles.items():
        path = np.concatenate([[0.0], np.linspace(0.0, way[0], 9), np.linspace(way[0], 0.0, 9)])
        rotations = np.array([[[0.0, np.sin(a / 2), 0.0, np.cos(a / 2)]] for a in path])
        positions = np.zeros((len(path), 1, 3))
        imposed = command(["start"], np.arange(float(len(path))), positions, rotations)
        model, boundary = build(settings, imposed, 28)
        state = settle(model, boundary, straight(model), imposed, 0, fresh=True).state
        for k in range(len(path)):
            state = settle(model, boundary, state, imposed, k * SECOND).state
        heights[name] = state.q[-1, 2]
    # The DLO that was bent more stays bent more: friction holds back the way to the clamp's angle.
    assert heights["never"] - heights["above"] > 0.002
    assert heights["below"] - heights["never"] > 0.002


def still_arc(settings, kappas, times, seconds):
    """Mean moment of a rod that is bent at given times, at later instants."""
    imposed = arcs(kappas)
    imposed = replace(imposed, times=np.asarray(times, dtype=float))
    model, boundary = build(settings, imposed, 7)
    state = settle(model, boundary, straight(model), imposed, 0, fresh=True).state
    moments = []
    for t in seconds:
        state = dynamics.advance(model, boundary, state, imposed, round(t * SECOND))
        relaxed = 1.0 - model.law.relaxing
        inner = state.internal.inner[:, 0].mean() if len(state.internal.inner) else 0.0
        moments.append(B * (relaxed * state.strains.other[:, 0].mean() + inner))
    return np.array(moments), state


@pytest.mark.parametrize("time", [0.2, 2.0])
def test_the_moment_of_a_bent_rod_relaxes(time):
    """Bent within 0.1 s and held: M = B kappa (1 - share + share exp(-t / time)), nearly."""
    share, kappa, ramp = 0.4, 4.0, 0.1
    damped = replace(WEIGHTLESS, damping=DampingParameters(air_drag=0.5, relaxation_time=0.01))
    settings = damped.with_effects({"viscoelasticity": {"share": share, "time": time}})
    after = np.array([0.5, 1.0, 2.0, 6.0])
    moments, state = still_arc(settings, [0.0, kappa], [0.0, ramp], after)
    # The response to a ramp is exact.
    left = np.exp(-(after - ramp) / time) * (1.0 - np.exp(-ramp / time)) * time / ramp
    np.testing.assert_allclose(moments, B * kappa * (1.0 - share + share * left), rtol=2e-3)
    assert state.strains.other[:, 0].mean() == pytest.approx(kappa, rel=2e-3)


def test_a_level_rod_creeps_under_its_weight():
    """From the rigid, straight rod: its deflection grows by share / (1 - share), slowly."""
    share, time = 0.5, 0.4
    stiff = replace(PAPER, rod=replace(ROD, young_modulus=1e10))
    damped = replace(stiff, damping=DampingParameters(air_drag=0.6, relaxation_time=1e-3))
    settings = damped.with_effects({"viscoelasticity": {"share": share, "time": time}})
    imposed = command(["start"], [0.0], [[[0.0, 0.0, 0.0]]])
    model, boundary = build(settings, imposed, 7)
    state = dynamics.with_consistent_acceleration(model, boundary, straight(model), imposed)
    weight = stiff.rod.linear_density * 9.81
    at_once = weight * ROD.length**4 / (8.0 * stiff.rod.bending_stiffness)
    for t in (0.7, 1.5, 5.0):
        state = dynamics.advance(model, boundary, state, imposed, round(t * SECOND))
        # Of a standard linear solid under a constant load; its time is time / (1 - share).
        creep = 1.0 / (1.0 - share) * (1.0 - share * np.exp(-(1.0 - share) * t / time))
        assert -state.q[-1, 2] == pytest.approx(at_once * creep, rel=0.03)
    at_rest = settle(model, boundary, straight(model), imposed, 0).state.q[-1, 2]
    assert state.q[-1, 2] == pytest.approx(at_rest, rel=5e-3)


def test_what_relaxes_fast_is_internal_damping():
    """share / (1 - share) * time is the relaxation time of Kelvin and Voigt on (1 - share) E."""
    share, time = 0.5, 2e-3
    lifted = command(["start"], [0.0, 0.3], [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.1]]])
    own = DampingParameters(air_drag=0.01, relaxation_time=0.0)
    fast = replace(PAPER, damping=own, rod=replace(ROD, young_modulus=ROD.young_modulus / 0.5))
    fast = fast.with_effects({"viscoelasticity": {"share": share, "time": time}})
    damped = DampingParameters(air_drag=0.01, relaxation_time=share / (1.0 - share) * time)
    shapes = []
    for settings in (fast, replace(PAPER, damping=damped), replace(PAPER, damping=own)):
        model, boundary = build(settings, lifted, 14)
        state = settle(model, boundary, straight(model), lifted, 0, fresh=True).state
        track = dynamics.follow(
            model, boundary, state, lifted, [k * SECOND // 20 for k in range(1, 17)]
        )
        shapes.append(track.shapes)
    moved = np.abs(shapes[2] - shapes[1]).max()
    assert np.abs(shapes[0] - shapes[1]).max() < 0.1 * moved
