# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Tables of rods in lanes, common to those of one discretisation that are held alike."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dlo_ros.rod.boundary.conditions import END_CLAMP, START_CLAMP
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.discretisation import Discretisation
from dlo_ros.rod.elements.rod_tables import DOF
from dlo_ros.rod.lanes.simd_tables import KEPT, TARGET, Tables, tables_of
from dlo_ros.rod.planar_model import reduce
from dlo_ros.spline import FloatArray

KEPT_TABLES = 32
"""Tables that are kept: those of some recordings, each with several numbers of spans."""


@lru_cache(maxsize=KEPT_TABLES)
def held_tables(of: Discretisation, boundary: Boundary, *, flat: bool, alone: bool) -> Tables:
    """The tables of rods with a discretisation, without room of their own.

    Args:
        flat: whether they stay in the plane y = 0.
        alone: whether all lanes hold the same rod.
    """
    fixed = _fixed(boundary, of.basis.control_points, flat=flat)
    return tables_of(of.rule, fixed, alone=alone)


def _fixed(boundary: Boundary, n: int, *, flat: bool) -> FloatArray:
    """Held numbers of each control point, see `simd_tables.tables_of`."""
    fixed = np.where(boundary.fixed.reshape(n, DOF), TARGET, 0.0)
    # Without a clamp the twist angle of an end is held where it is.
    for end, clamp in ((0, START_CLAMP), (-1, END_CLAMP)):
        if fixed[end, 3] and clamp not in boundary.kinds:
            fixed[end, 3] = KEPT
    return reduce(fixed, flat)
