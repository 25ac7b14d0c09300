# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What manipulations are designed for: how one is judged, and how the result is presented."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from dlo_ros.identification.batched_forecast import forecast_each
from dlo_ros.identification.design.expected_information import Plan
from dlo_ros.identification.design.manipulation_search import Judged
from dlo_ros.parameters import Settings
from dlo_ros.report.design import Panel
from dlo_ros.spline import FloatArray, SplineBasis

PANELS = 4
"""Instants that the report shows."""
PANEL_POINTS = 60
"""Points of a curve in it."""

Result = TypeVar("Result", bound=Judged)


@dataclass(frozen=True)
class PresentedExperiment:
    """One manipulation of a ranking.

    Args:
        name: name of the manipulation, for people.
        numbers: entries of design.json.
        cells: entries of the report's ranking.
        reason: the reason for its rank.
        panels: instants to show; may be empty.
    """

    name: str
    numbers: dict[str, Any]
    cells: tuple[str, ...]
    reason: str
    panels: tuple[Panel, ...]


@dataclass(frozen=True)
class Presentation:
    """A ranking for people and programs.

    Args:
        experiments: manipulations, the best first.
        headline: the result in a sentence.
        lines: the ranking on the terminal.
        title, headers, caption, remarks: see `DesignReport`.
        numbers: further entries of design.json.
    """

    experiments: tuple[PresentedExperiment, ...]
    headline: str
    lines: tuple[str, ...]
    title: str
    headers: tuple[str, ...]
    caption: str
    remarks: tuple[str, ...]
    numbers: dict[str, Any]


class Purpose(Protocol[Result]):
    """What manipulations are designed for."""

    @property
    def what(self) -> str:
        """What the best manipulation is, in words."""

    @property
    def finalists(self) -> int:
        """Number of candidates of a search that are simulated finely in the end."""

    def judge(self, plan: Plan, spans: int | None) -> Result:
        """Expected result of a plan; None spans: as simulation.tolerance asks."""

    def presented(self, ranking: Sequence[Result]) -> Presentation:
        """A ranking, the best first, for people and programs."""


def panels(plan: Plan, sets: Sequence[Settings]) -> tuple[Panel, ...]:
    """Instants of a manipulation with several settings of one DLO."""
    slow = replace(plan, rate=max((PANELS - 1) / max(plan.duration, 1e-3), 0.1))
    found = forecast_each(slow.manipulation(), sets)
    shapes = [f.predicted for f in found if f is not None]
    if len(shapes) < len(sets):
        return ()
    frames = range(min(len(s) for s in shapes))
    return tuple(panel(k / slow.rate, [s[k] for s in shapes], sets[0]) for k in frames)


def panel(time: float, shapes: Sequence[FloatArray], settings: Settings) -> Panel:
    """One instant of a few shapes.

    Args:
        time: [s].
        shapes: control points [m], shape (n, 3 or more) each.
        settings: settings of the rod.
    """
    basis = SplineBasis(settings.rod.control_points, settings.rod.length)
    matrix = basis.matrix(np.linspace(0.0, basis.length, PANEL_POINTS))
    return Panel(time, tuple(matrix @ s[:, [0, 2]] for s in shapes))
