# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Figures over time as SVG that stands in the page and follows its light or dark colours."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, MaxNLocator

from dlo_ros.report.elements import typeset
from dlo_ros.spline import FloatArray

# Colours of Okabe and Ito, which most colour-blind people can distinguish. The page's style defines
# them again, brighter on a dark ground, so each is replaced by the name of its variable.
COLOURS = {
    "ink": "#333334",
    "grid": "#cccccd",
    "observed": "#0072b2",
    "predicted": "#d55e00",
    "true": "#009e73",
    "other": "#cc79a7",
}

STYLE = {
    "svg.fonttype": "none",
    "font.size": 10,
    "font.family": "sans-serif",
    "text.color": COLOURS["ink"],
    "axes.edgecolor": COLOURS["ink"],
    "axes.labelcolor": COLOURS["ink"],
    "xtick.color": COLOURS["ink"],
    "ytick.color": COLOURS["ink"],
    "grid.color": COLOURS["grid"],
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.8,
    "legend.frameon": False,
}


@dataclass(frozen=True)
class Series:
    """One curve.

    Args:
        label: name of the curve in the legend.
        colour: a key of `COLOURS`.
        x, y: shape (m,); NaN leaves a gap.
        lower, upper: edges of a band around it, shape (m,).
        line: solid, dashed or dotted, so that curves can be distinguished without colours.
        wide: whether it is wide and pale, so that it is seen beneath a curve that covers it.
    """

    label: str
    colour: str
    x: FloatArray
    y: FloatArray
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    line: Literal["-", "--", ":"] = "-"
    wide: bool = False


@dataclass(frozen=True)
class ReferenceLine:
    """A horizontal line, such as a true value or the noise floor."""

    label: str
    colour: str
    y: float


@dataclass(frozen=True)
class LinePlot:
    """Curves over one axis.

    Args:
        name: unique on the page.
        x_label, y_label: labels of the axes, with units.
        series: the curves.
        levels: horizontal lines.
        logarithmic: whether y is; it then shows whole decades only where the data span some.
    """

    name: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    levels: tuple[ReferenceLine, ...] = ()
    logarithmic: bool = False
    size: tuple[float, float] = field(default=(6.4, 2.7))


class PlainLogFormatter(LogFormatterSciNotation):
    """Numbers at a logarithmic axis: powers of ten only where 0.5 or 200 would be hard to read."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Label of a value; empty: it has none."""
        text = str(super().__call__(x, pos))
        return f"{x:g}" if text and 1e-3 <= x < 1e5 else text


def line_plot(plot: LinePlot) -> str:
    """The figure as an SVG element without any reference to the outside."""
    with rc_context(STYLE):
        figure = Figure(figsize=plot.size, layout="constrained")
        axes = figure.add_subplot()
        for series in plot.series:
            colour = COLOURS[series.colour]
            look: dict[str, Any] = {"linewidth": 4.5, "alpha": 0.5} if series.wide else {}
            axes.plot(series.x, series.y, series.line, color=colour, label=series.label, **look)
            if series.lower is not None and series.upper is not None:
                axes.fill_between(
                    series.x, series.lower, series.upper, color=colour, alpha=0.2, linewidth=0
                )
        for level in plot.levels:
            axes.axhline(level.y, color=COLOURS[level.colour], linestyle="-.", label=level.label)
        if plot.logarithmic:
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(PlainLogFormatter())
            axes.yaxis.set_minor_formatter(PlainLogFormatter(minor_thresholds=(1.2, 0.4)))
        else:
            axes.yaxis.set_major_locator(MaxNLocator(nbins=5))
        limits = _limits(plot)
        if limits is not None:
            axes.set_ylim(*limits)
        if all(np.nanmin(s.x, initial=0.0) >= 0.0 for s in plot.series):
            axes.set_xlim(left=0.0)
        axes.set_xlabel(typeset(plot.x_label))
        axes.set_ylabel(typeset(plot.y_label))
        if len(plot.series) + len(plot.levels) > 1:
            # Above the axes it covers no curve.
            axes.legend(
                loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=9, borderaxespad=0.0,
                ncols=len(plot.series) + len(plot.levels),
            )  # fmt: skip
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", transparent=True)
    return _embed(buffer.getvalue(), plot)


def _limits(plot: LinePlot) -> tuple[float, float] | None:
    """Room for curves and levels; a band that has no bounds yet must not squeeze them."""
    parts = [s.y for s in plot.series] + [np.array([level.y]) for level in plot.levels]
    values = np.concatenate(parts) if parts else np.zeros(0)
    values = values[np.isfinite(values)]
    if plot.logarithmic:
        values = values[values > 0.0]
    if not len(values):
        return None
    low, high = float(values.min()), float(values.max())
    if plot.logarithmic:
        margin = max(high / low, 1.3) ** 0.12
        return low / margin, high * margin
    margin = 0.12 * ((high - low) or abs(high) or 1.0)
    return (0.0 if low >= 0.0 else low - margin), high + margin


def _embed(svg: str, plot: LinePlot) -> str:
    """Make a matplotlib file an element of the page: own ids, named colours, no addresses."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg)
    svg = re.sub(r'\bid="', f'id="{plot.name}-', svg)
    svg = svg.replace("url(#", f"url(#{plot.name}-").replace('href="#', f'href="#{plot.name}-')
    for name, colour in COLOURS.items():
        svg = svg.replace(colour, f"var(--{name})")
    # The width follows the page's column.
    view_box = re.compile(r'<svg[^>]*?viewBox="([^"]*)"[^>]*>')
    return view_box.sub(r'<svg viewBox="\1" role="img">', svg, count=1).strip()
