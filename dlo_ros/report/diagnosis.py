# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The report of a diagnosis: model errors, their causes, the gain, and the next experiment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dlo_ros.report.diagnosis_content import (
    OFF_BY,
    ROLES,
    DiagnosedRecording,
    DiagnosisReport,
    FoundEffect,
    RelatedInput,
    ResidualRelations,
    SetupRow,
    grouped,
)
from dlo_ros.report.elements import (
    command,
    figure,
    grouped_table,
    markup,
    measured,
    millimetres,
    paragraph,
    table,
)  # fmt: skip
from dlo_ros.report.force import FORCE_CAPTION, across, force_arrows, force_maps
from dlo_ros.report.loads import loads_table
from dlo_ros.report.maps import field_maps
from dlo_ros.report.page import Section, page, write_page
from dlo_ros.report.plots import LinePlot, ReferenceLine, Series, line_plot
from dlo_ros.report.shape_player import ShapeFrame, player
from dlo_ros.report.worst_frame import worst_err, worst_frame
from dlo_ros.spline import FloatArray

PREDICTS = (
    "Predicts: share of the residual, without noise and slow drifts, that a function of the input "
    "explains, learned from the other recordings or spans of time. By chance: how often it "
    "does as well with residuals that do not depend on it but vary alike. The slow drift within "
    "a recording is left out, since all slow drifts are correlated."
)

MODELS = {"observed": "observed", "predicted": "extended model", "initial": "plain model"}
"""Names of the curves; one that is not extended is the plain model itself."""
PLAIN_ONLY = {**MODELS, "predicted": "plain model"}
LOW = 0.05
"""Share of the highest value of a plot below which a curve is hard to see."""
POSITIVE = (
    "The last column says which side is positive in report.json and extended.yaml, where numbers "
    "have signs."
)
CERTAIN = (
    "A cause is certain where every model without it explains the data far worse. How strong it is "
    "may be undetermined all the same; then it says so. Where several causes explain the data "
    "equally well, at least one of them acts, and the data do not tell which."
)


def write_diagnosis_report(path: Path | str, report: DiagnosisReport) -> None:
    """Write a report as one HTML file that needs nothing else.

    Raises:
        InputError: a shape in it is not finite.
        OSError: the file cannot be written.
    """
    write_page(path, diagnosis_page(report))


def diagnosis_page(report: DiagnosisReport) -> str:
    """The report as an HTML document."""
    sections = [Section("Where and when", _pictures(report))]
    if report.effects:
        body = "".join(_cause(e) for e in report.effects) + paragraph(CERTAIN)
        sections.append(Section("The causes in numbers", body))
    if report.setup:
        sections.append(Section("Your set-up, as far as the data determine it", _setup(report)))
    sections.append(Section("Material", _material(report)))
    advice = paragraph(report.advice)
    if report.command:
        advice += paragraph("In the folder of this page:") + command(report.command)
    sections.append(Section("What to record next", advice))
    if report.remarks:
        sections.append(Section("Remarks", "".join(map(paragraph, report.remarks))))
    if report.loads:
        body = loads_table(report.loads)
        sections.append(Section("Largest loads in the recordings", body))
    if report.residual_relations:
        body = "".join(_relations(s) for s in report.residual_relations)
        if any(s.inputs for s in report.residual_relations):
            body += paragraph(PREDICTS)
        sections.append(Section("Inputs that the residual depends on", body))
    if report.trace:
        sections.append(Section("Every step of the search", _trace(report)))
    return page("Diagnosis", _summary(report), sections)


def _summary(report: DiagnosisReport) -> str:
    """The first screen: the result, and the answers to a reader's first questions."""
    answers = "".join(
        f"<h2>{markup(q.text)}</h2>" + "".join(map(paragraph, q.answer)) for q in report.questions
    )
    about = ", ".join(r.name for r in report.recordings)
    subject = f'<p class="subject">{markup(about)}</p>' if about else ""
    headline = f'<p class="headline">{markup(report.headline)}</p>'
    return f'{subject}{headline}<div class="answers">{answers}</div>'


def _pictures(report: DiagnosisReport) -> str:
    """The recording in which the plain model is most wrong, and the others folded up below it."""
    if not report.recordings:
        return paragraph("No recording can be simulated, so there is nothing to show.")
    order = sorted(report.recordings, key=lambda r: -worst_err(r.err_before))
    parts = [_errors(order, report), _picture(0, order[0], report)]
    for k, r in enumerate(order[1:], 1):
        before, *after = _mean_errors(r, report)
        words = f"{r.name}: {before} off" + "".join(f", {x} with the extended model" for x in after)
        parts.append(
            f"<details><summary>{markup(words)}</summary>{_picture(k, r, report)}</details>"
        )
    return "".join(parts)


def _mean_errors(r: DiagnosedRecording, report: DiagnosisReport) -> list[str]:
    """Mean ERR with the plain model, and with the extended one."""
    errors = (r.err_before, r.err_after)[: 2 if report.extends else 1]
    return [millimetres(float(e.mean()), 2) for e in errors]


def _errors(recordings: Sequence[DiagnosedRecording], report: DiagnosisReport) -> str:
    """ERR of each recording, as it is drawn below."""
    headers = ["recording", "plain model", "extended model"][: 3 if report.extends else 2]
    rows = [[r.name, *_mean_errors(r, report)] for r in recordings]
    text = paragraph(
        "Mean distance between simulated and observed shapes. The models that are drawn here were "
        "fitted to all of these recordings but those given with --holdout; the numbers above are "
        "of recordings, or ends of recordings, that no fit has used."
    )
    return text + table(headers, rows)


def _picture(k: int, r: DiagnosedRecording, report: DiagnosisReport) -> str:
    """Shapes, error over time, and maps of one recording."""
    parts = [f"<h3>{markup(f'{r.name} ({ROLES.get(r.role, r.role)})')}</h3>"]
    drawn, legend = None, ""
    force = std = None
    if report.verdict != "adequate" and r.force is not None and r.force_std is not None:
        force, std = across(r.observed, r.length, r.u, r.force, r.force_std)
        drawn, legend = force_arrows(r.observed, r.length, r.u, force, std)
    frames = [
        ShapeFrame(
            float(r.times[f]), r.observed[f], r.after[f],
            r.before[f] if report.extends else None, float(r.err_after[f]),
            arrows=drawn[f] if drawn else None,
            err_initial=float(r.err_before[f]) if report.extends else None,
        )
        for f in range(len(r.times))
    ]  # fmt: skip
    names = MODELS if report.extends else PLAIN_ONLY
    worst = float(r.times[worst_frame(r.err_before)])
    caption = "The DLO as observed and as simulated."
    if len(r.times) > 1:
        caption += (
            " At first the instant is shown at which the plain model is most wrong for longer than "
            "a single picture; move the slider to see the others."
        )
    caption += " ERR is the mean distance from the observed shape."
    if any(f.arrows is not None for f in frames):
        caption += FORCE_CAPTION
    shown = player(frames, r.length, legend, report.cameras, names, worst, report.bodies)
    parts.append(figure(shown, caption))
    parts += _at_rest(k, r, report) if len(r.times) < 2 else _over_time(k, r, report)
    parts.append(force_maps(r.times, r.u, force, std))
    return "".join(parts)


def _over_time(k: int, r: DiagnosedRecording, report: DiagnosisReport) -> list[str]:
    """ERR over time, and where along the DLO it comes from."""
    series = _series(r.times, 1e3 * r.err_before, 1e3 * r.err_after, report)
    levels: tuple[ReferenceLine, ...] = ()
    if report.noise_floor is not None:
        levels = (ReferenceLine("the measurement itself", "true", 1e3 * report.noise_floor),)
    # An ERR far below the other one would lie on the axis.
    low = report.extends and bool(np.median(r.err_after) < LOW * r.err_before.max())
    plot = LinePlot(f"err{k}", "time [s]", "ERR [mm]", series, levels, low)
    titles = ["plain model", "extended model"][: 2 if report.extends else 1]
    fields = [1e3 * f for f in (r.field_before, r.field_after)][: len(titles)]
    return [
        figure(
            line_plot(plot),
            "ERR: mean distance between the observed and the simulated shape over time"
            f"{', on a logarithmic scale' if low else ''}. A single picture far above its "
            "neighbours was probably measured wrongly.",
        ),
        figure(
            field_maps(titles, r.times, r.u, fields, "distance [mm]", signed=_signed(r)),
            "Distance of the observed shape from the predicted one across the DLO, along it (u "
            f"counts from the start) and over time{_sides(r, '; red', ', blue')}. Noise looks "
            "grainy; an area of one colour is an error of the model.",
        ),
    ]


def _at_rest(k: int, r: DiagnosedRecording, report: DiagnosisReport) -> list[str]:
    """Distance of a single shape along the DLO."""
    u = 1e3 * r.u
    series = _series(u, 1e3 * r.field_before[0], 1e3 * r.field_after[0], report)
    plot = LinePlot(f"err{k}", "u along the DLO [mm]", "distance [mm]", series)
    return [
        figure(
            line_plot(plot),
            "Distance of the observed shape from the predicted one across the DLO"
            f"{_sides(r, ', positive', ', negative')}; u counts from the start.",
        )
    ]


def _signed(r: DiagnosedRecording) -> bool:
    """Whether distances have a sign: to one side of the DLO or the other, as in the plane alone."""
    return bool((r.field_before < 0.0).any() or (r.field_after < 0.0).any())


def _sides(r: DiagnosedRecording, left: str, right: str) -> str:
    """Words for the sides of the DLO to which it is off in the board's plane; none in space.

    Args:
        left, right: words for both of them.
    """
    if not _signed(r):
        return ""
    return f"{left} where the observed one lies to the left of growing u{right} to the right"


def _series(
    x: FloatArray, before: FloatArray, after: FloatArray, report: DiagnosisReport
) -> tuple[Series, ...]:
    """Curves of both models in the colours of their shapes, the plain one's beneath."""
    if not report.extends:
        return (Series("plain model", "predicted", x, before, line="--"),)
    plain = Series("plain model", "other", x, before, wide=True)
    return plain, Series("extended model", "predicted", x, after, line="--")


def _relations(related: ResidualRelations) -> str:
    rows = [
        [i.name, f"{100.0 * max(i.share, 0.0):.0f} %", _chance(i.chance), _verdict(i)]
        for i in related.inputs
    ]
    parts = [f"<h3>{markup(related.model)}</h3>", *map(paragraph, related.sentences)]
    if rows:
        parts.append(table(["input", "predicts", "by chance", ""], rows))
    if related.unjudged:
        words = f"Varied too slowly to be judged: {', '.join(related.unjudged)}."
        parts.append(paragraph(words))
    return "".join(parts)


def _chance(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"


def _verdict(related: RelatedInput) -> str:
    if not related.significant:
        return ""
    return f"yes, or {', '.join(related.alike)}" if related.alike else "yes"


def _cause(effect: FoundEffect) -> str:
    rows = [[p.name, p.shown, p.meaning] for p in effect.parameters]
    text = paragraph(effect.meaning) if effect.meaning else ""
    rivals = (
        paragraph(
            f"These data are explained as well by: {', '.join(effect.rivals)}.".replace("_", " ")
        )
        if effect.rivals
        else ""
    )
    heading = f"<h3>{markup(effect.name)}</h3>"
    return heading + text + table(["parameter", "value +- std", "meaning"], rows, 2) + rivals


def _material(report: DiagnosisReport) -> str:
    rows = [
        [m.name, measured(*m.before, m.unit), measured(*m.after, m.unit)] for m in report.material
    ]
    if not report.extends:  # both are the same
        return table(["parameter", "value +- std"], [row[:2] for row in rows])
    return table(["parameter", "plain model", "extended model"], rows)


def _setup(report: DiagnosisReport) -> str:
    notable = [r for r in report.setup if r.notable]
    others = [r for r in report.setup if not r.notable]
    parts = [
        paragraph(
            "Every set-up is a little off. These numbers were fitted beside the causes, each with "
            "a tolerance: what careful work achieves. Where there is none, the parameter file only "
            "guesses the number, or it belongs to something that need not act at all."
        ),
        paragraph(f"{OFF_BY} {POSITIVE}"),
    ]
    if notable:
        parts.append(_setup_table(notable))
    else:
        parts.append(paragraph("None of them is notably off."))
    if others:
        rows = _setup_table(others)
        words = f"{len(others)} numbers that may well be right (off by less than three std)"
        parts.append(f"<details><summary>{markup(words)}</summary>{rows}</details>")
    return "".join(parts)


def _setup_table(rows: Sequence[SetupRow]) -> str:
    """Numbers of the set-up, by the part that they belong to."""
    headers = ["what", "off by", "tolerance", "positive in the files"]
    groups = [
        (group, [[r.name, r.off, r.tolerance, r.positive] for r in members])
        for group, members in grouped(rows)
    ]
    return grouped_table(headers, groups)


def _trace(report: DiagnosisReport) -> str:
    simulated = [t for t in report.trace if t.err is not None]
    rows = [
        [str(t.step), t.name.replace("_", " "), f"{t.gain:.0f}", millimetres(t.err, 2), t.outcome]
        for t in simulated
    ]
    text = paragraph(
        "Gain: how much the natural logarithm of the evidence rises with the candidate; 3 is "
        "twenty to one. ERR is that on the recordings learned from. Numbers of the set-up are "
        "fitted from the beginning: one clearly beyond its tolerance is named without a step, and "
        "what is not certain in the end is not named in spite of its step. "
        f"{len(report.trace) - len(rows)} more candidates were not simulated, since the linearised "
        "model predicts that they gain less; report.json has them."
    )
    shown = text + table(["step", "candidate", "gain", "ERR", "what became of it"], rows)
    return f"<details><summary>{len(rows)} simulated candidates</summary>{shown}</details>"
