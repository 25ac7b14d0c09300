# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Cables to export."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import Command
from dlo_ros.export.chain import build_chain
from dlo_ros.parameters import RodParameters, Settings
from dlo_ros.spline import SplineBasis

ROD = RodParameters(0.4, 0.004, 5e7, 2500.0, control_points=12)
BASIS = SplineBasis(12, ROD.length)


def held(names=("start",), position=(0.0, 0.0, 0.0), angle=0.0):
    """A command that holds clamps still, all turned by an angle about y."""
    k = len(names)
    rotation = Rotation.from_rotvec([0.0, angle, 0.0]).as_quat()
    return Command(
        0, tuple(names), np.zeros(1), np.tile(position, (1, k, 1)), np.tile(rotation, (1, k, 1)),
        np.full((1, k, 3), np.nan), 12,
    )  # fmt: skip


def straight(position=(0.0, 0.0, 0.0), angle=0.0):
    along = Rotation.from_rotvec([0.0, angle, 0.0]).apply([1.0, 0.0, 0.0])
    shape = np.zeros((12, 4))
    shape[:, :3] = np.asarray(position) + BASIS.greville[:, None] * along
    return shape


def chain_of(effects=None, joints=10, command=None, shape=None, **changes):
    settings = replace(Settings(replace(ROD, **changes)), effects=effects or {})
    shape = straight() if shape is None else shape
    return build_chain(settings, command or held(), 0, BASIS, shape, joints)
