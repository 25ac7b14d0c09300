# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The content of the report of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from dlo_ros.report.loads import LoadRow
from dlo_ros.spline import FloatArray

GROUPS = ("camera", "clamps", "DLO", "surroundings", "time")
"""Parts of a set-up, in the order in which tables have them."""
OFF_BY = (
    "Off by: how the real set-up differs from the parameter file and the commands, as the camera "
    "sees it."
)
ROLES = {
    "train": "used for the fit",
    "holdout": "held out, at least in part, for the numbers above; drawn are the final models",
}


@dataclass(frozen=True)
class FoundParameter:
    """A number of an effect.

    Args:
        name: name of the number.
        shown: value with its standard deviation, in words.
        meaning: meaning of the number, in a few words.
    """

    name: str
    shown: str
    meaning: str


@dataclass(frozen=True)
class FoundEffect:
    """A named cause.

    Args:
        name: name of the effect.
        meaning: meaning of the effect in plain words.
        parameters: numbers of the effect.
        rivals: alternatives that explain the data as well.
    """

    name: str
    meaning: str
    parameters: tuple[FoundParameter, ...]
    rivals: tuple[str, ...]


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
        name, role: name and role of the recording.
        length: L of the spline basis [m].
        times: [s], shape (F,).
        observed, before, after: control points [m], shape (F, n, 3 or 4).
        err_before, err_after: eq. (10), shape (F,) [m].
        u: material coordinates of the maps [m], shape (U,).
        field_before, field_after: observed minus predicted across the DLO [m], shape (F, U).
        force, force_std: the missing force, x, y, z [N/m], shape (F, U, 3), or None.
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
class RelatedInput:
    """An input that may have to do with a residual.

    Args:
        name: name of the input.
        share: fraction of the repeating part of the residual that the input predicts.
        chance: fraction of the surrogates that are explained as well.
        significant: whether the relation is more than chance.
        alike: inputs that cannot be distinguished from it.
    """

    name: str
    share: float
    chance: float
    significant: bool
    alike: tuple[str, ...]


@dataclass(frozen=True)
class ResidualRelations:
    """The inputs that the residual of a model depends on, in sentences and numbers."""

    model: str
    sentences: tuple[str, ...]
    inputs: tuple[RelatedInput, ...]
    unjudged: tuple[str, ...]


@dataclass(frozen=True)
class SetupRow:
    """A number of the set-up in words.

    Args:
        name: name of the number, in words.
        off: deviation from the stated value, with its standard deviation.
        tolerance: tolerance within which careful people set it up.
        notable: whether it is off by more than the data leave open.
        group: the part of the set-up that it belongs to, such as clamps or camera.
        positive: what a positive number means in the files, in words; empty: it needs none.
    """

    name: str
    off: str
    tolerance: str
    notable: bool
    group: str
    positive: str = ""


def grouped(rows: Sequence[SetupRow]) -> list[tuple[str, list[SetupRow]]]:
    """Rows by their group, in the order of `GROUPS`; within a group they keep their order."""
    order = [*GROUPS, *sorted({r.group for r in rows} - set(GROUPS))]
    groups = [(group, [r for r in rows if r.group == group]) for group in order]
    return [(group, members) for group, members in groups if members]


@dataclass(frozen=True)
class Question:
    """A reader's question, and sentences that answer it."""

    text: str
    answer: tuple[str, ...]


@dataclass(frozen=True)
class SearchStep:
    """A candidate of a step: gain in log evidence, ERR [m] where fitted, what became of it."""

    step: int
    name: str
    gain: float
    err: float | None
    outcome: str


@dataclass(frozen=True)
class DiagnosisReport:
    """The contents of the report; lengths in m.

    Args:
        headline: the result in a sentence.
        questions: questions that a person asks first, with their answers.
        extends: whether the extended model is another than the plain one.
        loads: loads on the DLO in the recordings, by the extended model.
        command: command that looks for the recording that is advised; empty: there is none.
        cameras: positions [m] of the cameras that have names, which the view in space shows.
        bodies: outlines of the pegs and walls of the extended model, see `outlines.outlines`.
    """

    headline: str
    questions: tuple[Question, ...]
    verdict: str
    extends: bool
    effects: tuple[FoundEffect, ...]
    material: tuple[MaterialRow, ...]
    recordings: tuple[DiagnosedRecording, ...]
    noise_floor: float | None
    advice: str
    remarks: tuple[str, ...]
    residual_relations: tuple[ResidualRelations, ...] = ()
    setup: tuple[SetupRow, ...] = ()
    trace: tuple[SearchStep, ...] = ()
    loads: tuple[LoadRow, ...] = ()
    cameras: Mapping[str, FloatArray] = field(default_factory=dict)
    command: str = ""
    bodies: tuple[FloatArray, ...] = ()
