# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A progress bar on the terminal; no output where stderr is a file."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, ProgressColumn, TaskID

LOG = logging.getLogger(__name__)


@contextmanager
def progress_bar(*columns: str | ProgressColumn) -> Iterator[Progress]:
    """A bar on stderr while the block runs; where stderr is a file not even an empty line.

    Args:
        columns: columns of the bar; without any, those that rich shows by default.
    """
    console = Console(stderr=True)
    bar = Progress(*columns, console=console, transient=True)
    if not console.is_terminal:  # started, and even disabled, rich would end with an empty line
        yield bar
        return
    with bar:
        yield bar


def steps(bar: Progress, task: TaskID) -> Callable[[str, float], None]:
    """A function that is called with the name of a step and the share of it that is done.

    It shows both on the bar, and each step once in the log.
    """
    last = ""

    def progress(text: str, share: float) -> None:
        nonlocal last
        if text != last:
            last = text
            LOG.info("%s", text)
        bar.update(task, description=text.capitalize(), completed=share)

    return progress
