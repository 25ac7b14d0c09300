# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes, declared from the one table in `dlo_ros.parameters`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from dlo_ros.effects import quantities
from dlo_ros.effects.registry import STD
from dlo_ros.errors import DloError, ParameterError
from dlo_ros.file_parameter import FileParameter, Value
from dlo_ros.parameter_cameras import CAMERAS, DESCRIPTION, flat_cameras, of_cameras
from dlo_ros.parameter_table import PARAMETERS, TABLE
from dlo_ros.parameters import EFFECTS_PREFIX, Settings

# Present in every node, and rclpy's business.
FOREIGN = ("use_sim_time", "qos_overrides.", "start_type_description_service")


def declare(node: Node, name: str) -> Settings:
    """Check the parameters that the node was started with and declare all that are its own.

    The node must have been built with `automatically_declare_parameters_from_overrides`: whole
    numbers are then accepted where a floating-point one is expected, and effects may be given
    without being known beforehand.

    Args:
        name: observer, simulator or identifier.

    Raises:
        ParameterError: one that the node uses is missing, or one is unusable.
    """
    given: dict[str, Any] = {}
    for key, parameter in node.get_parameters_by_prefix("").items():
        if key.startswith(FOREIGN):
            continue
        node.undeclare_parameter(key)
        if key in TABLE or key.startswith(EFFECTS_PREFIX) or of_cameras(key):
            given[key] = _plain(parameter.value)
        else:
            node.get_logger().warning(f"unknown parameter {key} is ignored")
    settings = Settings.from_mapping(given, name)
    values = settings.flat()
    for parameter in PARAMETERS:
        if name in parameter.nodes:
            value = values[parameter.name]
            node.declare_parameter(
                parameter.name,
                list(value) if isinstance(value, tuple) else value,
                descriptor(parameter),
                ignore_override=True,
            )
    for effect, keys in settings.effects.items():
        for key, number in keys.items():
            q = quantities(effect)[key]
            _declare_effect(
                node, f"{effect}.{key}", number, f"{q.description}{q.bracketed}",
                f"from {q.lower:g} to {q.upper:g}",
            )  # fmt: skip
    for name, std in settings.tolerances.items():
        effect, _, key = name.partition(".")
        q = quantities(effect)[key]
        text = f"tolerance of effects.{name}, a standard deviation{q.bracketed}"
        _declare_effect(node, f"{name}{STD}", std, text, "0 or positive")
    for key, value in flat_cameras(settings.cameras).items():
        text = "cameras that watch the DLO together" if key == CAMERAS else DESCRIPTION
        described = ParameterDescriptor(
            description=text, dynamic_typing=True, read_only=key == CAMERAS
        )
        node.declare_parameter(key, list(value), described, ignore_override=True)
    return settings


def _declare_effect(
    node: Node, name: str, value: float | tuple[float, ...], description: str, constraints: str
) -> None:
    """Declare a number of an effect, or its tolerance; `name` is without the prefix."""
    node.declare_parameter(
        f"{EFFECTS_PREFIX}{name}",
        list(value) if isinstance(value, tuple) else value,
        ParameterDescriptor(
            description=description, additional_constraints=constraints, dynamic_typing=True
        ),
        ignore_override=True,
    )


def descriptor(parameter: FileParameter) -> ParameterDescriptor:
    """The descriptor that `ros2 param describe` shows."""
    result = ParameterDescriptor(
        type=parameter_type(parameter),
        description=parameter.description + parameter.bracketed,
        read_only=parameter.read_only,
        # `LiveSettings` converts and checks types, with messages that name the parameter.
        dynamic_typing=True,
    )
    if parameter.choices:
        result.additional_constraints = "one of " + ", ".join(parameter.choices)
    bounded = math.isfinite(parameter.lower) and math.isfinite(parameter.upper)
    if bounded and parameter.kind == "integer":
        result.integer_range = [
            IntegerRange(from_value=int(parameter.lower), to_value=int(parameter.upper), step=0)
        ]
    elif bounded and parameter.kind == "double":
        result.floating_point_range = [
            FloatingPointRange(
                from_value=float(parameter.lower), to_value=float(parameter.upper), step=0.0
            )
        ]
    elif bounded:
        result.additional_constraints = (
            f"{parameter.size} numbers from {parameter.lower:g} to {parameter.upper:g}"
        )
    return result


def parameter_type(parameter: FileParameter) -> int:
    """The type of the value as rcl_interfaces/ParameterType numbers it."""
    if parameter.size:
        return int(ParameterType.PARAMETER_DOUBLE_ARRAY)
    return int(getattr(ParameterType, f"PARAMETER_{parameter.kind.upper()}"))


class LiveSettings:
    """The node's settings, changed as a set by `ros2 param set` and refused as a set.

    Args:
        node: node whose parameters were declared.
        settings: settings as they were declared.
        changed: function that is called with the new settings after a change.
        usable: raises a DloError for settings that the table allows, but the node cannot use.
    """

    def __init__(
        self,
        node: Node,
        settings: Settings,
        changed: Callable[[Settings], None],
        usable: Callable[[Settings], None] = lambda settings: None,
    ) -> None:
        self.current = settings
        self._declared = node.has_parameter
        self._changed = changed
        self._usable = usable
        node.add_pre_set_parameters_callback(self._converted)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _converted(self, parameters: Sequence[Any]) -> list[Any]:
        """The parameters with each value in its proper type, so that a double stays one.

        What is unusable stays as it is, for `_check` to refuse.

        Raises:
            ParameterNotDeclaredException: names those that the node does not have; rclpy's own
                names none.
        """
        unknown = ", ".join(p.name for p in parameters if p.name and not self._declared(p.name))
        if unknown:
            effects = EFFECTS_PREFIX in unknown
            mend = "; an effect must be in the parameter file at the start" if effects else ""
            raise ParameterNotDeclaredException(f"{unknown}{mend}")
        try:
            settings = self._merged(parameters)
        except ParameterError:
            settings = None
        values = settings.flat() if settings is not None else {}
        return [_typed(p.name, values[p.name]) if p.name in values else p for p in parameters]

    def _merged(self, parameters: Sequence[Any]) -> Settings | None:
        """The settings with these changes; None where none of them is the node's."""
        known = self.current.flat()
        changes = {p.name: _plain(p.value) for p in parameters if p.name in known}
        if not changes:
            return None
        for key, value in changes.items():
            if value is None:
                raise ParameterError(f"{key} cannot be removed")
        return Settings.from_mapping({**known, **changes})

    def _check(self, parameters: Sequence[Any]) -> SetParametersResult:
        names = [p.name for p in parameters]
        if "" in names:  # which rclpy takes, and publishes
            return SetParametersResult(successful=False, reason="a parameter without a name")
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            # rclpy would pass on each value in turn; only the last one has been looked at.
            reason = f"{twice[0]} is given more than once; give one value"
            return SetParametersResult(successful=False, reason=reason)
        try:
            settings = self._merged(parameters)
            if settings is not None and settings != self.current:
                self._usable(settings)
        except DloError as err:
            return SetParametersResult(successful=False, reason=str(err))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: Sequence[Any]) -> None:
        settings = self._merged(parameters)
        if settings is not None and settings != self.current:
            self.current = settings
            self._changed(settings)


def _typed(name: str, value: Value) -> Any:
    """A parameter of rclpy with the type of a value."""
    return RosParameter(name, value=list(value) if isinstance(value, tuple) else value)


def _plain(value: Any) -> Any:
    """A parameter's value in plain Python (arrays as lists)."""
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    return list(value)
