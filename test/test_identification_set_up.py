# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The set-up within its tolerances: found where the data show it, and counted in every std."""

from dataclasses import replace

import pytest
from measured import at_rest, swing
from rods import PAPER

from dlo_ros.cli.main import main
from dlo_ros.identification import identify
from dlo_ros.parameters import Settings, tolerance
from dlo_ros.rod.tangents import tangent

pytestmark = pytest.mark.long

RATIO = PAPER.rod.specific_modulus
TURNED = 0.04  # [rad]


def with_values(settings, **values):
    """Settings with other values, dots written as two underscores."""
    changed = {key.replace("__", "."): value for key, value in values.items()}
    return Settings.from_mapping(settings.flat() | changed)


@pytest.fixture(scope="module")
def turned():
    """A swing of which the command tells another direction of the clamp than it had."""
    recording = swing(PAPER, seconds=1.5)
    (imposed,) = recording.commands
    _, other = tangent(PAPER, "start.angle").vary(PAPER, imposed, -TURNED)
    return replace(recording, commands=(other,))


@pytest.fixture(scope="module")
def guess():
    return PAPER.with_material(2e7, 2000.0)


def test_a_clamp_that_points_elsewhere_is_found_and_the_ratio_with_it(turned, guess):
    exact = with_values(
        guess,
        **{
            f"effects__{name}__{key}_std": 0.0
            for name, key in (("clamp_angle", "start"), ("gravity_tilt", "angle"),
                              ("camera_rotation", "angle"), ("clamp_offset", "start"))
        },
    )  # fmt: skip
    assert tolerance(exact, "clamp_angle.start") == 0.0
    without = identify([turned], exact)
    assert "effects.clamp_angle.start" not in without.set_up
    found = identify([turned], guess)
    value, std = found.set_up["effects.clamp_angle.start"]
    assert abs(value - TURNED) < 3.0 * std
    assert std < 0.02
    estimate = found.estimate
    assert abs(estimate.specific_modulus - RATIO) < 2.0 * estimate.specific_modulus_std
    assert estimate.specific_modulus == pytest.approx(RATIO, rel=0.02)
    assert found.recordings[0].err < 0.7 * without.recordings[0].err
    # What the nodes load contains it.
    assert estimate.settings.effects["clamp_angle"]["start"] == value


def test_a_set_up_as_stated_is_taken_as_exact(guess):
    found = identify([swing(PAPER, seconds=1.5)], guess)
    assert found.set_up == {}
    assert not found.estimate.settings.effects
    assert found.estimate.specific_modulus == pytest.approx(RATIO, rel=2e-3)


def test_what_cannot_be_told_apart_widens_the_std(guess):
    # Shapes at rest tell little of how they are held.
    exact = identify([at_rest(PAPER, same=False)], guess).estimate
    unsure = with_values(guess, rod__diameter_std=0.02 * PAPER.rod.diameter)
    found = identify([at_rest(PAPER, same=False)], unsure).estimate
    assert found.specific_modulus_std > 0.039 * RATIO > exact.specific_modulus_std


def test_a_negative_std_is_told_in_a_line(tmp_path, capsys):
    params = tmp_path / "params.yaml"
    PAPER.dump(params)
    words = ["identify", "--params", str(params), "--output", str(tmp_path / "out"), "bag"]
    assert main([*words, "--tilt-std", "-0.1"]) == 2
    assert "--tilt-std is -0.1; it must be zero or positive" in capsys.readouterr().err
