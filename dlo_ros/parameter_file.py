# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameter files, as ROS 2 reads them."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from dlo_ros.effects.base import PREFIX
from dlo_ros.errors import ParameterError
from dlo_ros.file_parameter import NODES
from dlo_ros.files import read_yaml
from dlo_ros.parameter_cameras import of_cameras
from dlo_ros.parameter_table import TABLE

LOG = logging.getLogger(__name__)

ALIKE = 0.85
"""Similarity (difflib's ratio) from which an unknown name is taken for a known one mistyped."""

BLOCK = "ros__parameters"
EVERY = "/**"
OURS = (*NODES, "*", "**")
"""Last parts of the names of blocks that our nodes read."""
EFFECTS = PREFIX.rstrip(".")


def parameter_blocks(path: Path) -> list[tuple[str, dict[Any, Any]]]:
    """Each `ros__parameters` of a ROS 2 parameter file: the nodes' name above it, and its content.

    Names may be nested by namespace, `left: simulator: ros__parameters:` for /left/simulator.

    Raises:
        ParameterError: the file is missing, is no YAML or has no `ros__parameters`.
    """
    blocks = list(_blocks("", read_yaml(path, ParameterError)))
    for name, block in blocks:
        if not isinstance(block, dict):
            raise ParameterError(
                f"{path}: 'ros__parameters' of {name} holds no parameters; take that block out"
            )
    if not blocks:
        raise ParameterError(f"{path}: has no block '/**: ros__parameters:' with parameters")
    return blocks


def _blocks(above: str, tree: Any) -> Iterator[tuple[str, Any]]:
    for key, value in tree.items() if isinstance(tree, dict) else ():
        if key == BLOCK:
            yield above, value
        else:
            yield from _blocks(f"{above}/{str(key).strip('/')}", value)


def parameter_values(path: Path) -> dict[str, Any]:
    """Dotted names and raw values of a ROS 2 parameter file, blocks of all our nodes merged.

    Those of other nodes, such as a camera's driver, are left out, unless there are no others: then
    they are taken for ours under other names. Of two values the last one holds, as for ROS.

    Raises:
        ParameterError: see `parameter_blocks`.
    """
    blocks = parameter_blocks(path)
    own = [block for block in blocks if block[0].rpartition("/")[2] in OURS]
    values: dict[str, Any] = {}
    stated: dict[str, str] = {}
    for node, block in own or blocks:
        flat: dict[str, Any] = {}
        _flatten("", block, flat)
        for name, value in flat.items():
            before = stated.get(name, EVERY)
            if EVERY not in (before, node) and node != before and value != values[name]:
                LOG.warning(
                    "%s: %s is %s for %s and %s for %s; the last one is taken",
                    path, name, values[name], before, value, node,
                )  # fmt: skip
            stated[name] = node
        values |= flat
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
