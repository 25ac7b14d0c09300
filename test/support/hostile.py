# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Hostile ROS messages for the fuzzing tests: good ones, changed in places that hypothesis draws.

`spoiled` walks down a message along its field types (also those of services) and replaces a leaf by
a value that is legal for its type and rarely expected: NaN, the largest integer, an empty name, a
list a thousand times as long. Whatever DDS could deliver can so be made, and nothing else.
"""

from __future__ import annotations

import array
import importlib
import math
from typing import Any

from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosidl_parser.definition import (
    AbstractGenericString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
    UnboundedSequence,
)

FLOATS = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.0, 1e-12, 5e-324, 1e9, -1e9, 1e38, 1e300,
    -1.7e308, 0.5, 2.0, 1e-3, 1e5,
)  # fmt: skip
STRINGS = (
    "", "board", "map", "start", "end", "control_point_1", "control_point_2", "control_point_11",
    "control_point_12", "control_point_0", "control_point_-1", "control_point_999999999999",
    "rod.young_modulus", "rod.density", "gravity", "rod.length", "simulation.start", "use_sim_time",
    "effects.point_mass.mass", "effects.ghost.x", "bgr8", "mono8", "mono16", "bayer_rggb8", "jpeg",
    "plumb_bob", "rational_polynomial", "equidistant", "x" * 100_000, "\N{SNOWMAN}", "%s{0}\n",
    "../../etc/passwd", "nan", "-",
)  # fmt: skip
BITS = {
    "uint8": (0, 8), "octet": (0, 8), "int8": (-1, 8), "uint16": (0, 16), "int16": (-1, 16),
    "uint32": (0, 32), "int32": (-1, 32), "uint64": (0, 64), "int64": (-1, 64),
}  # fmt: skip
HUGE = 1_000_000
"""Elements of the longest lists."""

LONGEST = 8_000_000
"""Bytes of a list of messages, which may hold long lists in turn."""

DEEPEST = 12


def message_type(kind: NamespacedType) -> Any:
    """The Python class of a message type."""
    return getattr(importlib.import_module(".".join(kind.namespaces)), kind.name)


def bounds(name: str) -> tuple[int, int]:
    """Least and largest value of an integer type."""
    sign, bits = BITS[name]
    return (0, 2**bits - 1) if sign == 0 else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def scalar(draw: Any, kind: Any, old: Any) -> Any:
    """An unexpected value of a basic type."""
    if isinstance(kind, AbstractGenericString):
        return draw(st.sampled_from(STRINGS))
    name = kind.typename
    if name == "boolean":
        return not old
    if name in ("float", "double"):
        value = draw(
            st.one_of(
                st.sampled_from(FLOATS),
                st.floats(width=32 if name == "float" else 64),
                st.floats(0.5, 2.0).map(lambda factor: factor * float(old)),
            )
        )
        return float(value) if name == "double" or abs(value) < 3.4e38 else math.inf
    least, largest = bounds(name)
    if name == "octet":
        return bytes([draw(st.integers(0, 255))])
    chosen = st.sampled_from((least, largest, 0, 1, old + 1, old - 1, largest // 2))
    value = draw(st.one_of(chosen, st.integers(least, largest)))
    return min(max(int(value), least), largest)


def octets(draw: Any, data: bytes, longest: int) -> bytes:
    """Bytes cut short, flipped, emptied or blown up."""
    change = draw(st.sampled_from(("cut", "flip", "flip", "empty", "longer", "huge")))
    if change == "cut" and data:
        return data[: draw(st.integers(0, len(data) - 1))]
    if change == "flip" and data:
        result = bytearray(data)
        for at in draw(st.lists(st.integers(0, len(data) - 1), min_size=1, max_size=4)):
            result[at] ^= 1 << draw(st.integers(0, 7))
        return bytes(result)
    if change == "longer":
        return data + bytes(draw(st.integers(1, 4000)))
    return bytes(longest) if change == "huge" else b""


def sequence(draw: Any, kind: Any, old: Any, depth: int) -> Any:
    """A list that is shorter, longer, doubled, or has a spoiled element."""
    inner = kind.value_type
    basic = isinstance(inner, BasicType)
    if basic and inner.typename in ("uint8", "octet") and not isinstance(kind, Array):
        whole = b"".join(old) if old and isinstance(old[0], bytes) else bytes(old)
        data = octets(draw, whole, HUGE)
        return [bytes([b]) for b in data[:100]] if inner.typename == "octet" else array.array(
            "B", data
        )  # fmt: skip
    values = list(old)
    fixed = isinstance(kind, Array)
    changes = ["element"] * (3 if values else 0)
    if not fixed:
        changes += ["empty", "drop", "double", "swap", "many", "fresh"] if values else ["fresh"]
    if not changes:
        return old
    change = draw(st.sampled_from(changes))
    at = draw(st.integers(0, len(values) - 1)) if values else 0
    if change == "element":
        values[at] = spoil(draw, inner, values[at], depth + 1)
    elif change == "drop":
        del values[at]
    elif change == "double":
        values.insert(at, values[at])
    elif change == "swap":
        values[at], values[0] = values[0], values[at]
    elif change == "empty":
        values = []
    elif change == "many":
        # A million numbers, a thousand messages: what a frame of DDS can hold.
        most = HUGE if basic and inner.typename in ("float", "double") else 2000
        if isinstance(inner, AbstractGenericString):
            most = 2_000_000 // (1 + max(map(len, values)))
        if isinstance(inner, NamespacedType):
            most = min(most, LONGEST // max(len(serialize_message(v)) for v in values[:100]) + 1)
        times = draw(st.sampled_from((2, 40, most // max(len(values), 1) + 1)))
        values = (values * times)[:most]
    elif change == "fresh":
        values.append(spoil(draw, inner, fresh(inner), depth + 1))
    if isinstance(kind, BoundedSequence):
        values = values[: kind.maximum_size]
    return values


def fresh(kind: Any) -> Any:
    """The default value of a type."""
    if isinstance(kind, NamespacedType):
        return message_type(kind)()
    if isinstance(kind, AbstractGenericString):
        return ""
    if kind.typename == "boolean":
        return False
    if kind.typename == "octet":
        return b"\0"
    return 0.0 if kind.typename in ("float", "double") else 0


def spoil(draw: Any, kind: Any, old: Any, depth: int = 0) -> Any:
    """A changed copy of a value of a field type."""
    if isinstance(kind, (Array, UnboundedSequence, BoundedSequence)):
        return sequence(draw, kind, old, depth)
    if not isinstance(kind, NamespacedType):
        return scalar(draw, kind, old)
    names = list(type(old).get_fields_and_field_types())
    if not names or depth > DEEPEST:
        return old
    at = draw(st.integers(0, len(names) - 1))
    result = shallow(old)
    name = names[at]
    setattr(result, name, spoil(draw, type(old).SLOT_TYPES[at], getattr(old, name), depth + 1))
    return result


def shallow(message: Any) -> Any:
    """A copy that shares its fields."""
    fields = type(message).get_fields_and_field_types()
    return type(message)(**{name: getattr(message, name) for name in fields})


def spoiled(draw: Any, message: Any, most: int = 3) -> Any:
    """A message of which up to `most` places are changed; often none, so that work goes on."""
    result = message
    names = list(type(message).get_fields_and_field_types())
    for _ in range(draw(st.integers(0, most)) if names else 0):
        at = draw(st.integers(0, len(names) - 1))
        changed = shallow(result)
        old = getattr(result, names[at])
        setattr(changed, names[at], spoil(draw, type(result).SLOT_TYPES[at], old))
        result = changed
    return result


def not_finite(message: Any, path: str = "") -> str:
    """Where a message holds a number that is not finite; empty where all are."""
    if isinstance(message, float):
        return "" if math.isfinite(message) else f"{path} = {message}"
    if hasattr(message, "get_fields_and_field_types"):
        for name in message.get_fields_and_field_types():
            found = not_finite(getattr(message, name), f"{path}.{name}")
            if found:
                return found
        return ""
    if isinstance(message, (str, bytes, bool, int)):
        return ""
    if isinstance(message, array.array) and message.typecode not in "fd":
        return ""
    if hasattr(message, "dtype"):
        return "" if math.isfinite(float(abs(message).sum())) else path
    for i, element in enumerate(message):
        found = not_finite(element, f"{path}[{i}]")
        if found:
            return found
    return ""
