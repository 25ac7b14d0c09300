# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The message factory of rclpy: the same code builds messages for bags and for live topics."""

from __future__ import annotations

import array
import importlib
from collections.abc import Iterable
from functools import cache
from typing import Any


@cache
def message_class(kind: str) -> Any:
    """The Python class of a type such as `geometry_msgs/msg/Point`.

    Raises:
        LookupError: the type is not installed.
    """
    package, _, name = kind.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError) as err:
        raise LookupError(f"message type {kind} is not installed") from err


def installed(kind: str) -> bool:
    """Whether messages of this type can be published here."""
    try:
        message_class(kind)
    except LookupError:
        return False
    return True


class RosMessages:
    """Makes rclpy's messages."""

    def make(self, kind: str, /, **fields: Any) -> Any:
        """A message of a type such as `geometry_msgs/msg/Point`, every field given."""
        return message_class(kind)(**fields)

    def octets(self, data: bytes) -> Any:
        """The value of a uint8[] field; unlike bytes, an array is taken over as it is."""
        result = array.array("B")
        result.frombytes(data)
        return result

    def doubles(self, values: Iterable[float]) -> Any:
        """The value of a float64[] field."""
        return [float(v) for v in values]


ROS_MESSAGES = RosMessages()
