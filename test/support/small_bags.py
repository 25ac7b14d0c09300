# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A short recording with every kind of message, for files that are damaged or cut short."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import recordings_samples as samples

from dlo_ros.command import Command, Motion
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import (
    BAG_MESSAGES,
    BagWriter,
    command_message,
    points_message,
    spline_message,
)
from dlo_ros.rod.simulation import Simulation
from dlo_ros.spline import SplineBasis

N = 8

SETTINGS = Settings.from_mapping(
    {
        "rod.length": 0.4,
        "rod.diameter": 0.004,
        "rod.young_modulus": 1e7,
        "rod.density": 2000.0,
        "rod.control_points": N,
        "simulation.tolerance": 0.01,
        "effects.point_mass.mass": 0.001,
        "effects.point_mass.position": 0.4,
    }
)

STEP = 40_000_000


def recorded() -> list[tuple[str, Any, int]]:
    """A short manipulation: one end held and moved, splines, points, a few small images."""
    times = np.linspace(0.0, 0.4, 5)
    positions = np.zeros((5, 1, 3))
    positions[:, 0, 2] = 0.02 * np.sin(8.0 * times)
    turned = np.tile([0.0, 0.0, 0.0, 1.0], (5, 1, 1))
    nothing = np.full((5, 1, 3), np.nan)
    command = Command(samples.START, ("start",), times, positions, turned, nothing, N)
    simulation = Simulation(SETTINGS, Motion([command]))
    basis = SplineBasis(N, SETTINGS.rod.length)
    straight = np.column_stack([basis.greville, np.zeros((N, 3))])
    simulation.start([Observation(samples.START, straight)])
    result: list[tuple[str, Any, int]] = [
        ("/dlo/command", command_message(BAG_MESSAGES, command), samples.START - 1)
    ]
    for i in range(6):
        stamp = samples.START + i * STEP
        shape = simulation.advance(stamp).control_points
        message = spline_message(BAG_MESSAGES, stamp, "board", shape)
        result.append(("/dlo/observed", message, stamp))
        cloud = points_message(BAG_MESSAGES, stamp, "board", samples.centreline(i))
        result.append(("/dlo/observed_points", cloud, stamp))
        info = samples.camera_info_message(BAG_MESSAGES, stamp, samples.INFO)
        picture = samples.image_message(BAG_MESSAGES, stamp, "c", samples.picture(i))
        result += [("/camera_info", info, stamp), ("/image_raw", picture, stamp)]
    return result


def write_own(path: Path) -> None:
    with BagWriter(path) as writer:
        for topic, message, stamp in recorded():
            writer.write(topic, message, stamp)
