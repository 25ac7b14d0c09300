# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A package with nothing of dlo_ros in it but the modules that compile and link functions."""

import shutil

from conftest import ROOT

NAMES = ("kernel_arguments.py", "kernel_cache.py", "kernel_linking.py")
"""Modules that compile functions, and have none that are compiled."""


def copied(folder):
    """A folder dlo_ros with these modules and what they import."""
    package = folder / "dlo_ros"
    package.mkdir()
    for name in ("__init__.py", "errors.py", "kernel_parts.py", *NAMES):
        shutil.copy(ROOT / "dlo_ros" / name, package)
    return package
