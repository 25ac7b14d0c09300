# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Diagnoses as they may come out, with everything that may be unknown."""

from dataclasses import replace

import numpy as np
from rods import PAPER

from dlo_ros.cli.diagnosis_story import story
from dlo_ros.diagnosis import (
    Candidate,
    Diagnosis,
    Fitted,
    Gain,
    NamedEffect,
    Number,
    RecordingView,
    SetupNumber,
)
from dlo_ros.diagnosis.residuals.relations import Relation, Relations, ResidualPattern

KNOWN = replace(PAPER, rod=replace(PAPER.rod, density_std=20.0))


def relations():
    related = (Relation("the speed of the grip", 0.6, 0.003, True, ("the bending of the DLO",)),
               Relation("the position of the grip", 0.1, 0.4))  # fmt: skip
    pattern = ResidualPattern(0.8, 0.3, 1)
    return Relations(1e-3, 0.3, 0.1, pattern, related, ("the motion of the DLO",))


def found(frames=12, n=10):
    """A diagnosis as it may come out, with everything that may be unknown."""
    times = np.linspace(0.0, 1.0, frames)
    shape = np.zeros((frames, n, 4))
    shape[:, :, 0] = np.linspace(0.0, KNOWN.rod.length, n)
    u = np.linspace(0.0, KNOWN.rod.length, 20)
    field = np.sin(times)[:, None] * np.cos(8.0 * u)
    force = np.stack([field, 0.0 * field, -field], axis=-1)
    err = np.full(frames, 1e-3)
    view = RecordingView(
        "one", "holdout", times, shape, shape, shape, err, 0.1 * err, u, field, field, force,
        np.abs(force) / 4.0,
    )  # fmt: skip
    block = {"curvature": (0.5, 1.0), "position": 0.1}
    effect = NamedEffect(
        "intrinsic_curvature",
        {"curvature": Number((0.5, 1.0), (0.01, float("inf")), "1/m"),
         "position": Number(0.1, None, "m")},
        ("clamp_angle",),
    )  # fmt: skip
    extended = KNOWN.with_effects({"intrinsic_curvature": block})
    numbers = (1e7, None), (2000.0, 20.0), (5e3, 1.0)
    return Diagnosis(
        "explained", (effect,), 1e-4, Fitted(KNOWN, *numbers, 1e-3, None),
        Fitted(extended, *numbers, 1e-4, 1.1e-4), Gain(0.9, 0.8, 0.95),
        (Candidate("intrinsic_curvature", 10.0), Candidate("none", 1e4)),
        "Turn the clamp.", 1e-5, ("A remark.",), (view,), relations(),
    )  # fmt: skip


DEGREE = np.pi / 180.0
LENGTH = KNOWN.rod.length
MASS = NamedEffect(
    "point_mass",
    {"mass": Number(0.0312, 0.0021, "kg"), "position": Number(0.25, 0.004, "m")}, (), 0.71,
)  # fmt: skip
SETUP = {
    "clamp_angle.start": SetupNumber(2.1 * DEGREE, 0.4 * DEGREE, 3.0 * DEGREE, "rad"),
    "camera_scale.ratio": SetupNumber(1.004, 0.001, 0.005, ""),
    "clamp_offset.start[0]": SetupNumber(1e-4, 1e-3, 2e-3, "m"),
    "clamp_offset.start[1]": SetupNumber(1e-4, 1e-3, 2e-3, "m"),
    "gravity_tilt.angle": SetupNumber(0.001, 0.01, DEGREE, "rad"),
}


def case(verdict="explained", causes=(MASS,), before=2.4e-3, after=0.63e-3, **changes):
    """A diagnosis with the sizes of a real one."""
    made = found()
    block = {"point_mass": {"mass": 0.03, "position": 0.25}} if causes or changes else {}
    numbers = (1e7, None), (2000.0, 20.0), (5e3, 12.0)
    return replace(
        made, verdict=verdict, effects=tuple(causes), noise_floor=1e-4, material_err=2e-4,
        baseline=Fitted(KNOWN, *numbers, before, before),
        extended=Fitted(KNOWN.with_effects(block), *numbers, after, after),
        gain=Gain(0.74, 0.6, 0.81), **changes,
    )  # fmt: skip


def answers(made):
    return [" ".join(a.answer) for a in story(made, LENGTH, "extended.yaml").answers]
