# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The output of `diagnose`: report.json, extended.yaml, report.html, terminal."""

from __future__ import annotations

import inspect
import json
import math
import shlex
import textwrap
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from dlo_ros.cli.diagnosis_story import QUESTION_REMEDY, by_share, extends, story
from dlo_ros.cli.diagnosis_words import clear_side, rows
from dlo_ros.cli.effect_words import RIGHT_HAND, mm, title
from dlo_ros.cli.results import QUANTITIES, with_std
from dlo_ros.diagnosis import Diagnosis, Fitted, Number, SetupNumber
from dlo_ros.diagnosis.residuals.relations import sentences
from dlo_ros.effects import effects
from dlo_ros.files import write_text
from dlo_ros.identification.force_scale import POWERS
from dlo_ros.parameters import Settings
from dlo_ros.report.diagnosis import write_diagnosis_report
from dlo_ros.report.diagnosis_content import (
    OFF_BY,
    DiagnosedRecording,
    DiagnosisReport,
    FoundEffect,
    FoundParameter,
    MaterialRow,
    Question,
    RelatedInput,
    ResidualRelations,
    SearchStep,
    SetupRow,
    grouped,
)
from dlo_ros.report.loads import LoadRow
from dlo_ros.report.outlines import outlines

SIGNED = "An angle with a sign follows the right-hand rule about its axis."
EXTENDED = "extended.yaml"
REPORT = "report.json"
DESIGN = "design"
"""Folder that `design` is proposed to write."""
WIDTH = 98
"""Columns of the terminal that are used."""


def write_results(
    output: Path, settings: Settings, found: Diagnosis, loads: Sequence[LoadRow] = (),
    without: Collection[str] = (),
) -> None:  # fmt: skip
    """Write report.json, extended.yaml and report.html into a folder.

    Args:
        output: the folder, made where it is missing.
        settings: the initial guess.
        found: the result.
        loads: loads on the DLO in the recordings.
        without: names of parameters that extended.yaml shall not state.
    """
    output.mkdir(parents=True, exist_ok=True)
    write_text(output / REPORT, json.dumps(tree(found), indent=2, allow_nan=False) + "\n")
    extended = found.extended
    comment = "Extended by dlo_ros diagnose; nodes and tools load this file as it is."
    model = with_std(_with_force_stds(found), extended.specific_modulus[1])
    write_text(output / EXTENDED, model.text(comment, without))
    write_diagnosis_report(output / "report.html", report(found, settings, loads))


def _with_force_stds(found: Diagnosis) -> Settings:
    """The extended model, which states the std of each force of an effect that was fitted.

    An exact force would be a known one, and tell the density.
    """
    settings = found.extended.settings
    numbers: dict[str, Number | SetupNumber] = {
        f"{e.name}.{key}": n for e in found.effects for key, n in e.parameters.items()
    }
    stds = {
        name: n.std
        for name, n in (dict(found.setup) | numbers).items()
        if n.unit in POWERS and isinstance(n.std, float)
        and name.partition(".")[0] in settings.effects
    }  # fmt: skip
    return replace(settings, tolerances=stds | dict(settings.tolerances))


def tree(found: Diagnosis) -> dict[str, Any]:
    """The contents of report.json (interface.md)."""
    gain = found.gain
    return {
        "verdict": found.verdict,
        "effects": [
            {
                "name": e.name,
                "parameters": {
                    key: {"value": _plain(n.value), "std": _plain(n.std), "unit": n.unit}
                    | ({"own": dict(n.own)} if n.own else {})
                    for key, n in e.parameters.items()
                },
                "rivals": list(e.rivals),
                "rival_values": {
                    name: {key: _plain(value) for key, value in block.items()}
                    for name, block in e.rival_values.items()
                },
                "share": _number(e.share),
            }
            for e in found.effects
        ],
        "noise_floor": _number(found.noise_floor),
        "baseline": _fitted(found.baseline),
        "extended": _fitted(found.extended),
        "gain": {
            "value": _number(gain.value if gain else None),
            "low": _number(gain.low if gain else None),
            "high": _number(gain.high if gain else None),
        },
        "candidates": [
            {"name": c.name, "err_holdout": None, "score": _number(c.score)}
            for c in found.candidates
        ],
        "advice": found.advice,
        "material_err": _number(found.material_err),
        "remaining_err": _number(found.extended.err_holdout),
        "share": _number(found.share),
        "setup": {
            name: {
                "value": n.value, "std": _number(n.std), "tolerance": _number(n.tolerance),
                "unit": n.unit,
            }
            for name, n in found.setup.items()
        },
        "systematic": {
            name: {"value": _plain(n.value), "std": _plain(n.std), "unit": n.unit}
            for name, n in found.systematic.items()
        },
        "trace": [
            {"step": t.step, "name": t.name, "gain": _number(t.gain), "err": _number(t.err),
             "outcome": t.outcome}
            for t in found.trace
        ],
    }  # fmt: skip


def _fitted(fitted: Fitted) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name, _, _ in QUANTITIES:
        value, std = getattr(fitted, name)
        result[name] = {"value": _number(value), "std": _number(std)}
    result["err_train"] = _number(fitted.err_train)
    result["err_holdout"] = _number(fitted.err_holdout)
    return result


def _number(value: float | None) -> float | None:
    """JSON knows no infinity; unknown and unbounded numbers are null."""
    return None if value is None or not math.isfinite(value) else float(value)


def _plain(value: float | Sequence[float] | None) -> Any:
    if isinstance(value, (tuple, list)):
        return [_number(v) for v in value]
    return _number(value)  # type: ignore[arg-type]  # a single number is left


def summary(found: Diagnosis, length: float, output: Path) -> list[str]:
    """The result for the terminal: a line each, none longer than a screen is wide.

    Args:
        length: length of the DLO [m].
        output: folder of the results.
    """
    text = story(found, length, str(output / EXTENDED))
    lines = [*_wrapped(f"{found.verdict}: {text.headline}", "")]
    for answer in text.answers:
        lines += ["", answer.text]
        for sentence in answer.answer:
            lines += _wrapped(sentence, "  ")
    if text.remedies:
        lines += ["", QUESTION_REMEDY]
        for sentence in text.remedies:
            lines += _wrapped(sentence, "  ")
    if text.setup:
        lines += ["", "Your set-up, as far as the data determine it"]
        if any(row.notable for row in text.setup):
            signed = any(row.notable and row.positive == RIGHT_HAND for row in text.setup)
            lines += _wrapped(f"{OFF_BY} {SIGNED if signed else ''}", "  ")
        lines += [f"  {row}" for row in _setup_table(text.setup)]
    lines += ["", "What to record next", *_wrapped(text.advice, "  ")]
    if any(e.rivals for e in found.effects):
        command, rest = separating(output, output.with_name(DESIGN))
        lines += [f"  {command} \\", f"      {rest}"]
    return lines


def separating(results: Path, output: Path) -> tuple[str, str]:
    """The command that looks for the manipulation that separates a cause from its rivals, in two.

    Args:
        results: folder of the results of this diagnosis.
        output: folder for its own results.
    """
    words = ("design", "--params", results / EXTENDED, "--report", results / REPORT)
    return shlex.join(["dlo_ros", *map(str, words)]), shlex.join(["--output", str(output)])


def _wrapped(text: str, indent: str) -> list[str]:
    return textwrap.wrap(
        text, WIDTH, initial_indent=indent, subsequent_indent=indent,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def _setup_table(lines: Sequence[SetupRow]) -> list[str]:
    """A line for each number that is notably off, and the count of the others."""
    notable = [line for line in lines if line.notable]
    rest = len(lines) - len(notable)
    cells = [("what", "off by", "tolerance")] if notable else []
    for group, members in grouped(notable):
        cells.append((f"{group}:", "", ""))
        cells += [(f"  {line.name}", line.off, line.tolerance) for line in members]
    widths = [max(len(row[k]) for row in cells) for k in range(2)] if cells else []
    table = [f"{a:<{widths[0]}}  {b:<{widths[1]}}  {c}".rstrip() for a, b, c in cells]
    if rest:
        if rest == 1:
            more = "The other number" if notable else "The number"
        elif notable:
            more = f"{rest} other numbers"
        else:
            more = f"{'Both' if rest == 2 else f'All {rest}'} numbers"
        table.append(f"{more} may well be right: report.html has {'it' if rest == 1 else 'them'}.")
    return table


def report(found: Diagnosis, settings: Settings, loads: Sequence[LoadRow] = ()) -> DiagnosisReport:
    """The contents of report.html."""
    length = settings.rod.length
    text = story(found, length, f"{EXTENDED} (beside this page)")
    remarks = list(found.remarks)
    if found.simulation_error is not None:
        own = mm(found.simulation_error)
        remarks.append(f"The simulation's own, numerical error is {own} at most.")
    rivals = any(e.rivals for e in found.effects)
    command = " ".join(separating(Path(), Path(DESIGN))) if rivals else ""
    return DiagnosisReport(
        text.headline,
        (*text.answers, *([Question(QUESTION_REMEDY, text.remedies)] if text.remedies else [])),
        found.verdict,
        extends(found),
        tuple(
            FoundEffect(
                f"{title(e.name, clear_side(e))} ({e.name})", _meaning(e.name),
                tuple(FoundParameter(*row) for row in rows(e, length)),
                tuple(map(title, e.rivals)),
            )
            for e in by_share(found.effects)
        ),
        tuple(
            MaterialRow(words, unit, getattr(found.baseline, name), getattr(found.extended, name))
            for name, words, unit in QUANTITIES
        ),
        tuple(
            DiagnosedRecording(
                v.name, v.role, length, v.times, v.observed, v.before, v.after, v.err_before,
                v.err_after, v.u, v.field_before, v.field_after, v.force, v.force_std,
            )
            for v in found.views
        ),
        found.noise_floor,
        found.advice,
        tuple(remarks),
        tuple(
            ResidualRelations(
                model, sentences(r),
                tuple(
                    RelatedInput(i.name, i.share, i.chance, i.significant, i.alike)
                    for i in r.inputs
                ),
                r.unjudged,
            )
            for model, r in (
                ("The plain model", found.relations_before),
                ("The residual with the best extension", found.relations_after),
            )
            if r is not None and r.pattern is not None
        ),
        text.setup,
        tuple(SearchStep(t.step, t.name, t.gain, t.err, t.outcome) for t in found.trace),
        tuple(loads),
        settings.camera_positions,
        command,
        outlines(found.extended.settings),
    )  # fmt: skip


def _meaning(name: str) -> str:
    """The first sentence of the effect's own description; its law stands in the documentation."""
    known = effects().get(name)
    first = ((inspect.getdoc(known) or "") if known else "").partition("\n\n")[0]
    return " ".join(first.replace("`", "").split())
