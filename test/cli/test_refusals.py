# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Reasons why pictures show no credible DLO."""

from dlo_ros.cli.refusals import Refusals


def test_reasons_that_differ_in_numbers_alone_are_alike():
    refusals = Refusals()
    assert refusals.main("it has no images") == "it has no images" and refusals.total == 0
    for length in (0.453, 0.4531, 4e-05):
        refusals.add(f"what looks like the DLO is {length:.3g} m long, rod.length is 0.486 m")
    for _ in range(2):
        refusals.add("the picture is blurred")
    assert refusals.total == 5
    first = "what looks like the DLO is 0.453 m long, rod.length is 0.486 m"
    assert refusals.commonest(5) == [(first, 3), ("the picture is blurred", 2)]
    assert refusals.main("none") == first
