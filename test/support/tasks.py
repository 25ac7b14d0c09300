# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Tasks that the tests give to worker processes; importing the module costs these nothing."""

import os
from pathlib import Path


def squared(x):
    return x * x


def dies_once(task):
    """Ends its process the first time it is done for a file."""
    number, marker = task
    if number == 1 and not Path(marker).exists():
        Path(marker).write_text("died")
        os._exit(1)
    return number


def dies(_):
    os._exit(1)
