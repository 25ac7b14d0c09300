# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The four tasks of the comparison, as data.

All DLOs start straight and at rest, under gravity. Where only the settled shape counts, every
side chooses its damping itself; where the motion counts, the damping is part of the task.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dlo_ros.parameters import RodParameters
from dlo_ros.spline import FloatArray

GRAVITY = 9.81  # [m/s^2]
POINTS = 200  # Gauss points at which shapes are compared


@dataclass(frozen=True)
class Task:
    """One simulation.

    Args:
        name: the task's name in the table.
        rod: material and geometry.
        duration: simulated time [s].
        approach: distance by which each end moves towards the other within the first second [m].
        both_ends: whether the end is clamped, too; both clamps are horizontal.
        samples: instants that are compared [s]; one, at the end, where the settled shape counts.
        relaxation_time: Kelvin-Voigt damping that belongs to the task [s]; None: free choice.
        air_drag: external drag that belongs to the task [N s/m^2], for simulators that know no
            Kelvin-Voigt damping; their reference has the same.
        levels: errors that must be reached, of L.
    """

    name: str
    rod: RodParameters
    duration: float
    levels: tuple[float, ...]
    approach: float = 0.0
    both_ends: bool = False
    samples: tuple[float, ...] = ()
    relaxation_time: float | None = None
    air_drag: float | None = None

    @property
    def instants(self) -> tuple[float, ...]:
        """The instants that are compared [s]."""
        return self.samples or (self.duration,)

    @property
    def moving(self) -> bool:
        """Whether the motion counts, not only the settled shape."""
        return bool(self.samples)

    @property
    def span(self) -> float:
        """Distance of the clamps at the end [m]."""
        return self.rod.length - 2.0 * self.approach

    def with_material(self, stiffer: float, denser: float) -> Task:
        """The task with E and density multiplied."""
        rod = replace(
            self.rod,
            young_modulus=stiffer * self.rod.young_modulus,
            density=denser * self.rod.density,
        )
        return replace(self, rod=rod)

    @property
    def quadrature(self) -> tuple[FloatArray, FloatArray]:
        """Material coordinates [m] at which shapes are compared, and weights that sum to 1."""
        x, w = np.polynomial.legendre.leggauss(POINTS)
        return 0.5 * self.rod.length * (x + 1.0), 0.5 * w

    def error(self, curves: FloatArray, reference: FloatArray) -> float:
        """Mean distance over L, over rod and instants; curves are (S, POINTS, 2)."""
        apart = np.linalg.norm(curves - reference, axis=2)
        value = float(np.mean(apart @ self.quadrature[1])) / self.rod.length
        return value if np.isfinite(value) else np.inf


_THIN = RodParameters(0.4, 0.004, 5e7, 2500.0)
_THICK = RodParameters(0.8, 0.008, 5e7, 2500.0)
_SOFT = RodParameters(0.4, 0.004, 1e6, 2000.0)

T1 = Task("T1", _THIN, 2.0, (0.01, 0.001))
T2 = Task("T2", _THICK, 2.0, (0.01, 0.001), approach=0.2, both_ends=True)
T3 = Task(
    "T3", _THIN, 3.0, (0.01,), samples=tuple(np.arange(1, 76) * 0.04), relaxation_time=0.005,
    air_drag=0.02,
)  # fmt: skip
T4 = Task("T4", _SOFT, 2.0, (0.01, 0.001), approach=0.1, both_ends=True)
TASKS = (T1, T2, T3, T4)
