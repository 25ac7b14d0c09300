# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters at the ends of their ranges: each DLO works, as closed forms say, or is refused.

Horizontally clamped, hanging under its own weight, then lifted: E from 1 kPa to 1 TPa, 1 cm to
100 m, 0.1 mm to 10 cm.
"""

from __future__ import annotations

import numpy as np
import pytest
from ordinary import some_of

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.errors import ParameterError, SimulationError
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

pytestmark = pytest.mark.long

MODULI = (1e3, 1e6, 1e9, 1e12)
LENGTHS = (0.01, 0.4, 10.0, 100.0)
DIAMETERS = (1e-4, 4e-3, 1e-1)
DENSITY = 2000.0
N = 10
G = 9.81


def parameters(modulus: float, length: float, diameter: float) -> dict:
    return {
        "rod.length": length,
        "rod.diameter": diameter,
        "rod.young_modulus": modulus,
        "rod.density": DENSITY,
        "rod.control_points": N,
        "damping.air_drag": 0.01 * length,
    }


def hang(settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Control points [m] at rest, and after the clamp was lifted by 2 % of the length."""
    length = settings.rod.length
    seconds = max(1.0, float(np.sqrt(length / G)))
    positions = np.zeros((2, 1, 3))
    positions[1, 0, 2] = 0.02 * length
    level = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1, 1))
    nothing = np.full((2, 1, 3), np.nan)
    command = Command(0, ("start",), np.array([0.0, seconds]), positions, level, nothing, N)
    straight = np.zeros((N, 4))
    straight[:, 0] = SplineBasis(N, length).greville
    simulation = Simulation(settings, Motion([command]))
    simulation.start([Observation(0, straight)])
    rest = simulation.prediction().control_points
    return rest, simulation.advance(round(seconds * NANOSECONDS)).control_points


REASONS = (
    "would hang",  # longer than Hooke's law can say
    "no static equilibrium found",
    "does not converge",
)


@pytest.mark.parametrize("modulus", some_of(MODULI, [1e3, 1e12]))
@pytest.mark.parametrize("length", some_of(LENGTHS, [0.01, 100.0]))
@pytest.mark.parametrize("diameter", DIAMETERS)
def test_extreme_parameters_work_or_are_refused(modulus, length, diameter):
    settings = Settings.from_mapping(parameters(modulus, length, diameter))
    weight = DENSITY * np.pi * diameter**2 / 4.0 * G  # [N/m]
    bending = modulus * np.pi * diameter**4 / 64.0
    stretch = DENSITY * G * length / (2.0 * modulus)
    try:
        rest, moved = hang(settings)
    except SimulationError as err:
        assert any(reason in str(err) for reason in REASONS), err
        assert stretch > 0.5 or length / diameter > 5e5 or length / diameter < 5.0, err
        return
    assert stretch <= 0.5
    assert np.all(np.isfinite(rest)) and np.all(np.isfinite(moved))
    assert np.abs(moved[:, :3]).max() < 1.2 * (1.0 + stretch) * length
    tip = -rest[-1, 2]
    sag = weight * length**4 / (8.0 * bending)  # a cantilever's, where it is small
    boundary = (bending / weight) ** (1.0 / 3.0)  # in which a heavy cable bends at a clamp
    if sag < 0.01 * length:
        assert tip == pytest.approx(sag, rel=0.02 + 2.0 * stretch)
    elif boundary < 0.05 * length:
        # It hangs down, stretched, but for the bend.
        assert (1.0 + stretch) * length - 3.0 * boundary < tip + 2e-3 * length
        assert tip < (1.0 + stretch) * length * 1.002
    else:
        assert 0.0 < tip < (1.0 + stretch) * length


@pytest.mark.parametrize(
    ("name", "value"),
    [("rod.young_modulus", 9e2), ("rod.young_modulus", 1.1e12), ("rod.length", 9e-3),
     ("rod.length", 101.0), ("rod.diameter", 9e-5), ("rod.diameter", 0.11)],
)  # fmt: skip
def test_beyond_the_ranges_the_range_is_told(name, value):
    with pytest.raises(ParameterError, match=rf"{name} is .*; allowed is .* to "):
        Settings.from_mapping({**parameters(1e7, 0.4, 0.004), name: value})
