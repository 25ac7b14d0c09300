# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Maps over the position along the DLO and time, as pictures that stand in the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from dlo_ros.report.elements import typeset
from dlo_ros.report.plots import STYLE
from dlo_ros.spline import FloatArray

PIXELS = 600
"""Width of a map on the page at most."""


def field_maps(
    titles: Sequence[str], times: FloatArray, u: FloatArray, fields: Sequence[FloatArray],
    label: str, largest: float | None = None, *, signed: bool = True,
) -> str:  # fmt: skip
    """Maps beside one another with one colour scale, as an HTML image.

    Args:
        titles: titles of the maps.
        times: [s], shape (F,).
        u: material coordinates [m], shape (U,).
        fields: values, each of shape (F, U).
        label: label of the colour scale, with the unit.
        largest: end of the colour scale; default: what 99 of 100 values stay below.
        signed: whether values have a sign.
    """
    values = np.abs(np.concatenate([f.ravel() for f in fields]))
    values = values[np.isfinite(values)]
    found = float(np.percentile(values, 99.0)) if len(values) else 1.0
    bound = largest or max(found, 1e-12)
    colours, least = ("RdBu_r", -bound) if signed else ("Reds", 0.0)
    with rc_context({**STYLE, "axes.grid": False}):
        # Margins that are known spare a layout engine, which draws everything twice.
        width, height = 4.4 * len(fields) + 0.6, 2.9
        figure = Figure(figsize=(width, height), dpi=110)
        figure.set_facecolor("white")
        figure.subplots_adjust(0.75 / width, 0.5 / height, 1 - 1.05 / width, 1 - 0.35 / height)
        grid = figure.add_gridspec(1, len(fields) + 1, width_ratios=[*[1.0] * len(fields), 0.03])
        grid.update(wspace=0.12)
        first = figure.add_subplot(grid[0])
        others = [figure.add_subplot(grid[k], sharey=first) for k in range(1, len(fields))]
        all_axes = [first, *others]
        for axes in others:
            axes.tick_params(labelleft=False)
        for axes, title, field in zip(all_axes, titles, fields, strict=True):
            picture = axes.pcolormesh(
                times, 1e3 * u, field.T, cmap=colours, vmin=least, vmax=bound, shading="nearest"
            )
            axes.set_title(typeset(title), fontsize=10)
            axes.set_xlabel("time [s]")
        first.set_ylabel("u along the DLO [mm]")
        pointed = "both" if signed else "max"  # there are larger ones
        beyond = pointed if np.any(values > bound) else "neither"
        cax = figure.add_subplot(grid[-1])
        figure.colorbar(picture, cax=cax, label=typeset(label), extend=beyond)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png")
    encoded = base64.b64encode(buffer.getvalue()).decode("ascii")
    text = ", ".join(titles)
    style = f"width:100%;max-width:{PIXELS * len(fields)}px"
    return f'<img alt="{text}" style="{style}" src="data:image/png;base64,{encoded}">'
