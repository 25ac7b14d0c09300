# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameter files, as ROS 2 reads them."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from dlo_ros.effects.base import PREFIX
from dlo_ros.errors import ParameterError
from dlo_ros.files import read_yaml
from dlo_ros.parameter_cameras import of_cameras
from dlo_ros.parameter_table import TABLE

LOG = logging.getLogger(__name__)

ALIKE = 0.85
"""Similarity (difflib's ratio) from which an unknown name is taken for a known one mistyped."""

EFFECTS = PREFIX.rstrip(".")


def parameter_blocks(path: Path) -> list[dict[Any, Any]]:
    """The content of each `ros__parameters` of a ROS 2 parameter file.

    Raises:
        ParameterError: the file is missing, is no YAML or has no `ros__parameters`.
    """
    tree = read_yaml(path, ParameterError)
    sections = tree.values() if isinstance(tree, dict) else []
    blocks = [
        s["ros__parameters"] for s in sections if isinstance(s, dict) and "ros__parameters" in s
    ]
    if not blocks or not all(isinstance(b, dict) for b in blocks):
        raise ParameterError(f"{path}: has no block '/**: ros__parameters:' with parameters")
    return blocks


def parameter_values(path: Path) -> dict[str, Any]:
    """Dotted names and raw values of a ROS 2 parameter file, all node sections merged.

    Raises:
        ParameterError: see `parameter_blocks`.
    """
    values: dict[str, Any] = {}
    for block in parameter_blocks(path):
        _flatten("", block, values)
    return values


def read_parameter_file(path: Path) -> dict[str, Any]:
    """Parameters as of `parameter_values`; names that look like mistakes give a warning.

    Raises:
        ParameterError: see `parameter_blocks`.
    """
    values = parameter_values(path)
    groups = {name.split(".")[0] for name in TABLE if "." in name}
    for name in values:
        if name in TABLE or name.startswith(PREFIX) or of_cameras(name):
            continue
        # Other nodes' parameters may stand beside ours; a name like one of ours gives a warning.
        near = get_close_matches(name, TABLE, n=1, cutoff=ALIKE)
        group, _, rest = name.partition(".")
        if rest and get_close_matches(group, [EFFECTS], cutoff=ALIKE):
            near = [f"{PREFIX}{rest}"]
        if near or group in groups:
            meant = f"; is {near[0]} meant?" if near else ""
            LOG.warning("%s: unknown parameter %s is ignored%s", path, name[:80], meant)
    return values


def _flatten(prefix: str, block: Mapping[Any, Any], out: dict[str, Any]) -> None:
    for key, value in block.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            _flatten(f"{name}.", value, out)
        else:
            out[name] = value
