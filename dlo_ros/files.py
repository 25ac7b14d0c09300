# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Files that appear whole or not at all, and YAML that cannot harm its reader."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

import yaml

from dlo_ros.errors import InputError

LOG = logging.getLogger(__name__)

HEADER = "# Parameters of dlo_ros; the last line is '...'."
END = "..."
"""YAML's mark of the end: a file of ours that has lost it was cut short."""

DEEPEST = 50
"""Levels of a YAML file."""

LARGEST_YAML = 10_000_000
"""Bytes; a parameter file has some thousand."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # yaml has no types
    """YAML's safe loader; a whole number that no floating-point number can hold is none.

    A mapping whose key stands twice is one mapping with the content of both, as ROS's reader of
    parameter files has it; of any other value the last one holds.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """The content of a mapping."""
        merged: dict[tuple[str, str], tuple[yaml.Node, yaml.Node]] = {}
        for number, (key, value) in enumerate(node.value):
            scalar = isinstance(key, yaml.ScalarNode)
            name = (key.tag, key.value) if scalar else ("", str(number))
            before = merged.get(name)
            if before and isinstance(value, yaml.MappingNode):
                first = before[1]
                if isinstance(first, yaml.MappingNode):
                    both = first.value + value.value
                    value = yaml.MappingNode(value.tag, both, first.start_mark, value.end_mark)
            merged[name] = (key, value)
        node.value = list(merged.values())
        return dict(super().construct_mapping(node, deep))


def _whole_number(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int:
    """The value of a whole number, which readers then take as a float without a further check."""
    value = int(loader.construct_yaml_int(node))
    try:
        float(value)
    except OverflowError as err:
        problem = "a whole number that is too large"
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark) from err
    return value


_Loader.add_constructor("tag:yaml.org,2002:int", _whole_number)


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write a file, so that whoever reads it sees the old one or the whole new one.

    It is written under a temporary name beside it, brought to the disk, and renamed. What is left
    of a process that was killed meanwhile is a hidden file named `.NAME.PID.part`.

    Raises:
        InputError: it cannot be written; nothing is changed then.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as err:
        raise InputError(f"{path}: cannot be written ({err.strerror or err})") from err
    finally:
        # Renamed it is gone already; otherwise a full disk gets its room back.
        if temporary.exists():
            temporary.unlink()


def write_text(path: Path | str, text: str) -> None:
    """Write a text file in the same way, UTF-8.

    Raises:
        InputError: see `write_bytes`.
    """
    write_bytes(path, text.encode())


def read_yaml(path: Path, kind: type[InputError] = InputError) -> Any:
    """The content of a YAML file: mappings, lists, numbers, text, and nothing else.

    Aliases are refused, as ROS's own reader of parameter files does: a few lines of them unfold to
    more than any memory holds. A file that seems to be cut short gives a warning.

    Args:
        kind: class of the error that is raised.

    Raises:
        InputError: it cannot be read, or is no valid YAML; the message says where.
    """
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_YAML + 1)
    except OSError as err:
        raise kind(f"{path}: cannot be read ({err.strerror or err})") from err
    if len(data) > LARGEST_YAML:
        raise kind(f"{path}: is larger than {LARGEST_YAML // 10**6} MB; it is no parameter file")
    try:
        text = data.decode()
        _check_events(text, path, kind)
        tree = _Loader(text).get_single_data()
    except yaml.MarkedYAMLError as err:
        at = f"line {err.problem_mark.line + 1}: " if err.problem_mark else ""
        raise kind(f"{path}: is no valid YAML ({at}{err.problem})") from err
    # Dates that do not exist and numbers with too many digits raise ValueError and its kin.
    except (yaml.YAMLError, ValueError, TypeError, ArithmeticError, LookupError) as err:
        first = str(err).splitlines()[0] if str(err) else type(err).__name__
        raise kind(f"{path}: is no valid YAML ({first[:200]})") from err
    marked = text.startswith(HEADER) and not text.rstrip().endswith(f"\n{END}")
    if text and (marked or not text.endswith("\n")):
        LOG.warning("%s: its last line has no end; the file may have been cut short", path)
    return tree


def _check_events(text: str, path: Path, kind: type[InputError]) -> None:
    """Refuse what unfolds or nests without bound, before anything is built from it."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        at = f"{path}: is no valid YAML (line {event.start_mark.line + 1}: "
        if isinstance(event, yaml.AliasEvent):
            raise kind(f"{at}aliases such as *{event.anchor[:40]} are not allowed)")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise kind(f"{at}more than {DEEPEST} levels)")
