# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The report of a diagnosis: what is wrong, why, what it gains to know, and what to do next."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dlo_ros.report.elements import (
    figure,
    markup,
    measured,
    millimetres,
    number,
    paragraph,
    table,
)  # fmt: skip
from dlo_ros.report.maps import field_maps
from dlo_ros.report.page import Section, page, write_page
from dlo_ros.report.player import ShapeFrame, player
from dlo_ros.report.plots import Level, LinePlot, Series, line_plot
from dlo_ros.spline import FloatArray


@dataclass(frozen=True)
class FoundParameter:
    """A number of an effect; std None where unknown."""

    name: str
    value: float
    std: float | None
    unit: str


@dataclass(frozen=True)
class FoundEffect:
    """A named cause.

    Args:
        name: of the effect.
        meaning: in plain words.
        parameters: its numbers.
        rivals: what explains the data as well.
    """

    name: str
    meaning: str
    parameters: tuple[FoundParameter, ...]
    rivals: tuple[str, ...]


@dataclass(frozen=True)
class Ranked:
    """A candidate: ERR on what was kept aside [m], score (lower is better), what it leaves over."""

    name: str
    err_holdout: float | None
    score: float
    structure: float


@dataclass(frozen=True)
class MaterialRow:
    """A material parameter without and with the named causes: value and std (None: unknown)."""

    name: str
    unit: str
    before: tuple[float, float | None]
    after: tuple[float, float | None]


@dataclass(frozen=True)
class DiagnosedRecording:
    """One recording before and after.

    Args:
        name, role: of the recording.
        length: L of the spline basis [m].
        times: [s], shape (F,).
        observed, before, after: control points [m], shape (F, n, 3 or 4).
        err_before, err_after: eq. (10), shape (F,) [m].
        u: of the maps [m], shape (U,).
        field_before, field_after: distance across the DLO over the noise, shape (F, U).
        force, force_std: the missing force, x and z [N/m], shape (F, U, 2), or None.
    """

    name: str
    role: str
    length: float
    times: FloatArray
    observed: FloatArray
    before: FloatArray
    after: FloatArray
    err_before: FloatArray
    err_after: FloatArray
    u: FloatArray
    field_before: FloatArray
    field_after: FloatArray
    force: FloatArray | None
    force_std: FloatArray | None


@dataclass(frozen=True)
class DiagnosisReport:
    """All that the report shows; lengths in m."""

    headline: str
    verdict: str
    effects: tuple[FoundEffect, ...]
    ranking: tuple[Ranked, ...]
    material: tuple[MaterialRow, ...]
    recordings: tuple[DiagnosedRecording, ...]
    noise_floor: float | None
    err_holdout: tuple[float | None, float | None]
    gain: tuple[float, float, float] | None
    advice: str
    remarks: tuple[str, ...]


def write_diagnosis_report(path: Path | str, report: DiagnosisReport) -> None:
    """Write a report as one HTML file that needs nothing else.

    Raises:
        InputError: a shape in it is not finite.
        OSError: the file cannot be written.
    """
    write_page(path, diagnosis_page(report))


def diagnosis_page(report: DiagnosisReport) -> str:
    """The report as an HTML document."""
    summary = f'<p class="headline">{markup(report.headline)}</p>' + paragraph(report.advice)
    sections = [Section("Where and when the plain model is wrong", _maps(report))]
    if report.effects:
        sections.append(Section("The cause", "".join(_cause(e) for e in report.effects)))
    sections.append(Section("Before and after", _before_and_after(report)))
    if len(report.ranking) > 1:
        sections.append(Section("All that was tried", _ranking(report)))
    sections.append(Section("Material", _material(report)))
    return page("Diagnosis", summary, sections)


def _maps(report: DiagnosisReport) -> str:
    parts = []
    changed = bool(report.effects)
    for r in report.recordings:
        parts.append(f"<h3>{markup(f'{r.name} ({r.role})')}</h3>")
        titles = ["plain model", "extended model"][: 2 if changed else 1]
        fields = [r.field_before, r.field_after][: 2 if changed else 1]
        parts.append(
            figure(
                field_maps(titles, r.times, r.u, fields, "distance / noise"),
                "Observed minus predicted shape across the DLO, over the noise of one picture. "
                "Noise alone looks grainy; an area of one colour is an error of the model.",
            )
        )
        if r.force is not None and r.force_std is not None and report.verdict != "adequate":
            sure = np.where(np.abs(r.force) > 2.0 * r.force_std, r.force, np.nan)
            shown = [sure[..., 0], sure[..., 1]]
            parts.append(
                figure(
                    field_maps(
                        ["to the right", "upwards"], r.times, r.u, shown, "missing force [N/m]"
                    ),
                    "The load per length that would bring the plain model onto the measurement "
                    "(a linear beam about the predicted shape). White where it is less than two "
                    f"standard deviations; these are {_typical(r.force_std)} N/m in the middle.",
                )
            )
    return "".join(parts)


def _typical(std: FloatArray) -> str:
    u = std.shape[1]
    return number(float(np.median(std[:, u // 4 : -(u // 4)])), digits=2)


def _cause(effect: FoundEffect) -> str:
    rows = [[p.name, measured(p.value, p.std, p.unit)] for p in effect.parameters]
    text = paragraph(effect.meaning) if effect.meaning else ""
    rivals = (
        paragraph(f"These data are explained as well by: {', '.join(effect.rivals)}.")
        if effect.rivals
        else ""
    )
    heading = f"<h3>{markup(effect.name.replace('_', ' '))}</h3>"
    return heading + text + table(["parameter", "value +- std"], rows) + rivals


def _before_and_after(report: DiagnosisReport) -> str:
    parts = []
    before, after = report.err_holdout
    words = f"ERR on what was kept aside: {millimetres(before)} with the plain model"
    if report.effects:
        words += f", {millimetres(after)} with the extended one"
    parts.append(paragraph(f"{words}; noise floor {millimetres(report.noise_floor)}."))
    if report.gain is not None and report.effects:
        value, low, high = (100.0 * v for v in report.gain)
        parts.append(
            paragraph(f"ERR is {value:.1f} % smaller (95 % interval {low:.1f} to {high:.1f} %).")
        )
    parts += [paragraph(r) for r in report.remarks]
    for k, r in enumerate(report.recordings):
        parts.append(f"<h3>{markup(f'{r.name} ({r.role})')}</h3>")
        frames = [
            ShapeFrame(
                float(r.times[f]), r.observed[f], r.after[f],
                r.before[f] if report.effects else None, float(r.err_after[f]),
            )
            for f in range(len(r.times))
        ]  # fmt: skip
        caption = "Move the slider. Observed; predicted"
        caption += " with, and at first without, the named cause." if report.effects else "."
        parts.append(figure(player(frames, r.length), caption))
        series = [Series("plain model", "predicted", r.times, 1e3 * r.err_before, dashed=True)]
        if report.effects:
            series.append(Series("extended model", "observed", r.times, 1e3 * r.err_after))
        levels: tuple[Level, ...] = ()
        if report.noise_floor is not None:
            levels = (Level("noise floor", "true", 1e3 * report.noise_floor),)
        plot = LinePlot(f"err{k}", "time [s]", "ERR [mm]", tuple(series), levels)
        parts.append(figure(line_plot(plot), "Mean distance, eq. (10) of the paper."))
    return "".join(parts)


def _ranking(report: DiagnosisReport) -> str:
    rows = [
        [
            r.name.replace("_", " ").replace("+", " + "),
            f"{r.score:.4g}",
            f"{max(r.structure, 0.0):.2g}",
            millimetres(r.err_holdout),
        ]
        for r in report.ranking
    ]
    text = paragraph(
        "Score: minus twice the log likelihood with which each part of the data is predicted from "
        "the others (lower is better). Left over: what repeats from picture to picture, over the "
        "noise."
    )
    return table(["effect", "score", "left over", "ERR kept aside"], rows) + text


def _material(report: DiagnosisReport) -> str:
    rows = [
        [m.name, measured(*m.before, m.unit), measured(*m.after, m.unit)] for m in report.material
    ]
    return table(["parameter", "plain model", "extended model"], rows)
