# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters as lines of a YAML file that a person reads, the unit behind each number."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from dlo_ros.effects import quantities
from dlo_ros.effects.registry import tolerance_of
from dlo_ros.file_parameter import Value
from dlo_ros.parameter_cameras import of_cameras, unit
from dlo_ros.parameter_table import TABLE


def parameter_lines(values: Mapping[str, Value]) -> str:
    """The block `/**: ros__parameters:` of a ROS 2 parameter file.

    Args:
        values: values by their dotted names.
    """
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *groups, key = name.split(".")
        node = tree
        for group in groups:
            node = node.setdefault(group, {})
        node[key] = list(value) if isinstance(value, tuple) else value
    return "\n".join(("/**:", "  ros__parameters:", *_lines(tree, "", "    "))) + "\n"


def _lines(tree: Mapping[str, Any], prefix: str, indent: str) -> Iterator[str]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield f"{indent}{key}:"
            yield from _lines(value, f"{prefix}{key}.", f"{indent}  ")
        else:
            unit = _unit(f"{prefix}{key}")
            comment = f"  # {unit}" if unit else ""
            yield f"{indent}{key}: {_written(value)}{comment}"


def _written(value: Any) -> str:
    """A value as YAML on one line."""
    text: str = yaml.safe_dump(value, default_flow_style=True, width=math.inf)
    return text.removesuffix("...\n").strip()


def _unit(name: str) -> str:
    if name in TABLE:
        return TABLE[name].unit
    if of_cameras(name):
        return unit(name)
    effect, _, key = name.removeprefix("effects.").partition(".")
    return quantities(effect)[tolerance_of(effect, key) or key].unit
