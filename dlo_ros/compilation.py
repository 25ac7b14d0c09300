# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compilation of the numerical kernels in processes of their own, shared by all nodes and tools.

Each part of the kernels has files in the cache folder: a lock that the process holds that compiles
it, its progress, and a mark that it is complete. Whoever wants a part that nobody compiles starts a
process for it; a lock ends with its process, whatever ends that. `dlo_ros.compile` is the command
of such a process.
"""

from __future__ import annotations

import fcntl
import logging
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from dlo_ros.errors import KernelError
from dlo_ros.kernel_cache import (
    PACKAGE,
    cache_folder,
    is_file,
    jit_disabled,
    mark,
    require_writable,
)
from dlo_ros.kernel_parts import STAGES
from dlo_ros.own_process import command_of

LOG = logging.getLogger(__name__)

PROCESSES = 2
"""Compiling processes at a time, over all nodes; each takes half a gigabyte."""

SETTLED = 3.0
"""Seconds after which the remaining time follows from the rate so far."""

LEAST_FRACTION = 0.03
"""Fraction of the whole after which the remaining time follows from the rate so far."""

WAIT = 0.1
"""Seconds between two looks at what other processes do."""

REPORT_INTERVAL = 10.0
"""Seconds between two messages on the progress."""


WORKER = (*command_of("dlo_ros.compile"), "--worker")
"""The command of a compiling process; stages follow."""

FIRST_MESSAGE = "compiling the numerical kernels, once; this takes a minute or two"
FAILED = "the numerical kernels could not be compiled"


@dataclass(frozen=True)
class CompilationProgress:
    """The progress of a compilation.

    Args:
        done: whether the kernels can be loaded from the cache.
        fraction: fraction that is done, 0 to 1.
        remaining_seconds: estimated rest [s]; None where nothing is known yet.
        error: the reason why it ended before it was done, one line; otherwise empty.
    """

    done: bool
    fraction: float
    remaining_seconds: float | None
    error: str = ""

    def __str__(self) -> str:
        if self.done:
            return "compiled"
        if self.error:
            return self.error
        rest = self.remaining_seconds
        about = "" if rest is None else f", about {max(1, round(rest))} s"
        return f"compiling, {100 * self.fraction:.0f} %{about}"


class PartFiles:
    """The files of one part in a cache folder.

    Args:
        folder: the cache folder.
        part: name of the part.
    """

    def __init__(self, folder: Path, part: str) -> None:
        self.mark = mark(folder, part)
        self.lock = self.mark.with_suffix(".lock")
        self._progress = self.mark.with_suffix(".progress")

    @property
    def complete(self) -> bool:
        """Whether the machine code is there."""
        return is_file(self.mark)

    @property
    def functions(self) -> int:
        """Number of functions that are compiled, by the compiling process' last report."""
        for file in (self.mark, self._progress):
            with suppress(OSError, ValueError):
                return max(0, int(file.read_text()))
        return 0

    def report(self, functions: int) -> None:
        """Let others know how far the compilation is."""
        _replace(self._progress, str(functions))

    def finish(self, functions: int = 0) -> None:
        """Mark the part as complete."""
        _replace(self.mark, str(functions))
        self._progress.unlink(missing_ok=True)


class BackgroundCompilation:
    """Has kernels compiled in processes of their own, or by those that others have started.

    Args:
        stages: names in `STAGES`, those that are needed first first.

    Raises:
        KernelError: numba is not installed, or kernels are missing and no folder for compiled code
            can be written.
    """

    def __init__(self, stages: Sequence[str]) -> None:
        folder = cache_folder()
        self._stages = tuple(stages)
        parts = [part for stage in stages for part in STAGES[stage]]
        self._files = {part.name: PartFiles(folder, part.name) for part in parts}
        self._workers: list[subprocess.Popen[bytes]] = []
        self._said = b""
        self._error = ""
        self._began: tuple[float, float] | None = None
        self._done = jit_disabled() or self._complete()
        LOG.info(
            "kernels of %s: %s, in %s",
            ", ".join(stages), "compiled" if self._done else "to be compiled", folder,
        )  # fmt: skip
        if not self._done:
            require_writable(folder)

    def __enter__(self) -> BackgroundCompilation:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> bool:
        """Begin to compile what is not in the cache; returns at once, whether there is any."""
        missing = sum(not files.complete for files in self._files.values())
        self._done = self._done or not missing
        if self._done:
            return False
        self._began = time.monotonic(), self._fraction()
        environment = dict(os.environ)
        paths = [str(PACKAGE.parent), environment.get("PYTHONPATH", "")]
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
        try:
            for _ in range(min(missing, PROCESSES)):
                worker = subprocess.Popen(
                    (*WORKER, *self._stages),
                    env=environment,
                    stdin=subprocess.PIPE,  # its end shows the worker that this process has ended
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.PIPE,
                )
                assert worker.stderr is not None
                os.set_blocking(worker.stderr.fileno(), False)
                self._workers.append(worker)
        except OSError as err:
            self.stop()
            self._error = f"{FAILED}: {err.strerror or err}"
        return True

    def poll(self) -> CompilationProgress:
        """Present progress of the compilation; takes less than a millisecond."""
        error = ""
        if not self._done and not self._error and self._workers:
            error = self._failure()
        # Looked at after the workers: the last may have ended with its work done just now.
        if not self._done and self._complete():
            self._done = True
            self.stop()
        if self._done:
            return CompilationProgress(True, 1.0, 0.0)
        if error:
            self._error = error
            self.stop()
        fraction = self._fraction()
        return CompilationProgress(False, fraction, self._remaining(fraction), self._error)

    def stop(self) -> None:
        """End the processes that this one has started; others that wait go on with the work."""
        for worker in self._workers:
            if worker.poll() is None:
                worker.kill()  # a lock, and what is written halfway, does no harm
            worker.wait()
            for stream in (worker.stdin, worker.stderr):
                if stream is not None:
                    stream.close()
        self._workers.clear()

    def wait(self, report: Callable[[str], object]) -> None:
        """Return when all is compiled; `start` has been called.

        Args:
            report: function that is called with a one-line message, at the start and then every ten
                seconds.

        Raises:
            KernelError: the compilation fails.
        """
        progress, reported = self.poll(), -REPORT_INTERVAL
        while not progress.done:
            if progress.error:
                raise KernelError(progress.error)
            if time.monotonic() - reported > REPORT_INTERVAL:
                begins = progress.remaining_seconds is None and reported < 0.0
                report(FIRST_MESSAGE if begins else f"the numerical kernels: {progress}")
                reported = time.monotonic()
            time.sleep(WAIT)
            progress = self.poll()

    def _complete(self) -> bool:
        return all(files.complete for files in self._files.values())

    def _fraction(self) -> float:
        whole = made = 0.0
        for stage in self._stages:
            parts = STAGES[stage]
            files = [self._files[part.name] for part in parts]
            seconds = sum(part.seconds for part in parts)
            share = sum(f.functions for f in files) / sum(part.functions for part in parts)
            whole += seconds
            made += seconds * (1.0 if all(f.complete for f in files) else min(share, 0.99))
        return made / whole

    def _remaining(self, fraction: float) -> float | None:
        if self._began is None or self._error:
            return None
        began, first = self._began
        now = time.monotonic()
        if fraction <= first:  # it waits for other parts: no measure of its rate
            self._began = now, fraction
            return None
        elapsed = now - began
        if elapsed < SETTLED or fraction - first < LEAST_FRACTION:
            return None
        return elapsed * (1.0 - fraction) / (fraction - first)

    def _failure(self) -> str:
        """Reason why all workers have ended without a result; empty while one goes on."""
        states = []
        for worker in self._workers:
            assert worker.stderr is not None
            states.append(worker.poll())
            self._said += worker.stderr.read() or b""
        if None in states:  # it takes over what another one has left
            return ""
        failed = [state for state in states if state]
        lines = self._said.decode(errors="replace").strip().splitlines()
        if not failed:
            reason = "what was compiled has vanished from the cache folder"
        elif failed[0] and failed[0] < 0:
            reason = f"the compiling process was killed (signal {-failed[0]})"
        else:
            reason = lines[-1] if lines else f"the compiling process ended with {failed[0]}"
        return f"{FAILED}: {reason}"


def compile_first(stages: Sequence[str], report: Callable[[str], object]) -> None:
    """Return when kernels can be loaded from the cache; a compilation is reported, loading is not.

    Args:
        stages: names in `STAGES`.
        report: function that is called with a one-line message, at the beginning and then every ten
            seconds.

    Raises:
        KernelError: numba is not installed, the cache cannot be written or the compilation fails.
    """
    with BackgroundCompilation(stages) as compilation:
        compilation.wait(report)


@contextmanager
def held(lock: Path) -> Iterator[bool]:
    """Hold a lock that no other process holds; gives whether that is so."""
    with lock.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True


def _replace(file: Path, text: str) -> None:
    """Write a file as a whole: who reads it meanwhile finds the old one."""
    new = file.with_name(f"{file.name}.{os.getpid()}")
    new.write_text(text)
    new.replace(file)
