# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`python -m dlo_ros NAME ...`, and the command `dlo_ros`: quiet on Ctrl-C from the first moment.

Loading the libraries takes a second, many on a busy machine, and an interrupt in the midst of it
would end in a traceback. Only what Python itself does before this line is beyond reach.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from dlo_ros.errors import EXIT_DONE, EXIT_INTERRUPTED

NODES = ("observer", "simulator", "identifier")
"""Executables that Ctrl-C ends as intended: exit status 0, as `ros2 launch` expects it."""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one executable.

    Args:
        arguments: the executable's name and its own arguments; None: those of the process.

    Returns:
        The exit status, see `dlo_ros.cli.main.main`.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    is_node = bool(words) and words[0] in NODES
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever started the process
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))

    def leave(number: int, frame: FrameType | None) -> None:
        os._exit(EXIT_DONE if is_node else EXIT_INTERRUPTED)

    signal.signal(signal.SIGINT, leave)
    from dlo_ros.cli.main import main

    status = main(words)
    if status and arguments is None and is_node:
        # The middleware now and then never ends where a half-built node is taken apart.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status


if __name__ == "__main__":
    sys.exit(run())
