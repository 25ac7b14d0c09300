# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Clamps that point a little elsewhere than commanded are fitted along, as far as they may."""

from dataclasses import replace

import numpy as np
import pytest
from measured import at_rest, swing
from rods import PAPER

from dlo_ros.cli.main import main
from dlo_ros.errors import InputError
from dlo_ros.identification import identify
from dlo_ros.identification.loose import Loose
from dlo_ros.rod.tangents import tangent

pytestmark = pytest.mark.long

RATIO = PAPER.rod.specific_modulus
TURNED = 0.04  # [rad]


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


def test_a_clamp_that_is_loose_is_found_and_the_ratio_with_it(turned, guess):
    fixed = identify([turned], guess)
    found = identify([turned], guess, loose=Loose(clamp_angle=0.05))
    value, std = found.loose["effects.clamp_angle.start"]
    assert value == pytest.approx(TURNED, abs=max(4.0 * std, 2e-3))
    assert std < 0.01
    estimate = found.estimate
    assert abs(estimate.specific_modulus - RATIO) < 3.0 * estimate.specific_modulus_std
    assert estimate.specific_modulus == pytest.approx(RATIO, rel=0.01)
    assert abs(fixed.estimate.specific_modulus / RATIO - 1.0) > 0.02
    assert found.recordings[0].err < 0.3 * fixed.recordings[0].err
    # What the nodes load contains it.
    assert estimate.settings.effects["clamp_angle"]["start"] == value


def test_what_cannot_be_told_apart_stays_where_it_was_and_widens_the_std(guess):
    recording = at_rest(PAPER, same=False)
    exact = identify([recording], guess).estimate
    found = identify([recording], guess, loose=Loose(clamp_angle=0.05, tilt=0.03, length=0.01))
    assert set(found.loose) == {
        "effects.clamp_angle.start", "effects.gravity_tilt.angle",
        "effects.length_error.difference",
    }  # fmt: skip
    for value, std in found.loose.values():
        assert abs(value) < 3.0 * std
    assert found.estimate.specific_modulus_std > 1.5 * exact.specific_modulus_std
    off = found.estimate.specific_modulus - RATIO
    assert abs(off) < 3.0 * found.estimate.specific_modulus_std


def test_nothing_is_loose_unless_it_is_said(turned, guess):
    assert identify([turned], guess, loose=Loose()).loose == {}
    with pytest.raises(InputError, match="clamp_angle is -1"):
        Loose(clamp_angle=-1.0)
    with pytest.raises(InputError, match="tilt is nan"):
        Loose(tilt=np.nan)


def test_a_negative_std_is_told_in_a_line(tmp_path, capsys):
    params = tmp_path / "params.yaml"
    PAPER.dump(params)
    words = ["identify", "--params", str(params), "--output", str(tmp_path / "out"), "bag"]
    assert main([*words, "--tilt-std", "-0.1"]) == 2
    assert "tilt" in capsys.readouterr().err.strip()
