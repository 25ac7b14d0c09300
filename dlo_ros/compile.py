# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The command `python -m dlo_ros.compile [STAGE ...]`: compile the numerical kernels beforehand.

Nodes and tools start without a pause then. Each part runs on something small; numba keeps what it
compiled in the cache folder. With `--worker` this process compiles by itself what no other process
does, and ends when all is there. The work itself is in `compile_rod`, `compile_vision` and
`compile_synthesis`; `compilation` shares it between the processes of nodes and tools.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from dlo_ros.compilation import PROCESSES, WAIT, PartFiles, compile_first, held
from dlo_ros.errors import DloError
from dlo_ros.kernel_cache import cache_folder, machine
from dlo_ros.kernel_parts import STAGES, Part

NICENESS = 10
"""What starts meanwhile, and answers, comes first."""

GARBAGE = 100_000
"""Objects between two looks for unreachable ones: by default a tenth of the time goes there."""

INTERVAL = 0.2
"""Seconds between two notes on the progress."""


def main(words: Sequence[str] | None = None) -> int:
    """Compile the stages; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m dlo_ros.compile", description="Compile the numerical kernels."
    )
    parser.add_argument("stages", nargs="*", metavar="STAGE", help=f"of {', '.join(STAGES)}")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args(words)
    stages = arguments.stages or list(STAGES)
    unknown = [stage for stage in stages if stage not in STAGES]
    if unknown:
        parser.error(f"'{unknown[0]}' is unknown; choose from {', '.join(STAGES)}")
    try:
        if arguments.worker:
            _follow_parent()
            gc.set_threshold(GARBAGE)
            work([part for stage in stages for part in STAGES[stage]])
        else:
            began = time.perf_counter()
            compile_first(stages, lambda text: print(text, flush=True))
            print(f"the numerical kernels are compiled ({time.perf_counter() - began:.0f} s)")
    except DloError as err:
        print(err, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except OSError as err:
        where = f"{err.filename}: " if err.filename else ""
        print(f"{where}{err.strerror or err}", file=sys.stderr)
        return 2
    return 0


def work(parts: Sequence[Part]) -> None:
    """Compile parts, and wait for those that other processes compile.

    Raises:
        OSError: the cache folder cannot be written.
        DloError: a kernel fails.
    """
    folder = cache_folder()
    files = {part.name: PartFiles(folder, part.name) for part in parts}
    while missing := [part for part in parts if not files[part.name].complete]:
        if not any(_try(part, files[part.name]) for part in missing):
            time.sleep(WAIT)


def _try(part: Part, files: PartFiles) -> bool:
    """Compile a part unless another process does so, or enough others are at work."""
    for number in range(PROCESSES):
        with held(files.mark.parent / f"process-{machine()}-{number}.lock") as free:
            if not free:
                continue
            with held(files.lock) as mine:
                if mine and not files.complete:
                    _compile(part, files)
                return mine
    return False


def _compile(part: Part, files: PartFiles) -> None:
    from numba.core import event

    class Count(event.Listener):  # type: ignore[misc]  # numba carries no types
        """Counts the functions that are compiled and kept."""

        functions = files.functions  # of a process that was ended; they are in the cache
        reported = 0.0

        def on_start(self, _: Any) -> None:
            """Nothing is known yet."""

        def on_end(self, event: Any) -> None:
            """Report the progress to other processes at intervals."""
            self.functions += bool(event.data["dispatcher"].stats.cache_path)
            if time.monotonic() - self.reported > INTERVAL:
                self.reported = time.monotonic()
                files.report(self.functions)

    count = Count()
    files.report(count.functions)
    module, _, function = part.work.partition(":")
    with event.install_listener("numba:compile", count):
        getattr(importlib.import_module(module), function)()
    files.finish(count.functions)


def _follow_parent() -> None:
    """End, at once, with the process that has started this one, or when a terminal says so."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    with suppress(OSError):
        os.nice(NICENESS)

    def follow() -> None:
        os.read(0, 1)  # nothing is ever written; it returns where the other end is closed
        os._exit(0)

    threading.Thread(target=follow, daemon=True).start()


if __name__ == "__main__":
    sys.exit(main())
