# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Locations of the files that come with the package: config, launch."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from dlo_ros.errors import InputError

NAME = "dlo_ros"


def shared_file(relative: str) -> Path:
    """A file of the package's share folder, such as `config/experiments/c_shape.yaml`.

    Raises:
        InputError: the package was installed without it.
    """
    looked = list(_folders())
    for folder in looked:
        if (folder / relative).is_file():
            return folder / relative
    places = ", ".join(str(folder) for folder in looked)
    raise InputError(f"{relative} is not among the files of dlo_ros (looked in {places})")


def _folders() -> Iterator[Path]:
    """Candidates: the sources (editable install), ROS's prefixes (colcon), Python's (pip)."""
    package = Path(__file__).resolve().parent
    if (package.parent / "package.xml").is_file():
        yield package.parent
    # A prefix holds the package somewhere below, as in PREFIX/lib/python3.12/site-packages.
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    for prefix in (*map(str, package.parents), *filter(None, prefixes)):
        folder = Path(prefix) / "share" / NAME
        if folder.is_dir():
            yield folder
