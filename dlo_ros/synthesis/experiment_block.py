# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Checked reading of the YAML blocks of an experiment file; unknown keys are refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from dlo_ros.errors import InputError


class ExperimentBlock:
    """One block of an experiment file.

    Args:
        values: the mapping; None stands for an empty one.
        where: name for messages, such as `c_shape.yaml: camera`.

    Raises:
        InputError: `values` is no mapping.
    """

    def __init__(self, values: Any, where: str) -> None:
        if values is not None and not isinstance(values, Mapping):
            raise InputError(f"{where} is {_short(values)}; it must be a block of 'key: value'")
        self._values: dict[str, Any] = {str(k): v for k, v in (values or {}).items()}
        self._known: set[str] = set()
        self.where = where

    def __contains__(self, key: str) -> bool:
        return self._values.get(key) is not None

    @property
    def names(self) -> tuple[str, ...]:
        """The keys of the block."""
        return tuple(self._values)

    def raw(self, key: str, default: Any = None) -> Any:
        """The value as YAML gave it."""
        self._known.add(key)
        value = self._values.get(key)
        return default if value is None else value

    def required(self, key: str, what: str) -> Any:
        """The value of a key that must be given."""
        value = self.raw(key)
        if value is None:
            raise InputError(f"{self.where}: '{key}' is missing; give {what}")
        return value

    def block(self, key: str) -> ExperimentBlock:
        """A block within this one, empty where it is missing."""
        return ExperimentBlock(self.raw(key), f"{self.where}: {key}")

    def number(self, key: str, default: float, lower: float, upper: float) -> float:
        """A finite number within a range, both ends allowed."""
        return self.check(self.raw(key, default), key, lower, upper)

    def whole(self, key: str, default: int, lower: int, upper: int) -> int:
        """A whole number within a range, both ends allowed."""
        value = self.number(key, default, lower, upper)
        if value != int(value):
            raise InputError(f"{self.where}: {key} is {value:g}; it must be a whole number")
        return int(value)

    def numbers(
        self, key: str, default: tuple[float, ...], lower: float, upper: float
    ) -> tuple[float, ...]:
        """As many numbers as the default has, each within a range."""
        return self.check_all(self.raw(key, default), key, len(default), lower, upper)

    def check(self, value: Any, key: str, lower: float, upper: float) -> float:
        """A value that belongs to this section as a number within a range."""
        if isinstance(value, str):
            try:  # PyYAML reads 1.0e6 as text
                value = float(value)
            except ValueError:
                raise InputError(f"{self.where}: {key} is {value[:40]!r}; give a number") from None
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f"{self.where}: {key} is {_short(value)}; give a number")
        if not math.isfinite(value) or not lower <= value <= upper:
            raise InputError(f"{self.where}: {key} is {value:g}; allowed is {lower:g} to {upper:g}")
        return float(value)

    def check_all(
        self, value: Any, key: str, size: int, lower: float, upper: float
    ) -> tuple[float, ...]:
        """A value that belongs to this section as a list of numbers."""
        if not isinstance(value, (list, tuple)) or len(value) != size:
            raise InputError(f"{self.where}: {key} is {_short(value)}; give {size} numbers")
        return tuple(self.check(v, key, lower, upper) for v in value)

    def finish(self) -> None:
        """Refuse keys that no reader has asked for.

        Raises:
            InputError: an unknown key; the message lists the known ones.
        """
        unknown = sorted(set(self._values) - self._known)
        if unknown:
            known = ", ".join(sorted(self._known))
            raise InputError(f"{self.where}: '{unknown[0]}' is unknown; known are {known}")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
