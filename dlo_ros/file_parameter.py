# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One parameter of the parameter file: name, type, unit, range, and the check of a value.

All of them stand in `dlo_ros.parameter_table`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from dlo_ros.errors import ParameterError

Value = float | int | str | bool | tuple[float, ...]

NODES = ("observer", "simulator", "identifier")
MODEL = ("simulator", "identifier")
"""The nodes that simulate; the observer knows no physics."""


@dataclass(frozen=True)
class FileParameter:
    """One row of the table.

    Args:
        name: dotted name as in the parameter file.
        default: value where the file has none; None means that it must be given.
        description: meaning of the parameter, one sentence.
        unit: SI unit, empty where there is none.
        kind: double, integer, string, bool or double[N].
        lower, upper: range, both ends allowed (numbers only; for arrays each element).
        choices: the allowed strings.
        nodes: the nodes that use it, and therefore declare it.
        read_only: whether a change while running has no meaning.
        unused: value of what must be given, in a node that does not use it and was not given it.
    """

    name: str
    kind: str
    default: Value | None
    description: str
    unit: str = ""
    lower: float = -math.inf
    upper: float = math.inf
    choices: tuple[str, ...] = ()
    nodes: tuple[str, ...] = NODES
    read_only: bool = False
    unused: Value | None = None

    @property
    def bracketed(self) -> str:
        """The unit in brackets, with a space before it; empty where there is none."""
        return f" [{self.unit}]" if self.unit else ""

    @property
    def size(self) -> int:
        """Number of elements of an array, 0 for a scalar."""
        return int(self.kind[7:-1]) if self.kind.startswith("double[") else 0

    def check(self, value: Any) -> Value:
        """Return the value in its proper type.

        Raises:
            ParameterError: wrong type, not finite, outside the range or not among the choices.
        """
        if self.size:
            if not isinstance(value, Iterable) or isinstance(value, str):
                raise ParameterError(f"{self.name} is {value!r}; it must be {self.size} numbers")
            values = tuple(self._number(v) for v in value)
            if len(values) != self.size:
                raise ParameterError(
                    f"{self.name} has {len(values)} numbers; it must have {self.size}"
                )
            return values
        if self.kind == "string":
            if not isinstance(value, str) or (self.choices and value not in self.choices):
                allowed = " | ".join(self.choices) or "text"
                raise ParameterError(f"{self.name} is {value!r}; it must be {allowed}")
            return value
        if self.kind == "bool":
            if not isinstance(value, bool):
                raise ParameterError(f"{self.name} is {value!r}; it must be true or false")
            return value
        number = self._number(value)
        if self.kind == "integer":
            if number != int(number):
                raise ParameterError(f"{self.name} is {value!r}; it must be a whole number")
            return int(number)
        return number

    def _number(self, value: Any) -> float:
        if isinstance(value, str):
            try:  # PyYAML reads 1.0e6 as text
                value = float(value)
            except ValueError:
                raise ParameterError(
                    f"{self.name} is {value!r}; it must be a number{self.bracketed}"
                ) from None
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ParameterError(f"{self.name} is {value!r}; it must be a number{self.bracketed}")
        if not math.isfinite(value) or not self.lower <= value <= self.upper:
            unit = f" {self.unit}" if self.unit else ""
            raise ParameterError(
                f"{self.name} is {value:g}{unit}; allowed is {self.lower:g} to {self.upper:g}"
            )
        return float(value)
