# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A warning where clamps had twisted the DLO before it was first observed: nothing tells that."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import END, NANOSECONDS, START, Command
from dlo_ros.effects.physics.clamp_angle import TOLERANCE
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)


def tell_early_twist(manipulation: Manipulation) -> None:
    """Warn of twist that the commands had imposed before the first observed shape.

    The DLO is taken as free of twist there.
    """
    first = manipulation.observations[0].stamp
    twist = imposed_twist(manipulation.commands, first)
    if abs(twist) <= TOLERANCE:
        return
    began = min(c.stamp for c in manipulation.commands)
    LOG.warning(
        "%s: the commanded clamps twist the DLO by %.0f degrees before its first observed shape, "
        "%.2f s after they begin; it is taken as free of twist there, and that twist is not "
        "simulated: record from before the clamps turn",
        manipulation.name, abs(np.degrees(twist)), (first - began) / NANOSECONDS,
    )  # fmt: skip


def imposed_twist(commands: Sequence[Command], until: int) -> float:
    """Angle by which the clamp at the end has turned about the DLO, less that of the start [rad].

    Counted from where both ends came to be clamped, and up to a stamp [ns]; full turns add up.
    """
    begun = sorted((c for c in commands if c.stamp < until), key=lambda c: c.stamp)
    twist, before = 0.0, None
    for command, end in zip(begun, [*(c.stamp for c in begun), until][1:], strict=True):
        points = (command.stamp + round(t * NANOSECONDS) for t in command.times)
        for stamp in [*(p for p in points if p < end), end]:
            now = _clamps(command, stamp)
            if now is None:
                twist = 0.0  # a new grip takes the DLO as it is
            elif before is not None:
                start, last = (_turned(a, b) for a, b in zip(before, now, strict=True))
                twist += last - start
            before = now
    return twist


def _clamps(command: Command, stamp: int) -> FloatArray | None:
    """Rotation matrices of the clamps at both ends, shape (2, 3, 3); None without both."""
    if not {START, END} <= set(command.names):
        return None
    _, rotations = command.sample(stamp)
    both = [command.names.index(name) for name in (START, END)]
    return np.asarray(Rotation.from_quat(rotations[both]).as_matrix())


def _turned(before: FloatArray, now: FloatArray) -> float:
    """Angle about its x axis by which a clamp turns beside going there the short way [rad]."""
    there, _ = Rotation.align_vectors(now[None, :, 0], before[None, :, 0])
    carried = there.apply(before[:, 1])
    return float(np.arctan2(np.cross(carried, now[:, 1]) @ now[:, 0], carried @ now[:, 1]))
