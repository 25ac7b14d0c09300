# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The folder into which a tool writes its results."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from dlo_ros.errors import InputError
from dlo_ros.parameters import Settings

QUANTITIES = (
    ("young_modulus", "Young's modulus E", "Pa"),
    ("density", "density mu", "kg/m^3"),
    ("specific_modulus", "E/mu", "m^2/s^2"),
)
"""Of the material: key in JSON, words, unit."""


def add_results_folder(parser: argparse.ArgumentParser) -> None:
    """The argument `--output`."""
    parser.add_argument(
        "--output", type=Path, required=True, metavar="DIR", help="folder for the results"
    )


def check_results_folder(output: Path) -> None:
    """Refuse an output that cannot be a folder with new files, before any work is done.

    Raises:
        InputError: it is a file or lies below one, or nothing can be written there.
    """
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file; give a folder for the results")
    there = next(path for path in (output, *output.absolute().parents) if path.exists())
    if not there.is_dir():
        raise InputError(f"{output}: cannot be written ({there} is a file)")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{output}: cannot be written (no permission to write in {there})")


def with_std(settings: Settings, std: float | None) -> Settings:
    """Settings as a parameter file states them, with the standard deviation of E/mu [m^2/s^2].

    Args:
        std: None: it is not known.
    """
    return replace(settings, rod=replace(settings.rod, specific_modulus_std=std or 0.0))


@contextmanager
def written(output: Path) -> Iterator[None]:
    """Says which results cannot be written.

    Raises:
        InputError: in place of an OSError.
    """
    try:
        yield
    except OSError as err:
        raise InputError(f"{output}: cannot be written ({err.strerror})") from err
