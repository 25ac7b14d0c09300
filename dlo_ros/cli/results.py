"""The folder into which a tool writes its results."""

from __future__ import annotations

import argparse
from pathlib import Path

from dlo_ros.errors import InputError


def add_results_folder(parser: argparse.ArgumentParser) -> None:
    """The argument `--output`."""
    parser.add_argument(
        "--output", type=Path, required=True, metavar="DIR", help="folder for the results"
    )


def check_results_folder(output: Path) -> None:
    """Refuse an output that cannot be a folder, before any work is done.

    Raises:
        InputError: it is a file.
    """
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file; give a folder for the results")
