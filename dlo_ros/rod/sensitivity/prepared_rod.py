# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A rod, its command and the rates of its parameters as one object of compiled code.

A rod has a hundred arrays: to look at all of them in every call costs Python as much as an
iteration of Newton's method. A reference to them costs nothing.
"""

from __future__ import annotations

from numba.core import types
from numba.experimental import structref

from dlo_ros.kernel_cache import njit


@structref.register
class _PreparedRodType(types.StructRef):  # type: ignore  # numba carries no types
    """Type of a `PreparedRod` in compiled code."""


class PreparedRod(structref.StructRefProxy):  # type: ignore[misc]
    """A reference to what `prepare` was given, under the same names."""


structref.define_proxy(
    PreparedRod,
    _PreparedRodType,
    ["system", "imposed", "step", "moves", "rates", "kind", "fixed", "pins", "lanes"],
)


@njit()
def prepare(system, imposed, step, moves, rates, kind, fixed, pins, lanes):
    """The object.

    Args:
        system, imposed: the rod and its command, with two variants for each parameter.
        step, moves, rates, kind: fields of the parameters, see `SensitivityState`.
        fixed, pins: as in `System`, in space also where the rod is a planar one.
        lanes: the rod in lanes, see `PlanarLanes`.
    """
    return PreparedRod(system, imposed, step, moves, rates, kind, fixed, pins, lanes)
