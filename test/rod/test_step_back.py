# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Newton's method beside a law whose slope jumps: a friction within the DLO that mostly sticks."""

from dataclasses import replace

import numpy as np
import pytest
from rods import PAPER, SECOND, command, straight
from scipy.spatial.transform import Rotation

from dlo_ros.parameters import DampingParameters
from dlo_ros.rod import integration
from dlo_ros.rod.resolution import build
from dlo_ros.rod.statics import settle

MOMENT, TURN = 1.2e-3, 0.04
"""A twentieth of the moment of the weight, and fifty times as stiff as the DLO where it sticks."""
STAMPS = [SECOND // 2, SECOND, 2 * SECOND, 4 * SECOND]
LED = [[[0.0, 0.0, 0.0]], [[0.05, 0.0, 0.03]], [[0.0, 0.0, 0.05]]]
TURNED = Rotation.from_rotvec([[0.0, a, 0.0] for a in (0.0, 0.5, 0.2)]).as_quat()[:, None]
ASIDE = Rotation.from_rotvec([[a, a, 0.5 * a] for a in (0.0, 0.5, 0.2)]).as_quat()[:, None]


def led(tolerance, rotations):
    """A cantilever that is led for 0.8 s and held for 3.2 s."""
    settings = PAPER.with_effects({"hysteresis": {"moment": MOMENT, "curvature": TURN}})
    simulation = replace(settings.simulation, tolerance=tolerance)
    settings = replace(settings, simulation=simulation, damping=DampingParameters(0.05, 0.005))
    imposed = command(["start"], [0.0, 0.4, 0.8], LED, rotations)
    model, boundary = build(settings, imposed, 14)
    state = settle(model, boundary, straight(model), imposed, 0, fresh=True).state
    flat = rotations is TURNED
    return integration.integrate(model, boundary, state, imposed, STAMPS, flat=flat)


@pytest.mark.parametrize("rotations", [TURNED, ASIDE], ids=["plane", "space"])
def test_friction_that_sticks_takes_few_steps(rotations):
    found = led(0.01, rotations)
    assert found.steps < 300  # thousands while Newton's method went to and fro
    fine = led(1e-4, rotations)
    length = PAPER.rod.length
    np.testing.assert_allclose(found.shapes[..., :3], fine.shapes[..., :3], atol=0.01 * length)
