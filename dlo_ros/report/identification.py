# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The report of an identification: the estimate, its uncertainty, and the shapes behind it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dlo_ros.report.elements import (
    UNKNOWN,
    figure,
    markup,
    measured,
    millimetres,
    number,
    paragraph,
    table,
)
from dlo_ros.report.loads import LoadRow, loads_table
from dlo_ros.report.page import Section, page, write_page
from dlo_ros.report.plots import LinePlot, ReferenceLine, Series, line_plot
from dlo_ros.report.shape_player import ShapeFrame, player
from dlo_ros.report.uncertainty import Ellipse, ResidualMap, ellipse_picture, residual_picture
from dlo_ros.spline import FloatArray

ROLES = {"train": "used for the fit", "validate": "not used for the fit"}
"""Roles of a recording in words."""


@dataclass(frozen=True)
class EstimateRow:
    """One parameter as it was found.

    Args:
        name: name of the parameter in words, such as "Young's modulus E".
        unit: SI unit.
        value, std: estimate and its standard deviation in that unit; None where unknown or
            unbounded.
        true: the truth where it is known.
        identifiable: whether the data determine it; None where nobody asked.
    """

    name: str
    unit: str
    value: float | None
    std: float | None
    true: float | None = None
    identifiable: bool | None = None


@dataclass(frozen=True)
class ParameterTrack:
    """The estimate of one parameter over time or iterations.

    Args:
        name, unit: name and unit as in `EstimateRow`.
        times: [s], or the number of the iteration, shape (m,).
        values, std: estimates and their standard deviations in the unit, shape (m,); an unknown std
            is NaN.
        true: the truth where it is known.
    """

    name: str
    unit: str
    times: FloatArray
    values: FloatArray
    std: FloatArray
    true: float | None = None


@dataclass(frozen=True)
class RecordingRow:
    """One recording.

    Args:
        name: name of the bag.
        role: train or validate.
        length: L of the spline basis [m].
        err_initial, err: eq. (10) before and after [m]; None where not known.
        frames: the shapes in the order of time; may be empty.
        residuals: map of the residuals along the DLO and in time; None where not known.
    """

    name: str
    role: str
    length: float
    err_initial: float | None
    err: float | None
    frames: tuple[ShapeFrame, ...] = ()
    residuals: ResidualMap | None = None


@dataclass(frozen=True)
class IdentificationReport:
    """The contents of the report.

    Args:
        title: text of the heading.
        headline: the result in one line.
        estimates: the estimated parameters.
        recordings: the recordings that the estimate comes from.
        tracks: estimates over time or iterations; may be empty.
        track_label: label of the axis over which the tracks are drawn, with its unit.
        noise_floor: the ERR that a perfect model would have [m]; None where not known.
        remarks: sentences for the reader, such as on what the data do not determine.
        ellipses: pairs of parameters and their common uncertainty; may be empty.
        not_drawn: sentences on pairs without an ellipse, since a parameter is not known.
        loads: loads on the DLO in the recordings; may be empty.
        explained: whether the remarks already say what the data do not determine.
        cameras: positions [m] of the cameras that have names, which the view in space shows.
    """

    title: str
    headline: str
    estimates: tuple[EstimateRow, ...]
    recordings: tuple[RecordingRow, ...]
    tracks: tuple[ParameterTrack, ...] = ()
    track_label: str = "time [s]"
    noise_floor: float | None = None
    remarks: tuple[str, ...] = ()
    ellipses: tuple[Ellipse, ...] = ()
    loads: tuple[LoadRow, ...] = ()
    cameras: Mapping[str, FloatArray] = field(default_factory=dict)
    explained: bool = False
    not_drawn: tuple[str, ...] = ()


def write_identification_report(path: Path | str, report: IdentificationReport) -> None:
    """Write a report as one HTML file that needs nothing else.

    Raises:
        InputError: a shape in it is not finite.
        OSError: the file cannot be written.
    """
    write_page(path, identification_page(report))


def identification_page(report: IdentificationReport) -> str:
    """The report as an HTML document."""
    summary = f'<p class="headline">{markup(report.headline)}</p>'
    sections = [Section("What was found", _estimates(report))]
    several = len(report.recordings) > 1
    shapes = "".join(_shapes(r, several, report.cameras) for r in report.recordings)
    if shapes:
        sections.append(Section("Observed and predicted shape", shapes))
    maps = "".join(_residuals(r) for r in report.recordings if r.residuals is not None)
    if maps:
        sections.append(Section("Residuals along the DLO and in time", maps))
    if report.ellipses or report.not_drawn:
        sections.append(Section("Uncertainty of pairs", _ellipses(report)))
    if any(r.frames for r in report.recordings):
        sections.append(Section("ERR over time", _err(report)))
    if report.tracks:
        sections.append(Section("Parameters over time", _tracks(report)))
    if report.recordings:
        sections.append(Section("Recordings", _recordings(report)))
    if report.loads:
        sections.append(Section("Largest loads in the recordings", loads_table(report.loads)))
    return page(report.title, summary, sections)


def _estimates(report: IdentificationReport) -> str:
    truth = any(e.true is not None for e in report.estimates)
    headers = ["parameter", "estimate +- std", "determined by the data"]
    if truth:
        headers += ["true value", "error"]
    rows = []
    for e in report.estimates:
        row = [e.name, measured(e.value, e.std, e.unit), _yes_no(e.identifiable)]
        if truth:
            row += [number(e.true, e.unit), _error(e)]
        rows.append(row)
    text = "".join(paragraph(r) for r in (*_plain_words(report), *report.remarks))
    return table(headers, rows) + text


def _plain_words(report: IdentificationReport) -> list[str]:
    """Meaning of the flags, in a sentence."""
    weak = [e.name for e in report.estimates if e.identifiable is False]
    if not weak or report.explained:
        return []
    verb = "is" if len(weak) == 1 else "are"
    return [
        f"{' and '.join(weak)} {verb} not determined by these data: many values explain them "
        "equally well, so the number shown leans on what was given beforehand. A known force "
        "(a weighing, a known drag, a hung mass) would settle it."
    ]


def _yes_no(flag: bool | None) -> str:
    return UNKNOWN if flag is None else ("yes" if flag else "no")


def _error(estimate: EstimateRow) -> str:
    if estimate.true is None or estimate.value is None or estimate.true == 0.0:
        return UNKNOWN
    return f"{100.0 * (estimate.value / estimate.true - 1.0):+.2f} %"


def _shapes(recording: RecordingRow, several: bool, cameras: Mapping[str, FloatArray]) -> str:
    if not any(f.observed is not None or f.predicted is not None for f in recording.frames):
        return ""
    heading = _heading(recording) if several else ""
    caption = "Observed: the measured spline; predicted: the simulated one at the same instant"
    if any(f.initial is not None for f in recording.frames):
        caption += "; predicted at first: with the initial guess"
    caption += "."
    if len(recording.frames) > 1:
        caption += " Move the slider through the recording."
    return heading + figure(player(recording.frames, recording.length, cameras=cameras), caption)


def _heading(recording: RecordingRow) -> str:
    return f"<h3>{markup(f'{recording.name} ({_role(recording)})')}</h3>"


def _role(recording: RecordingRow) -> str:
    return ROLES.get(recording.role, recording.role)


def _residuals(recording: RecordingRow) -> str:
    assert recording.residuals is not None
    sides = ": to the left of growing u in one colour, to the right in the other"
    caption = (
        f"Observed beside predicted, across the DLO{sides if recording.residuals.signed else ''}. "
        "Noise is a fine grain; stripes and patches are what the model misses."
    )
    return _heading(recording) + figure(residual_picture(recording.residuals), caption)


def _ellipses(report: IdentificationReport) -> str:
    caption = "Solid: one standard deviation; dashed: two. A slanted, thin ellipse is a trade."
    pictures = "".join(figure(ellipse_picture(e), caption) for e in report.ellipses)
    return pictures + "".join(map(paragraph, report.not_drawn))


def _err(report: IdentificationReport) -> str:
    colours = ("observed", "predicted", "other", "ink")
    series = []
    for k, recording in enumerate(report.recordings):
        frames = [f for f in recording.frames if f.err is not None]
        if not frames:
            continue
        times = np.array([f.time for f in frames])
        err = np.array([f.err for f in frames], dtype=float)
        series.append(
            Series(
                recording.name,
                colours[k % len(colours)],
                times,
                1e3 * err,
                line="--" if recording.role == "validate" else "-",
            )
        )
    levels: tuple[ReferenceLine, ...] = ()
    if report.noise_floor is not None and math.isfinite(report.noise_floor):
        levels = (ReferenceLine("noise floor", "true", 1e3 * report.noise_floor),)
    plot = LinePlot("err", "time [s]", "ERR [mm]", tuple(series), levels)
    caption = (
        "Mean distance between the observed and the predicted spline, eq. (10) of the paper. "
        "A perfect model would stay at the noise floor."
    )
    return figure(line_plot(plot), caption)


def _tracks(report: IdentificationReport) -> str:
    return "".join(_track(k, t, report.track_label) for k, t in enumerate(report.tracks))


def _track(k: int, track: ParameterTrack, x_label: str) -> str:
    positive = bool(np.all(track.values > 0.0))
    # A positive parameter is uncertain by a factor: the band is that of its logarithm.
    relative = np.clip(track.std / np.abs(track.values), 0.0, 50.0) if positive else track.std
    lower = track.values * np.exp(-relative) if positive else track.values - relative
    upper = track.values * np.exp(relative) if positive else track.values + relative
    series = Series("estimate, band: 1 std", "observed", track.times, track.values, lower, upper)
    if not np.isfinite(track.std).any():
        series = Series("estimate, std unknown", "observed", track.times, track.values)
    levels = () if track.true is None else (ReferenceLine("true value", "true", track.true),)
    label = f"{track.name} [{track.unit}]"
    plot = LinePlot(f"track{k}", x_label, label, (series,), levels, logarithmic=positive)
    last = measured(float(track.values[-1]), float(track.std[-1]), track.unit)
    return figure(line_plot(plot), f"{track.name}: {last} at the end.")


def _recordings(report: IdentificationReport) -> str:
    rows = [
        [r.name, _role(r), millimetres(r.err_initial), millimetres(r.err), _share(r)]
        for r in report.recordings
    ]
    headers = ["recording", "role", "ERR at first", "ERR at the end", "of the length"]
    floor = report.noise_floor
    text = "" if floor is None else paragraph(f"Noise floor: {millimetres(floor)}.")
    return table(headers, rows) + text


def _share(recording: RecordingRow) -> str:
    if recording.err is None:
        return UNKNOWN
    return f"{100.0 * recording.err / recording.length:.2f} %"
