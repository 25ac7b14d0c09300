# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How an example reports: one line on the terminal and one picture."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure

OURS, EXACT, FAINT = "#1f6fb4", "#d1495b", "#9aa5b1"
rcParams.update(
    {
        "font.size": 11,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": "#e6e9ed",
        "legend.frameon": False,
    }
)


@dataclass(frozen=True)
class Result:
    """What every example returns.

    Args:
        summary: one line of text: the two results that were compared, and their difference.
        error: the error that the line states.
    """

    summary: str
    error: float


def canvas(columns: int = 2, projections: tuple[str | None, ...] | None = None) -> list[Any]:
    """Axes side by side in one figure."""
    figure = Figure(figsize=(5.6 * columns, 4.4), layout="constrained", dpi=110)
    kinds = projections or (None,) * columns
    axes: list[Any] = [
        figure.add_subplot(1, columns, k + 1, projection=kind) for k, kind in enumerate(kinds)
    ]
    for space in (a for a, kind in zip(axes, kinds, strict=True) if kind == "3d"):
        space.yaxis.labelpad = space.zaxis.labelpad = 9.0
    return axes


def save(axes: Axes, path: Path, title: str) -> None:
    """Write the figure that the axes belong to, in the format of the path's suffix."""
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    figure.suptitle(title)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def main(run: Callable[[], Any], plot: Callable[[Any, Path], None]) -> None:
    """Run an example as a program: `python examples/NAME.py [PICTURE]`."""
    name = Path(sys.argv[0]).stem
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("build", "examples", f"{name}.png")
    result = run()
    plot(result, path)
    print(f"{name}: {result.summary} ({path})")
