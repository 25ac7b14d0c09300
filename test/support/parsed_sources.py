# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Sources of the package as trees, each parsed once for all tests that look at them."""

import ast
from functools import cache


@cache
def parsed(path):
    """The tree of a Python file, which is not to be changed."""
    return ast.parse(path.read_text())
