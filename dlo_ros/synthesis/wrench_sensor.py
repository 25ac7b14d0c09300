# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Errors of simulated force-torque sensors at the grips."""

from __future__ import annotations

from dataclasses import dataclass

from dlo_ros.synthesis.experiment_block import ExperimentBlock


@dataclass(frozen=True)
class WrenchSensor:
    """Force-torque sensors at the grips.

    Args:
        rate: rate of measurements [Hz].
        force_std, torque_std: white noise [N; N m].
        force_bias_std, torque_bias_std: standard deviations of the constant offset of each
            component [N; N m].
        delay: delay by which a measurement is stamped too late [s].
        tool_mass: mass between sensor and DLO, tared at rest [kg].
    """

    rate: float = 100.0
    force_std: float = 0.0
    torque_std: float = 0.0
    force_bias_std: float = 0.0
    torque_bias_std: float = 0.0
    delay: float = 0.0
    tool_mass: float = 0.0

    @classmethod
    def read(cls, section: ExperimentBlock) -> WrenchSensor:
        """From the block `wrench` of an experiment file."""
        return cls(
            rate=section.number("rate", cls.rate, 1.0, 1e4),
            force_std=section.number("force_std", cls.force_std, 0.0, 1e6),
            torque_std=section.number("torque_std", cls.torque_std, 0.0, 1e6),
            force_bias_std=section.number("force_bias_std", cls.force_bias_std, 0.0, 1e6),
            torque_bias_std=section.number("torque_bias_std", cls.torque_bias_std, 0.0, 1e6),
            delay=section.number("delay", cls.delay, -1.0, 1.0),
            tool_mass=section.number("tool_mass", cls.tool_mass, 0.0, 1e3),
        )

    @classmethod
    def usual(cls, weight: float, length: float) -> WrenchSensor:
        """One with noise of 1 % and an offset of 5 % of a weight [N] that hangs at a length [m].

        A sensor's torques are about as good as its forces at a tenth of the DLO's length.
        """
        lever = 0.1 * length
        return cls(
            force_std=0.01 * weight, torque_std=0.01 * weight * lever,
            force_bias_std=0.05 * weight, torque_bias_std=0.05 * weight * lever,
        )  # fmt: skip
