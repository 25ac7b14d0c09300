# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Outlines of the pegs and walls of a model, to draw beside the DLO that touches them."""

from __future__ import annotations

import numpy as np

from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

CORNERS = 48
"""Corners of a peg's outline."""
DEPTH = 20.0
"""How far a wall is drawn along itself and behind its face, over the length of the DLO."""


def outlines(settings: RodSettings) -> tuple[FloatArray, ...]:
    """Closed outlines in x and z [m], shape (m, 2) each; none where the DLO touches nothing.

    They stand where the camera shows them, as it shows the DLO.
    """
    length = settings.rod.length
    body = settings.body(SplineBasis(settings.rod.control_points, length))
    turn = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    pegs = [np.array([peg.x, peg.z]) + peg.radius * circle for peg in body.pegs]
    sides = DEPTH * length * np.array([[-1.0, 0.0], [1.0, 0.0], [1.0, -1.0], [-1.0, -1.0]])
    walls = []
    for x, z, offset in body.walls:  # its unit normal, and its face along that
        walls.append(offset * np.array([x, z]) + sides @ np.array([[-z, x], [x, z]]))
    camera = MeasurementMap(settings)
    return tuple(camera.measured(np.insert(o, 1, 0.0, axis=1))[:, [0, 2]] for o in (*pegs, *walls))
