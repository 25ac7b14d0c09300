# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Which of many like cases run with every `make test`; `make test-slow` runs the others."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def some_of(cases: Iterable[Any], ordinary: Collection[Any]) -> list[Any]:
    """Cases for `parametrize`, slow but for the ordinary ones, which must be among them."""
    every = list(cases)
    missing = [case for case in ordinary if case not in every]
    assert not missing, f"there is no such case: {missing}"
    return [c if c in ordinary else pytest.param(c, marks=pytest.mark.slow) for c in every]
