# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Results of a diagnosis as numbers (interface.md, report.json)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from dlo_ros.diagnosis.explain.candidate_trials import Step
from dlo_ros.diagnosis.residuals.relations import Relations
from dlo_ros.effects.start import Block
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray

Verdict = Literal["adequate", "explained", "unexplained"]


@dataclass(frozen=True)
class Number:
    """A parameter of an effect with its standard deviation (None: unknown) and SI unit.

    Where recordings have values of their own, `own` has them by the recordings' names; the value is
    their mean then, and its standard deviation contains how much they differ.
    """

    value: float | tuple[float, ...]
    std: float | tuple[float, ...] | None
    unit: str
    own: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the data show, and its rivals, which explain them as well.

    Args:
        share: fraction of the ERR beyond the measurement's own that the effect removes, 0 to 1;
            None: unknown.
        rival_values: values of the rivals' keys in their own fits, by name; of a damping none.
    """

    name: str
    parameters: dict[str, Number]
    rivals: tuple[str, ...]
    share: float | None = None
    rival_values: Mapping[str, Block] = field(default_factory=dict)


@dataclass(frozen=True)
class SetupNumber:
    """A number that was fitted and is no cause, with its SI unit.

    Args:
        value: the number; of a damping the difference from the parameter file's.
        std: its standard deviation; None: the data do not determine it.
        tolerance: tolerance within which it is known beforehand; None: it is only guessed.
        held_std: standard deviation where the density is as it stands, of which shapes tell no more
            than ratios to it; None: not determined then either, or `std` is known.
    """

    value: float
    std: float | None
    tolerance: float | None
    unit: str
    held_std: float | None = None


@dataclass(frozen=True)
class Fitted:
    """A fitted model with its parameters and errors.

    Args:
        settings: settings with the estimated values.
        young_modulus, density, specific_modulus: value and std (None: unbounded).
        err_train, err_holdout: time mean of eq. (10) [m]; None where it cannot be simulated.
        scale_std: relative std of all forces together, which those of the effects' numbers contain.
    """

    settings: Settings
    young_modulus: tuple[float, float | None]
    density: tuple[float, float | None]
    specific_modulus: tuple[float, float | None]
    err_train: float | None
    err_holdout: float | None
    scale_std: float = 0.0


@dataclass(frozen=True)
class Gain:
    """1 - ERR after / ERR before on held-out data, with a 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Candidate:
    """An effect that was tried: its score, lower is better."""

    name: str
    score: float


@dataclass(frozen=True)
class RecordingView:
    """One recording with the shapes of the plain and the extended model.

    Args:
        name, role: name of the recording, and its role, `train` or `holdout`.
        times: [s], shape (F,).
        observed, before, after: control points [m], shape (F, n, 3 or 4).
        err_before, err_after: eq. (10), shape (F,) [m].
        u: material coordinates of the maps [m], shape (U,).
        field_before, field_after: observed minus predicted across the DLO [m], shape (F, U).
        force, force_std: missing force per length, x, y, z [N/m], shape (F, U, 3); None where it
            could not be had.
    """

    name: str
    role: str
    times: FloatArray
    observed: FloatArray
    before: FloatArray
    after: FloatArray
    err_before: FloatArray
    err_after: FloatArray
    u: FloatArray
    field_before: FloatArray
    field_after: FloatArray
    force: FloatArray | None = None
    force_std: FloatArray | None = None


@dataclass(frozen=True)
class Diagnosis:
    """The result of `diagnose`.

    Args:
        verdict, effects, noise_floor, gain, candidates, advice: see interface.md.
        baseline, extended: the plain and the extended model.
        simulation_error: mean distance that the discretisation causes [m]; None where unknown.
        remarks: sentences for the reader.
        views: recordings with their shapes, for the report.
        relations_before, relations_after: inputs on which the residual of the plain model
            depends, and that of the best extension, which may be no more than a suspect.
        material_err: ERR below which nothing is left to explain [m].
        share: fraction of the held-out ERR beyond the measurement's own that the extended model
            removes.
        setup: numbers of the set-up within their tolerances, and all else that was fitted and is
            neither E, mu nor a cause, by effect and key.
        systematic: errors of the measurement and of the model, by name.
        trace: every candidate of every step of the joint model's search.
        uncertain: causes that not all recordings show for certain.
        left_out: sentence on pictures that do not count; empty: all do.
        given_err: ERR of the parameter file as it stands, on all recordings [m]; None where it
            cannot be simulated.
    """

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    noise_floor: float | None
    baseline: Fitted
    extended: Fitted
    gain: Gain | None
    candidates: tuple[Candidate, ...]
    advice: str
    simulation_error: float | None
    remarks: tuple[str, ...]
    views: tuple[RecordingView, ...]
    relations_before: Relations | None = None
    relations_after: Relations | None = None
    material_err: float | None = None
    share: float | None = None
    setup: Mapping[str, SetupNumber] = field(default_factory=dict)
    systematic: Mapping[str, Number] = field(default_factory=dict)
    trace: tuple[Step, ...] = ()
    uncertain: tuple[NamedEffect, ...] = ()
    left_out: str = ""
    given_err: float | None = None
