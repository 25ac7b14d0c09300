# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The paper's tables on data of the independent simulator: the same orderings."""

import pytest

from paper.__main__ import html, tree
from paper.results import results


@pytest.mark.slow
def test_the_orderings_of_table_four_and_the_automatic_procedure():
    found = results(seed=5)
    assert [claim for claim, holds in found.checks if not holds] == []
    for automatic in found.automatic:
        estimate = automatic.estimate
        assert estimate.specific_modulus == pytest.approx(2e4, rel=0.01)
        assert not estimate.identifiable["density"]
    assert len(tree(found)["table"]) == 9
    page = html(found)
    for title in ("Figure 3", "Figure 5", "Figure 7", "Figure 9", "Figure 11", "Table IV"):
        assert title in page
    assert "http" not in page
