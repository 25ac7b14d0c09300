# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Limits of tension and bend radius, and warnings where a load is near them."""

from __future__ import annotations

from dataclasses import dataclass

from dlo_ros.rod.loads.grip_reactions import Loading
from dlo_ros.rod_settings import LimitParameters

TENSION, BEND_RADIUS = "limits.tension", "limits.bend_radius"
NEAR = 0.9
"""Share of a limit from which there is a warning: about what E, density and the simulation's
own tolerance leave open."""


@dataclass(frozen=True)
class LoadWarning:
    """A limit that is near or passed.

    Args:
        name: name of the parameter that sets the limit.
        passed: whether it is passed; otherwise it is near.
        text: value, place and limit, one line.
    """

    name: str
    passed: bool
    text: str


def load_warnings(loading: Loading, limits: LimitParameters) -> list[LoadWarning]:
    """The limits that a load nears or passes."""
    found = []
    if limits.tension > 0.0 and loading.tension > NEAR * limits.tension:
        passed = loading.tension > limits.tension
        found.append(
            LoadWarning(
                TENSION,
                passed,
                f"tension {loading.tension:.3g} N at u = {loading.tension_at:.3g} m is "
                f"{'beyond' if passed else 'near'} {TENSION}, {limits.tension:g} N",
            )
        )
    if limits.bend_radius > 0.0 and loading.bend_radius < limits.bend_radius / NEAR:
        passed = loading.bend_radius < limits.bend_radius
        found.append(
            LoadWarning(
                BEND_RADIUS,
                passed,
                f"bend radius {1e3 * loading.bend_radius:.3g} mm at u = {loading.bend_at:.3g} m is "
                f"{'below' if passed else 'near'} {BEND_RADIUS}, {1e3 * limits.bend_radius:g} mm",
            )
        )
    return found
