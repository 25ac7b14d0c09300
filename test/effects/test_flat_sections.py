# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A DLO whose cross-section is no circle: two bending stiffnesses, and a torsional one."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, command, held_start, straight

from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.resolution import build
from dlo_ros.rod.state import twist_angle
from dlo_ros.rod.statics import settle
from dlo_ros.spline import SplineBasis

ROD = PAPER.rod
B, LENGTH = ROD.bending_stiffness, ROD.length
FLAT = (0.25, 4.0, 0.8)  # soft about y at the start, stiff about the other director
STIFF = replace(PAPER, rod=replace(ROD, young_modulus=5e10))
WEIGHTLESS = replace(PAPER, gravity=(0.0, 0.0, 0.0))


def settled(settings, imposed, section, *, spans=14, forces=(), start=None):
    model, boundary = build(settings, imposed, spans)
    model = replace(model, section=section, point_forces=forces)
    state = straight(model) if start is None else start
    return model, boundary, settle(model, boundary, state, imposed, imposed.stamp)


@pytest.mark.parametrize("axis", [1, 2], ids=["across", "upright"])
def test_it_sags_by_the_stiffness_about_the_axis_that_bends(axis):
    """w L^4 / (8 B) under a small weight along z, or along y, for a clamp at x."""
    gravity = [0.0, 0.0, 0.0]
    gravity[3 - axis] = -9.81
    settings = replace(STIFF, gravity=tuple(gravity))
    _, _, found = settled(settings, held_start(), FLAT)
    stiffness = STIFF.rod.bending_stiffness * FLAT[axis - 1]
    expected = STIFF.rod.linear_density * 9.81 * LENGTH**4 / (8.0 * stiffness)
    assert -found.state.q[-1, 3 - axis] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("angle", [0.0, np.pi / 6, np.pi / 4, np.pi / 2])
def test_turned_about_its_axis_it_bends_askew(angle):
    """A small load at the tip of a clamp that has turned: P L^3 / 3 by the stiffness tensor."""
    load = 1e-3 * B / LENGTH**2
    turns = np.linspace(0.0, angle, 5)
    imposed = command(
        ["start"], np.arange(5.0), np.zeros((5, 1, 3)),
        [[[np.sin(a / 2), 0.0, 0.0, np.cos(a / 2)]] for a in turns],
    )  # fmt: skip
    model, boundary = build(WEIGHTLESS, imposed, 14)
    model = replace(model, section=FLAT, point_forces=((LENGTH, (0.0, 0.0, -load)),))
    state = straight(model)
    for k in range(5):
        state = settle(model, boundary, state, imposed, k * 1_000_000_000).state
    # Compliance along z: director 1 turns from y towards z, bending about it is seen in z.
    along = np.cos(angle) ** 2 / FLAT[0] + np.sin(angle) ** 2 / FLAT[1]
    across = np.sin(angle) * np.cos(angle) * (1.0 / FLAT[0] - 1.0 / FLAT[1])
    scale = load * LENGTH**3 / (3.0 * B)
    assert state.q[-1, 2] == pytest.approx(-scale * along, rel=2e-3)
    assert abs(state.q[-1, 1]) == pytest.approx(scale * across, rel=2e-3, abs=1e-9)


def test_twist_is_that_of_the_torsional_stiffness():
    """Between clamps that are turned, twist is even; the torque is C times twist over L."""
    angle = 0.5
    imposed = command(
        ["start", "end"], [0.0], [[[0.0, 0.0, 0.0], [LENGTH, 0.0, 0.0]]],
        [[[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]]],
    )  # fmt: skip
    end = [np.sin(angle / 2), 0.0, 0.0, np.cos(angle / 2)]
    turned = replace(imposed, stamp=1, rotations=np.array([[[0.0, 0.0, 0.0, 1.0], end]]))
    model, boundary, found = settled(WEIGHTLESS, imposed, FLAT)
    found = settle(model, boundary, found.state, turned, 1)
    np.testing.assert_allclose(found.state.strains.other[:, 2], angle / LENGTH, rtol=1e-6)
    assert twist_angle(found.state, model)[-1] == pytest.approx(angle)
    torque = model.stiffness.twist * found.state.strains.other[:, 2]
    round_one = ROD.shear_modulus * 2.0 * ROD.second_moment
    np.testing.assert_allclose(torque, FLAT[2] * round_one * angle / LENGTH, rtol=1e-6)


@pytest.mark.parametrize("width", [2.0, 4.0])
def test_a_strip_that_bends_the_stiff_way_tips_over_sideways(width):
    """Prandtl and Michell: a strip with a load at its tip, P L^2 = 4.0126 sqrt(B C).

    The exact value is for a stiff axis that does not bend; with B / B_stiff it is higher by
    1 / sqrt((1 - B / B_stiff) (1 - C / B_stiff)).
    """
    soft, twist = 1.0, 0.7
    section = (width**2 * soft, soft, twist)
    settings = replace(WEIGHTLESS, rod=replace(ROD, young_modulus=5e7))
    torsion = settings.rod.shear_modulus * 2.0 * settings.rod.second_moment * twist
    stiff = B * section[0]
    factor = 1.0 / np.sqrt((1.0 - B * soft / stiff) * (1.0 - torsion / stiff))
    critical = 4.0126 * np.sqrt(B * soft * torsion) / LENGTH**2 * factor

    def tips_over(load):
        forces = ((LENGTH, (0.0, 0.0, -load)),)
        _, _, found = settled(settings, held_start(), section, spans=28, forces=forces)
        return found.buckled or not found.stable

    assert not tips_over(0.85 * critical)
    assert tips_over(1.15 * critical)


def test_a_round_section_is_the_plain_rod():
    plain = RodModel(PAPER, SplineBasis(17, LENGTH))
    same = replace(plain, section=(1.0, 1.0, 1.0))
    np.testing.assert_array_equal(plain.stiffness.bend, same.stiffness.bend)
    assert Boundary(("start",), plain.basis, SplineBasis(10, LENGTH)).clamped_start
