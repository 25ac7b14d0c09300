# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Identification on measured wires, whose truth nobody knows: does it agree with itself?"""

import pytest

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.identification import identify
from dlo_ros.parameters import Settings


@pytest.fixture(scope="module")
def white(shared_data):
    folder = shared_data / "hanging_loop" / "white"
    settings = Settings.load(folder / "params.yaml")
    return settings, [load_manipulation(folder / f"trial{k}", settings) for k in range(3)]


def found(white, numbers, factor=1.0, validate=()):
    settings, trials = white
    guess = settings.with_material(factor * settings.rod.young_modulus, settings.rod.density)
    return identify([trials[k] for k in numbers], guess, [trials[k] for k in validate])


@pytest.mark.slow
def test_trials_of_one_wire_agree_within_their_std(white):
    estimates = [found(white, [k]).estimate for k in range(3)]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        apart = estimates[a].specific_modulus - estimates[b].specific_modulus
        spread = estimates[a].specific_modulus_std ** 2 + estimates[b].specific_modulus_std ** 2
        assert abs(apart) < 2.0 * spread**0.5
    for estimate in estimates:
        assert estimate.specific_modulus_std > 0.02 * estimate.specific_modulus
        assert estimate.identifiable["specific_modulus"]
        assert not estimate.identifiable["density"]


@pytest.mark.slow
def test_the_starting_value_does_not_matter(white):
    low, high = (found(white, [0], factor).estimate for factor in (0.1, 10.0))
    assert low.specific_modulus == pytest.approx(high.specific_modulus, rel=0.02)


@pytest.mark.slow
def test_two_trials_predict_the_third_as_they_match_themselves(white):
    for out in range(3):
        result = found(white, [k for k in range(3) if k != out], validate=[out])
        *train, held = (r.err for r in result.recordings)
        assert held < 1.5 * max(train)
