# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Standard manipulations, beside which one is sought that separates two explanations better."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dlo_ros.command import END, START
from dlo_ros.identification.design.expected_information import Plan
from dlo_ros.identification.design.manipulation_search import SPACING, plan_along
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

REST = 1.0  # [s] after the motion
PI = float(np.pi)

Way = Sequence[tuple[float, float, float, float]]  # time [s], x and z over L, angle


def standard(settings: Settings) -> list[Plan]:
    """Manipulations that any DLO can make; their names are instructions to the person."""
    s = np.linspace(0.0, 1.0, 30)
    hanging = np.column_stack([0.05 * s, -s])
    right = np.column_stack([np.sin(1.5 * s), np.cos(1.5 * s) - 1.0])
    bow = np.column_stack([0.5 * s, -1.5 * s * (1.0 - s)])
    swing: Way = [(0.0, 0.0, 0.0, 0.5 * PI), (0.4, 0.3, 0.0, 0.5 * PI), (2.5, 0.3, 0.0, 0.5 * PI)]
    nod: Way = [(0.0, 0.0, 0.0, 0.0), (0.8, 0.0, 0.0, -0.6), (1.8, 0.0, 0.0, 0.6),
                (2.6, 0.0, 0.0, 0.0)]  # fmt: skip
    other: Way = [(t, -x, z, PI - a) for t, x, z, a in nod]
    still: Way = [(0.0, 0.0, 0.0, 1.2)]
    closing: Way = [(0.0, 0.5, 0.0, -1.2), (1.2, 0.3, 0.0, -1.2), (2.4, 0.5, 0.1, -1.2)]
    mirrored = right * np.array([-1.0, 1.0])
    return [
        _made(settings, "hang it from one clamp, carry it aside at once and let it swing",
              hanging, {START: swing}),
        _made(settings, "hold it level in one clamp, the other end free, and nod slowly up and "
              "down", right, {START: nod}),
        _made(settings, "hold it level in one clamp turned by 180 degrees, the other end free, and "
              "nod slowly up and down", mirrored, {START: other}),
        _made(settings, "hang it between two clamps as a U and move them together and apart", bow,
              {START: still, END: closing}),
    ]  # fmt: skip


def _made(settings: Settings, words: str, curve: FloatArray, ways: dict[str, Way]) -> Plan:
    """A plan from the ways of its clamps, at straight lines, and a curve over L to settle from."""
    length, tracks = settings.rod.length, {}
    times = np.arange(0.0, REST + max(w[-1][0] for w in ways.values()), SPACING)
    for end, way in ways.items():
        at, *columns = np.array(way).T
        x, z, angle = (np.interp(times, at, column) for column in columns)
        tracks[end] = np.column_stack([times, length * x, length * z, angle])
    return plan_along(words, tracks, length * curve, float(times[-1]), settings)
