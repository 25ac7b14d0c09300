# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""ERR of the paper's parameter sets, and what the automatic procedure finds instead."""

from __future__ import annotations

from dataclasses import dataclass

from dlo_ros.identification import Estimate, identify
from dlo_ros.identification.identifiability import sentences
from paper.experiments import TRAINING, VALIDATION, Recorded, Run, record


@dataclass(frozen=True)
class Row:
    """One experiment with one parameter set.

    Args:
        run: the experiment.
        material: E [Pa] and mu [kg/m^3].
        err: eq. (10) at the end of the experiment, as in Table IV [m].
        mean: mean ERR over time [m].
        paper: the paper's ERR, in units that it does not state.
    """

    run: Run
    material: tuple[float, float]
    err: float
    mean: float
    paper: float


@dataclass(frozen=True)
class Automatic:
    """What `identify` finds.

    Args:
        source: names of the recordings.
        estimate: estimate of the parameters.
        statement: sentences on what the recordings determine.
        err: eq. (10) at the end of each experiment, by name [m].
    """

    source: str
    estimate: Estimate
    statement: tuple[str, ...]
    err: dict[str, float]


@dataclass(frozen=True)
class Results:
    """All of it; `checks` says of each claim whether it holds."""

    recorded: dict[str, Recorded]
    rows: tuple[Row, ...]
    automatic: tuple[Automatic, ...]
    checks: tuple[tuple[str, bool], ...]


def results(seed: int = 0) -> Results:
    """Make the experiments, try the paper's parameters, identify."""
    recorded = {run.name: record(run, seed + k) for k, run in enumerate((*TRAINING, *VALIDATION))}
    rows = []
    for run in (*TRAINING, *VALIDATION):
        for material, paper in zip(run.sets, run.paper, strict=True):
            err = recorded[run.name].predicted(material).err
            rows.append(Row(run, material, float(err[-1]), float(err.mean()), paper))
    automatic = (
        _identified("the third experiment", ("c_shape",), recorded),
        _identified("all three", tuple(run.name for run in TRAINING), recorded),
    )
    return Results(recorded, tuple(rows), automatic, tuple(_checks(rows, automatic)))


def _identified(source: str, names: tuple[str, ...], recorded: dict[str, Recorded]) -> Automatic:
    first = recorded[names[0]]
    found = identify([recorded[name].manipulation for name in names], first.settings)
    estimate = found.estimate
    assert found.fitted is not None
    # E and mu are those of the material: the thicker, longer rope is predicted with them, too.
    material = (estimate.young_modulus, estimate.density)
    err = {name: float(r.predicted(material).err[-1]) for name, r in recorded.items()}
    return Automatic(source, estimate, tuple(sentences(estimate, found.fitted.information)), err)


def _checks(rows: list[Row], automatic: tuple[Automatic, ...]) -> list[tuple[str, bool]]:
    """The paper's orderings (physics.md), and the automatic procedure beside them."""
    by_run: dict[str, list[Row]] = {}
    for row in rows:
        by_run.setdefault(row.run.name, []).append(row)
    c_shape = [row.err for row in by_run["c_shape"]]
    result = [
        ("on the C shape ERR falls as E goes 1e6, 3e6, 5e7", sorted(c_shape)[::-1] == c_shape)
    ]
    for name in ("simple", "different"):
        own, last = by_run[name]
        result.append((f"on '{name}' the last set is no worse", last.err <= own.err))
    for found in automatic:
        for name, rows_of in by_run.items():
            best = min(row.err for row in rows_of)
            result.append(
                (
                    f"identified from {found.source}: on '{name}' no worse than the best set by "
                    "more than 0.1 mm",
                    found.err[name] <= best + 1e-4,
                )
            )
    return result
