# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measured cables on a robot's flange: a weight that hangs on one is found, on others none."""

import json

import pytest

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.diagnosis.explain.joint_explanation import explain
from dlo_ros.diagnosis.findings.joint_learning import training_set
from dlo_ros.diagnosis.findings.joint_numbers import effect_numbers
from dlo_ros.identification.estimate import searchable
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.parameters import Settings

pytestmark = pytest.mark.slow
WEIGHTS = ("point_mass", "connector")


def explained(folder):
    """Both static sweeps by the joint model, and the parameter file."""
    given = searchable(Settings.load(folder / "params.yaml"))
    sweeps = [load_manipulation(folder / f"static_{s}", given) for s in ("positive", "negative")]
    begun = begin(sweeps, given)
    prepared = training_set(begun, len(sweeps), begun.at.model.settings, given)
    assert prepared is not None
    return explain(prepared.prepared, given).with_names(), given


def test_the_weight_on_a_cable_is_named(shared_data):
    folder = shared_data / "cable_swing" / "orange_short_weighted"
    found, given = explained(folder)
    named = [c for c in found.causes if c.effect in WEIGHTS]
    assert named and found.at.mean_err < found.setup.mean_err
    true = json.loads((folder / "info.json").read_text())["end_mass_kg"]
    mass = effect_numbers(named[0].effect, found.at, given)["mass"]
    assert isinstance(mass.value, float) and isinstance(mass.std, float)
    assert abs(mass.value - true) < 2.0 * mass.std


def test_no_weight_is_named_where_none_hangs(shared_data):
    found, _ = explained(shared_data / "cable_swing" / "black_unweighted")
    assert not [c.effect for c in found.causes if c.effect in WEIGHTS]
    assert found.at.mean_err <= found.setup.mean_err
