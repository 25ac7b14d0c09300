# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A measured wire from its coordinates to a report: bags, `identify`, `diagnose`, a picture.

Two of three shapes are learned from; the third one is only predicted.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import webbrowser
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from convert import convert, read_points
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dlo_ros.cli.effect_words import mm
from dlo_ros.cli.loading import load_manipulation
from dlo_ros.cli.main import main as dlo_ros
from dlo_ros.errors import DloError
from dlo_ros.inference.forecast import forecast
from dlo_ros.parameters import Settings
from dlo_ros.report.plots import COLOURS, STYLE
from dlo_ros.spline import FloatArray, SplineBasis

WIRE = Path(__file__).resolve().parent / "white"
LEARNED, KEPT = ("trial0", "trial1"), "trial2"
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


def run(output: Path, *, show: bool = True) -> int:
    """Do all of it; returns the exit status of the first tool that fails, else 0.

    Args:
        output: folder for bags, results and the picture.
        show: whether the report is opened where there is a display.

    Raises:
        DloError: a file is unusable.
    """
    params, bags = WIRE / "params.yaml", output / "recordings"
    settings = Settings.load(params)
    for trial in (*LEARNED, KEPT):
        convert(WIRE, trial, settings, bags / trial)
        print(f"{bags / trial}: a bag of {WIRE.name}/{trial}.csv")
    learned = [str(bags / t) for t in LEARNED]
    for tool, aside in (("identify", "--validate"), ("diagnose", "--holdout")):
        words = [tool, "--params", str(params), "--output", str(output / tool)]
        words += [aside, str(bags / KEPT), *learned]
        print(f"\n$ dlo_ros {' '.join(words)}", flush=True)
        status = dlo_ros(words)
        if status:
            return status
    draw(output)
    print(f"\n{output / 'real_wire.png'}: {KEPT}, which no fit has seen, measured and predicted")
    _open(output / "diagnose" / "report.html", show)
    return 0


def draw(output: Path) -> None:
    """The held-out shape, as measured and as predicted without and with the causes.

    ERR is that of the reports: the mean distance between the splines, all along the wire. That of
    the dots, which are nearer to each other in some places, is another by a percent or two.
    """
    u, points = read_points(WIRE / f"{KEPT}.csv")
    report = json.loads((output / "diagnose" / "report.json").read_text())
    extended = Settings.load(output / "diagnose" / "extended.yaml")
    models = (
        ("plain model", "baseline", _plain(report), "predicted", "--"),
        ("extended model", "extended", extended, "true", "-"),
    )
    with rc_context(STYLE):
        figure = Figure(figsize=(9.0, 4.6), layout="constrained", dpi=110)
        left, right = figure.subplots(1, 2, width_ratios=(0.6, 1.0))
        for label, key, settings, colour, style in models:
            shape, distance = _predicted(output, settings, u, points)
            words = f"{label}: ERR {mm(report[key]['err_holdout'])}"
            left.plot(1e3 * shape[:, 0], 1e3 * shape[:, 2], style, color=COLOURS[colour])
            right.plot(1e3 * u, 1e3 * distance, style, color=COLOURS[colour], label=words)
        left.plot(1e3 * points[:, 0], 1e3 * points[:, 2], ".", color=COLOURS["observed"])
        _label(left, "x [mm]", "z [mm]", "Dots: measured")
        left.set_aspect("equal", adjustable="datalim")
        _label(
            right,
            "u along the wire [mm]",
            "distance from the dots [mm]",
            f"{KEPT}, which no fit has seen",
        )
        right.set_ylim(0.0, 1.2 * right.get_ylim()[1])  # room for the legend
        right.legend()
        figure.savefig(output / "real_wire.png")


def _plain(report: dict[str, Any]) -> Settings:
    """The set-up as stated, with the material that fits best without any cause.

    Args:
        report: content of report.json.
    """
    given = Settings.load(WIRE / "params.yaml")
    fitted = {k: report["baseline"][k]["value"] for k in ("young_modulus", "density")}
    return replace(given, rod=replace(given.rod, **fitted))


def _predicted(
    output: Path, settings: Settings, u: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Predicted points [m], shape (m, 3), and their distance from the measured ones [m]."""
    found = forecast(load_manipulation(output / "recordings" / KEPT, settings), settings)
    basis = SplineBasis(found.predicted.shape[1], settings.rod.length)
    shape = basis.evaluate(found.predicted[0, :, :3], u)
    return shape, np.asarray(np.linalg.norm(shape - points, axis=1))


def _label(axes: Axes, x: str, y: str, title: str) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title, fontsize=10)


def _open(report: Path, show: bool) -> None:
    """Open a report in the browser where there is a display; say where it is in any case."""
    print(f"{report}: open it in a browser")
    if show and any(map(os.environ.get, DISPLAYS)):
        webbrowser.open(report.resolve().as_uri())


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="real.py", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("build/real"))
    parser.add_argument("--no-browser", action="store_true", help="do not open the report")
    parsed = parser.parse_args(arguments)
    try:
        return run(parsed.output, show=not parsed.no_browser)
    except DloError as err:
        print(err, file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
