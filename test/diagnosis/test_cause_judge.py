# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Whether what a cause explains matters."""

from types import SimpleNamespace

import numpy as np
import pytest
from cause_fits import evaluation

from dlo_ros.diagnosis.explain.cause_judge import Judge


@pytest.mark.parametrize(
    ("effect", "errs"), [("point_mass", (1e-3, 2e-3, 1.5e-3)), ("obstacle", (1e-3, 5e-3, 3e-3))]
)
def test_what_acts_now_and_then_counts_where_it_acts(effect, errs):
    """A peg that is hit in one of four recordings; a mass acts in all, wherever it began."""
    at, bare = evaluation(0.0, 1e-3), evaluation(0.0, 2e-3)
    at.err = [np.full(9, 1e-3)] * 4
    bare.err = [*at.err[:3], np.full(9, 5e-3)]
    owns = [1e-3, 1e-3, 1e-3, 3e-3]
    judge = Judge(at, bare, (), owns, 0.0, exact=False, complete=True)
    group = SimpleNamespace(effect=effect, from_nothing=False)
    assert judge._errs_where_it_acts(at, bare, group) == pytest.approx(errs)
