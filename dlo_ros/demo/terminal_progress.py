# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The demo's progress in the terminal while the recording plays."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table

from dlo_ros.command import NANOSECONDS
from dlo_ros.demo.result import with_std
from dlo_ros.nodes.received_data import QUANTITIES, SYMBOLS, ReceivedData


class Progress:
    """A table that moves on a terminal, a line for each second of the recording elsewhere.

    Args:
        console: console to write to.
        duration: duration of the recording [s].
    """

    def __init__(self, console: Console, duration: float) -> None:
        self._console = console
        self._duration = duration
        self._start: int | None = None
        self._printed = -1
        self._live = Live(console=console, refresh_per_second=8) if console.is_terminal else None

    def __enter__(self) -> Progress:
        if self._live:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        err: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live:
            self._live.stop()

    def update(self, received: ReceivedData) -> None:
        """Show the state; may be called as often as needed."""
        if not received.now:
            return
        if self._start is None:
            self._start = received.now
        time = (received.now - self._start) / NANOSECONDS
        if self._live:
            self._live.update(self._table(time, received))
        elif int(time) > self._printed:
            self._printed = int(time)
            self._console.print(line(time, received), highlight=False, soft_wrap=True)

    def _table(self, time: float, received: ReceivedData) -> Group:
        table = Table(box=None, show_header=False, padding=(0, 2))
        table.add_row("time", f"{time:.1f} of {self._duration:.1f} s")
        table.add_row("observed", f"{len(received.observed)} splines")
        table.add_row("ERR", _err(received))
        sample = received.estimate()
        for name in QUANTITIES:
            table.add_row(SYMBOLS[name], with_std(sample, name) if sample else "not yet")
        return Group(ProgressBar(total=self._duration, completed=time, width=60), table)


def line(time: float, received: ReceivedData) -> str:
    """The state in one line."""
    parts = [f"{time:5.1f} s", f"ERR {_err(received)}"]
    sample = received.estimate()
    if sample:
        parts += [f"{SYMBOLS[name]} {with_std(sample, name)}" for name in QUANTITIES]
    return "  ".join(parts)


def _err(received: ReceivedData) -> str:
    return f"{received.err[-1][1] * 1e3:.2f} mm" if received.err else "not yet"
