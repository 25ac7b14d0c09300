# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Child processes that end with their parent, whatever happens."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from dlo_ros.errors import DloError
from dlo_ros.own_process import command_of

# Patience [s] with a child that was asked to end, first kindly, then firmly.
INTERRUPT_TIMEOUT = 6.0
TERMINATE_TIMEOUT = 3.0
LAST_LINES = 3


class ProcessError(DloError):
    """A child process ended before its time."""


@dataclass(frozen=True)
class Child:
    """A running process.

    Args:
        name: the process' name in messages.
        process: the process itself.
        log: file with what the process printed.
    """

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def failure(self) -> str:
        """The exit and the last output, in one line."""
        status = self.process.poll()
        said = self.log.read_text(errors="replace").strip().splitlines()[-LAST_LINES:]
        last = " | ".join(line.strip() for line in said) or "it printed nothing"
        return f"{self.name} ended with status {status}: {last} (all of it in {self.log})"


class Children:
    """Starts executables of this package as processes of their own; leaving the block ends them."""

    def __init__(self, logs: Path, environment: Mapping[str, str]) -> None:
        self._logs = logs
        self._environment = dict(environment)
        self._children: list[Child] = []

    def __enter__(self) -> Children:
        self._logs.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        err: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def start(self, name: str, arguments: Sequence[str]) -> Child:
        """Start `dlo_ros NAME ARGUMENTS`; what it prints goes to a file of its name."""
        log = self._logs / f"{name}.log"
        with log.open("wb") as output:
            process = subprocess.Popen(
                [*command_of("dlo_ros"), name, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=self._environment,
                # Ctrl-C in the terminal is for the parent, which ends its children in order.
                start_new_session=True,
            )
        child = Child(name, process, log)
        self._children.append(child)
        return child

    def check(self, *finishing: Child) -> None:
        """Fail where a child has ended that should run; `finishing` may have ended well.

        Raises:
            ProcessError: says which child ended and its last words.
        """
        for child in self._children:
            status = child.process.poll()
            if status is not None and not (status == 0 and child in finishing):
                raise ProcessError(child.failure())

    def stop(self) -> None:
        """End all children: interrupted first, so that they end as with Ctrl-C, then by force."""
        previous = signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C must not stop us
        try:
            for sign, patience in (
                (signal.SIGINT, INTERRUPT_TIMEOUT),
                (signal.SIGTERM, TERMINATE_TIMEOUT),
            ):
                self._signal(sign)
                if self._all_ended(patience):
                    return
            self._signal(signal.SIGKILL)
            self._all_ended(TERMINATE_TIMEOUT)
        finally:
            signal.signal(signal.SIGINT, previous)

    def _signal(self, sign: signal.Signals) -> None:
        for child in reversed(self._children):
            if child.process.poll() is None:
                child.process.send_signal(sign)

    def _all_ended(self, patience: float) -> bool:
        deadline = time.monotonic() + patience
        for child in self._children:
            try:
                child.process.wait(max(deadline - time.monotonic(), 0.0))
            except subprocess.TimeoutExpired:
                return False
        return True
