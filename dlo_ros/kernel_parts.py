# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The parts that the numerical kernels are compiled in, each by a process of its own."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Part:
    """Kernels that are compiled by one process.

    Args:
        name: name of the part.
        work: module and function, `module:function`, that touches each of the kernels.
        seconds: processor time of the compilation on a desktop [s], which only weighs the stages.
        functions: number of functions that are compiled and kept. The parts of a stage share some,
            most of which are compiled by the first that needs them: only their sum is known.
    """

    name: str
    work: str
    seconds: float
    functions: int


STAGES: dict[str, tuple[Part, ...]] = {
    "rod": (
        Part("rod_statics", "dlo_ros.rod.compile_rod:compile_statics", 40.0, 188),
        Part("rod_dynamics", "dlo_ros.rod.compile_rod:compile_dynamics", 40.0, 189),
    ),
    "vision": (Part("vision", "dlo_ros.vision.compile_vision:compile_kernels", 18.0, 47),),
    "synthesis": (
        Part("synthesis", "dlo_ros.synthesis.compile_synthesis:compile_kernels", 14.0, 29),
    ),
}
"""What a node or tool may ask for; each part of a stage is of that stage alone."""
