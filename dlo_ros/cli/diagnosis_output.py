# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What `diagnose` writes and prints: report.json, extended.yaml, report.html, a few lines."""

from __future__ import annotations

import inspect
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dlo_ros.cli.results import QUANTITIES
from dlo_ros.diagnosis import Diagnosis, Fitted, NamedEffect, SetupNumber
from dlo_ros.diagnosis.relations import sentences
from dlo_ros.effects import effects, quantities
from dlo_ros.files import write_text
from dlo_ros.parameters import Settings
from dlo_ros.report.diagnosis import (
    DiagnosedRecording,
    DiagnosisReport,
    FoundEffect,
    FoundParameter,
    MaterialRow,
    Ranked,
    RelatedInput,
    ResidualStructure,
    SearchStep,
    SetupRow,
    write_diagnosis_report,
)  # fmt: skip

HEADLINES = {
    "adequate": "The model is adequate: what is left over is measurement noise.",
    "explained": "The model lacks {names}.",
    "unexplained": "Something is wrong that nothing in the library explains.",
}
CLEAR = 3.0
"""Standard deviations from neutral, from which a number of the set-up is told on the terminal."""
PARTLY = "The model lacks {names}; what is left beside that nothing in the library explains."


def write_results(output: Path, settings: Settings, found: Diagnosis) -> None:
    """Write report.json, extended.yaml and report.html into a folder.

    Args:
        output: the folder, made where it is missing.
        settings: the initial guess.
        found: the result.
    """
    output.mkdir(parents=True, exist_ok=True)
    write_text(output / "report.json", json.dumps(tree(found), indent=2, allow_nan=False) + "\n")
    comment = "Extended by dlo_ros diagnose; nodes and tools load this file as it is."
    write_text(output / "extended.yaml", found.extended.settings.text(comment))
    write_diagnosis_report(output / "report.html", report(found, settings.rod.length))


def tree(found: Diagnosis) -> dict[str, Any]:
    """What report.json holds (interface.md)."""
    gain = found.gain
    return {
        "verdict": found.verdict,
        "effects": [
            {
                "name": e.name,
                "parameters": {
                    key: {"value": _plain(n.value), "std": _plain(n.std), "unit": n.unit}
                    for key, n in e.parameters.items()
                },
                "rivals": list(e.rivals),
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
            {"name": c.name, "err_holdout": _number(c.err_holdout), "score": _number(c.score)}
            for c in found.candidates
        ],
        "advice": found.advice,
        "material_err": _number(found.material_err),
        "remaining_err": _number(found.extended.err_holdout),
        "share": _number(found.share),
        "setup": {
            name: {"value": n.value, "std": n.std, "tolerance": n.tolerance, "unit": n.unit}
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


def summary(found: Diagnosis) -> list[str]:
    """The result for the terminal."""
    lines = [f"{found.verdict}: {headline(found)}"]
    for e in found.effects:
        numbers = ", ".join(
            f"{p.name} {p.value:.4g} +- {'unknown' if p.std is None else f'{p.std:.2g}'} {p.unit}"
            for p in _parameters(e)
        )
        lines.append(f"{e.name}: {numbers}".rstrip())
        if e.rivals:
            lines.append(f"  explained as well by {', '.join(e.rivals)}")
    before, after = found.baseline.err_holdout, found.extended.err_holdout
    lines.append(f"ERR on what was kept aside: {_mm(before)} -> {_mm(after)}")
    lines.append(f"noise floor: {_mm(found.noise_floor)}")
    off = [_setup_words(name, n) for name, n in found.setup.items() if abs(_off(name, n)) > CLEAR]
    if off:
        lines.append(f"your set-up, within its tolerances: {', '.join(off)}")
    lines.append(found.advice)
    return lines


def _off(name: str, number: SetupNumber) -> float:
    """Standard deviations by which a number of the set-up is away from neutral."""
    effect, _, key = name.partition(".")
    neutral = quantities(effect)[key.partition("[")[0]].neutral
    return (number.value - neutral) / number.std if number.std > 0.0 else 0.0


def _setup_words(name: str, n: SetupNumber) -> str:
    return f"{name} {n.value:.3g} +- {n.std:.1g} {n.unit}".rstrip()


def headline(found: Diagnosis) -> str:
    """The result in a sentence."""
    names = []
    for e in found.effects:
        words = e.name.replace("_", " ")
        names.append(f"{words} (or {', '.join(e.rivals)})" if e.rivals else words)
    text = PARTLY if names and found.verdict == "unexplained" else HEADLINES[found.verdict]
    return text.format(names=" and ".join(names).replace("_", " "))


def _mm(value: float | None) -> str:
    return "unknown" if value is None else f"{1e3 * value:.3f} mm"


def _parameters(effect: NamedEffect) -> list[FoundParameter]:
    """One row for each number; several values along u are counted from its start."""
    rows = []
    for key, n in effect.parameters.items():
        if not isinstance(n.value, tuple):
            assert n.std is None or isinstance(n.std, float)
            rows.append(FoundParameter(key, n.value, n.std, n.unit))
            continue
        stds = n.std if isinstance(n.std, tuple) else (None,) * len(n.value)
        for k, (value, std) in enumerate(zip(n.value, stds, strict=True)):
            rows.append(FoundParameter(f"{key} {k + 1} of {len(n.value)}", value, std, n.unit))
    return rows


def report(found: Diagnosis, length: float) -> DiagnosisReport:
    """What report.html shows."""
    remarks = list(found.remarks)
    if found.simulation_error is not None:
        remarks.append(f"The simulation's own error is {_mm(found.simulation_error)} at most.")
    gain = found.gain
    return DiagnosisReport(
        headline(found),
        found.verdict,
        tuple(
            FoundEffect(e.name, _meaning(e.name), tuple(_parameters(e)), e.rivals)
            for e in found.effects
        ),
        tuple(
            Ranked(c.name, c.err_holdout, c.score, c.structure) for c in found.candidates
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
        (found.baseline.err_holdout, found.extended.err_holdout),
        (gain.value, gain.low, gain.high) if gain else None,
        found.advice,
        tuple(remarks),
        tuple(
            ResidualStructure(
                model, sentences(r),
                tuple(RelatedInput(i.name, i.share, i.chance, i.told, i.alike) for i in r.inputs),
                r.unjudged,
            )
            for model, r in (
                ("The plain model", found.relations_before),
                ("What is left with the best extension", found.relations_after),
            )
            if r is not None and r.pattern is not None
        ),
        tuple(
            SetupRow(name, n.value, n.std, n.tolerance, n.unit) for name, n in found.setup.items()
        ),
        tuple(SearchStep(t.step, t.name, t.gain, t.err, t.outcome) for t in found.trace),
    )  # fmt: skip


def _meaning(name: str) -> str:
    """The effect's own description."""
    known = effects().get(name)
    return " ".join((inspect.getdoc(known) or "").replace("`", "").split()) if known else ""
