# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Extensions by other packages, found by their entry points."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points
from typing import Any

LOG = logging.getLogger(__name__)


def loaded(group: str, what: str) -> Iterator[tuple[EntryPoint, Any]]:
    """The entry points of a group with what they name; one that fails costs a warning only.

    Args:
        group: name of the group of entry points.
        what: kind of thing that the entry points add, for the warning.
    """
    for point in entry_points(group=group):
        try:
            found = point.load()
        except Exception as err:
            LOG.warning("%s %s of %s cannot be loaded: %s", what, point.name, point.value, err)
        else:
            yield point, found
