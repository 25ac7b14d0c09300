# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Recordings between which the shape at rest has changed."""

from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from experiment_recordings import recorded

from dlo_ros.diagnosis.findings import next_recording
from dlo_ros.diagnosis.findings.rest_change import RestChange, rest_change
from dlo_ros.inference.joint import simulate
from dlo_ros.inference.measured import measured
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.synthesis.experiment import find_experiment

MATTERS = 0.5e-3
BENT = {"intrinsic_curvature": {"curvature": [1.5]}}


def rested(name, seed, effects=(), higher=0.0, waits=1.0):
    """A recording that waits before it lifts the end of a rope."""
    tree = yaml.safe_load(find_experiment("simple").read_text())
    tree["parameters"]["effects"] = dict(effects)
    tree["duration"] = 1.5
    x, y, z = tree["motion"]["control_point_10"][0]["position"]
    tree["motion"]["control_point_10"] = [
        {"time": waits, "position": [x, y, z + higher]},
        {"time": 1.5, "position": [x, y, z + higher + 0.02]},
    ]
    recording, _, truth = recorded(tree, seed, name, step=1e-3)
    truth = truth.with_effects({})
    return measured(recording, truth), truth


def compared(*rows):
    recordings = [recording for recording, _ in rows]
    shown = simulate(ParametricModel(rows[0][1], ()), recordings, ())
    return rest_change(shown, recordings, MATTERS)


def test_a_rope_that_was_bent_meanwhile_is_told_with_both_recordings():
    before, again, after = rested("before", 1), rested("again", 2), rested("after", 3, BENT)
    assert compared(before, again) is None
    found = compared(before, again, after)
    assert found is not None
    assert "after" in found.names
    apart = after[0].observed[0] - before[0].observed[0]
    assert found.distance == pytest.approx(np.linalg.norm(apart, axis=1).mean(), rel=0.2)
    assert found.expected < 1e-5


def test_a_rope_that_is_held_otherwise_is_not():
    assert compared(rested("before", 1), rested("higher", 2, higher=0.02)) is None


def test_a_rope_that_moves_at_once_tells_nothing():
    moving = rested("after", 3, BENT, waits=0.0)
    assert moving[0].frames_at_rest < 10
    assert compared(rested("before", 1), moving) is None


def test_the_advice_tells_it_where_nothing_explains_all():
    found = SimpleNamespace(causes=(), shifts={}, at=None)
    changed = RestChange(("before", "after"), 12.3e-3, 0.4e-3)
    said = next_recording.advice("unexplained", found, changed)
    assert said.startswith(
        "In before and in after the DLO is once held alike, so that its shapes should agree to "
        "0.4 mm, and yet it rests 12 mm apart:"
    )
    assert next_recording.REPEAT not in said
    assert next_recording.advice("unexplained", found) == next_recording.REPEAT
