# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""From two cameras' pictures of a rope in space to E/mu, and to a hidden cause.

`python -m field.stereo` draws as many cases as wanted.
"""

import numpy as np
import pytest
from field.evaluate import judge
from field.stereo import KINDS, draw, solve

from dlo_ros.synthesis.experiment import read_experiment


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_ratio_and_the_cause_are_found(kind, tmp_path):
    case = draw(1, kind)
    found = solve(case, tmp_path)
    assert found.seen > 0.95
    assert abs(found.off) < 0.02
    assert abs(found.off) < 3.0 * found.std
    if case.causes:
        assert judge(case, found.report) == ("named", ())


def test_a_case_is_drawn_in_space_from_its_seed():
    one, two, other = draw(3, "cause"), draw(3, "cause"), draw(4, "cause")
    assert one == two and set(one.causes) != set(other.causes)
    assert draw(3, "free").causes == {}
    for tree in one.trees:
        made = read_experiment(tree, "case", "a test")
        assert made.spatial and len(made.cameras) == 2
        assert np.ptp(made.command.positions[:, :, 1]) > 0.005
        rod, guess = made.truth.rod, made.guess.rod
        assert 1.0 / 31.0 < guess.young_modulus / rod.young_modulus < 31.0
        assert not made.guess.effects
