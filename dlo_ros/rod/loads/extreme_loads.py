# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The largest loads on a DLO and its grips in a whole motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dlo_ros.rod.loads.grip_reactions import Loading, Wrench
from dlo_ros.rod.loads.load_limits import BEND_RADIUS, TENSION, load_warnings
from dlo_ros.rod_settings import LimitParameters

ALMOST_STRAIGHT = 1e4
"""Bend radius [m] beyond which it is no use to a person: a rope of 1 m is then off by 13 um."""


@dataclass(frozen=True)
class Extremes:
    """The instants of the largest loads on a DLO.

    Args:
        loadings: loads at all instants, at least one.
        times: times of the instants [s].
    """

    loadings: Sequence[Loading]
    times: Sequence[float]

    @property
    def pulled(self) -> int:
        """Index of the instant of the largest tension."""
        return int(np.argmax([x.tension for x in self.loadings]))

    @property
    def bent(self) -> int:
        """Index of the instant of the smallest bend radius."""
        return int(np.argmin([x.bend_radius for x in self.loadings]))

    def held(self, end: str) -> int | None:
        """Index of the instant of the largest force at `start` or `end`; None: free end."""
        sizes = [_size(getattr(x, end)) for x in self.loadings]
        return int(np.argmax(sizes)) if max(sizes) >= 0.0 else None

    @property
    def numbers(self) -> dict[str, float | None]:
        """The extremes by name and unit; None for the force of an end that stays free."""
        result: dict[str, float | None] = {
            "tension [N]": self.loadings[self.pulled].tension,
            "bend radius [m]": self.loadings[self.bent].bend_radius,
        }
        for end in ("start", "end"):
            result[f"force {end} [N]"] = self.largest_force(end)
        return result

    def largest_force(self, end: str) -> float | None:
        """Largest force of the grip at `start` or `end` [N]; None: that end stays free."""
        k = self.held(end)
        return None if k is None else _size(getattr(self.loadings[k], end))

    def sentences(self, limits: LimitParameters) -> list[str]:
        """Lines on the extremes, then on the limits that are near or passed."""
        pulled, bent = self.loadings[self.pulled], self.loadings[self.bent]
        lines = [
            f"largest tension {pulled.tension:.3g} N at u = {pulled.tension_at:.3g} m, "
            f"{self.times[self.pulled]:.2f} s; smallest bend radius {radius_text(bent)} at "
            f"u = {bent.bend_at:.3g} m, {self.times[self.bent]:.2f} s"
        ]
        grips = []
        for end, place in (("start", "0"), ("end", "L")):
            k = self.held(end)
            if k is not None:
                wrench = getattr(self.loadings[k], end)
                grips.append(
                    f"{_size(wrench):.3g} N and {np.linalg.norm(wrench.torque):.3g} N m at u = "
                    f"{place}, {self.times[k]:.2f} s"
                )
        if grips:
            lines.append(f"largest force of a grip on the DLO: {'; '.join(grips)}")
        return lines + self.alarms(limits)

    def alarms(self, limits: LimitParameters) -> list[str]:
        """The limits that are near or passed, each at its worst instant, with the duration."""
        lines = []
        for name, k in ((TENSION, self.pulled), (BEND_RADIUS, self.bent)):
            for strain in load_warnings(self.loadings[k], limits):
                if strain.name == name:
                    passed = [_passed(x, limits, name) for x in self.loadings]
                    often = f" (passed at {sum(passed)} of {len(passed)} instants)"
                    text = f"{strain.text}, at {self.times[k]:.2f} s"
                    lines.append(text + (often if any(passed) else ""))
        return lines


def _passed(loading: Loading, limits: LimitParameters, name: str) -> bool:
    return any(s.passed and s.name == name for s in load_warnings(loading, limits))


def radius_text(loading: Loading) -> str:
    """A bend radius as text."""
    radius = loading.bend_radius
    if radius > ALMOST_STRAIGHT:
        return "infinite (straight)"
    return f"{1e3 * radius:.3g} mm" if radius < 1.0 else f"{radius:.3g} m"


def _size(wrench: Wrench | None) -> float:
    return -1.0 if wrench is None else float(np.linalg.norm(wrench.force))
