# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A progress bar on the terminal, and nothing at all where there is none."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, ProgressColumn


@contextmanager
def progress_bar(*columns: str | ProgressColumn) -> Iterator[Progress]:
    """A bar on stderr while the block runs; where stderr is a file not even an empty line.

    Args:
        columns: what it shows; rich's usual where none is given.
    """
    console = Console(stderr=True)
    bar = Progress(*columns, console=console, transient=True)
    if not console.is_terminal:  # started, and even disabled, rich would end with an empty line
        yield bar
        return
    with bar:
        yield bar
