# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Values at the ends of their ranges mean what they say."""

import numpy as np
import pytest
from rods import PAPER, held_start, settled

from dlo_ros.effects.registry import check
from dlo_ros.errors import ParameterError


def test_a_dlo_that_hardens_as_stiff_as_before_its_yield_is_elastic():
    def shape(**effects):
        return settled(PAPER.with_effects(effects), held_start(), 28)[2].state.q

    hard = shape(plasticity={"yield_curvature": 0.5, "hardening": 1.0})
    soft = shape(plasticity={"yield_curvature": 0.5, "hardening": 0.5})
    np.testing.assert_allclose(hard, shape(), atol=1e-12)
    assert np.abs(soft - shape()).max() > 1e-3 * PAPER.rod.length


def test_something_of_a_creeping_dlo_must_hold_it_up():
    assert check("viscoelasticity", "share", 0.999) == 0.999
    with pytest.raises(ParameterError, match=r"share is 1.0; it must be a number from 0 to 0.999"):
        check("viscoelasticity", "share", 1.0)
