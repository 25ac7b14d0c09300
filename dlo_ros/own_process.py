# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Start modules of this very package in processes of their own.

With `-m` Python looks first in the folder that it is started in. A user who has installed the
package and stands in the folder of its sources would get those instead, whose compiled kernels are
elsewhere.
"""

from __future__ import annotations

import sys
from pathlib import Path

PLACE = str(Path(__file__).resolve().parent.parent)
"""The folder from which this package was imported."""


def command_of(module: str) -> list[str]:
    """The command that runs a module of this package, as `python -m MODULE` would."""
    start = (
        f"import runpy, sys; sys.path.insert(0, {PLACE!r}); "
        f"runpy.run_module({module!r}, run_name='__main__', alter_sys=True)"
    )
    return [sys.executable, "-c", start]
