# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Completion of `dlo_ros NAME ...` in a shell, by argcomplete."""

from __future__ import annotations

import argparse
import os

from dlo_ros.cli.main import EXECUTABLES, add_arguments


def complete() -> None:
    """Answer the shell and end the process; without argcomplete there is no answer."""
    try:
        import argcomplete
    except ImportError:
        os._exit(1)
    parser = argparse.ArgumentParser(prog="dlo_ros")
    parser.add_argument("--version", action="store_true")
    subparsers = parser.add_subparsers()
    words = os.environ.get("COMP_LINE", "").split()
    for executable in EXECUTABLES:
        own = subparsers.add_parser(executable.name, help=executable.summary)
        if executable.name in words[1:]:  # the others need not be imported
            add_arguments(executable, own)
    argcomplete.autocomplete(parser)
