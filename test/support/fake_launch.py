# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Evaluates the package's launch files where ROS's `launch` cannot be installed.

A stand-in for just the part of `launch` and `launch_ros` that these files use, with the behaviour
that ROS documents. It starts nothing: it says which processes would be started, with what.
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import sys
import types
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]


@dataclass
class Context:
    """Launch configurations and what was found to be started."""

    values: dict[str, str]
    installed: frozenset[str] = frozenset()
    is_shutdown: bool = False
    declared: dict[str, Declare] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    processes: list[Process] = field(default_factory=list)

    @property
    def launch_configurations(self) -> dict[str, str]:
        """What was declared, by name."""
        return {name: self.values[name] for name in self.declared}


@dataclass(frozen=True)
class Exited:
    """The event of a process that has ended."""

    returncode: int


@dataclass(frozen=True)
class Process:
    """A process that would be started.

    Args:
        arguments: arguments before --ros-args.
        ros_arguments: remappings, parameters and all else after it.
        on_exit: function that returns what follows its end, given its exit status; it raises where
            the launch fails.
    """

    package: str
    executable: str
    namespace: str
    arguments: tuple[str, ...]
    remappings: dict[str, str]
    parameters: tuple[Any, ...]
    ros_arguments: tuple[str, ...]
    on_exit: Callable[[int], list[Action]]

    @property
    def ends_all(self) -> bool:
        """Whether its end ends everything."""
        return any(isinstance(action, Shutdown) for action in self.on_exit(0))

    @property
    def words(self) -> list[str]:
        """The command line after the executable."""
        words = [*self.arguments, "--ros-args"]
        if self.namespace:
            words += ["-r", f"__ns:=/{self.namespace.lstrip('/')}"]
        for source, target in self.remappings.items():
            words += ["-r", f"{source}:={target}"]
        for parameters in self.parameters:
            if isinstance(parameters, str):
                words += ["--params-file", parameters]
            else:
                for name, value in parameters.items():
                    words += ["-p", f"{name}:={yaml.safe_dump(value).splitlines()[0]}"]
        return [*words, *self.ros_arguments]


def text(context: Context, value: Any) -> str:
    """A substitution, or several in a row, performed."""
    if isinstance(value, str):
        return value
    if isinstance(value, (list, tuple)):
        return "".join(text(context, v) for v in value)
    result = value.perform(context)
    assert isinstance(result, str)
    return result


class Substitution:
    def __init__(self, *values: Any) -> None:
        self.values = values


class LaunchConfiguration(Substitution):
    def perform(self, context: Context) -> str:
        (name,) = self.values
        assert name in context.declared, f"{name} is used, but not declared"
        return context.values[name]


class PathJoinSubstitution(Substitution):
    def perform(self, context: Context) -> str:
        return str(Path(*(text(context, part) for part in self.values[0])))


class FindPackageShare(Substitution):
    def perform(self, context: Context) -> str:
        assert self.values == ("dlo_ros",)
        return str(ROOT)


class ParameterValue(Substitution):
    def __init__(self, value: Any, *, value_type: type) -> None:
        super().__init__(value)
        assert value_type is str

    def perform(self, context: Context) -> str:
        return text(context, self.values[0])


class Action:
    pass


@dataclass
class Declare(Action):
    name: str
    default_value: Any = None
    description: str = ""

    def execute(self, context: Context) -> None:
        context.declared[self.name] = self
        if self.name not in context.values:
            assert self.default_value is not None, f"{self.name} must be given"
            context.values[self.name] = text(context, self.default_value)


@dataclass
class OpaqueFunction(Action):
    function: Callable[[Context], list[Action] | None]

    def execute(self, context: Context) -> None:
        for action in self.function(context) or ():
            action.execute(context)


@dataclass
class SetEnvironmentVariable(Action):
    name: str
    value: Any

    def execute(self, context: Context) -> None:
        context.environment[self.name] = text(context, self.value)


@dataclass
class Shutdown(Action):
    reason: str


@dataclass
class PythonLaunchDescriptionSource:
    path: Any


@dataclass
class IncludeLaunchDescription(Action):
    source: PythonLaunchDescriptionSource
    launch_arguments: Any = ()

    def execute(self, context: Context) -> None:
        given = {name: text(context, value) for name, value in self.launch_arguments}
        path = Path(text(context, self.source.path))
        inner = evaluate(path, installed=context.installed, **given)
        assert set(given) <= set(inner.declared), "an argument that the file does not declare"
        context.processes += inner.processes
        context.environment |= inner.environment


@dataclass(kw_only=True)
class Node(Action):
    package: str
    executable: str
    namespace: Any = ""
    output: str = "log"
    arguments: Any = ()
    parameters: Any = ()
    remappings: Any = ()
    ros_arguments: Any = ()
    on_exit: Any = ()

    def ended(self, context: Context, status: int) -> list[Action]:
        if callable(self.on_exit):
            return list(self.on_exit(Exited(status), context) or ())
        return list(self.on_exit)

    def execute(self, context: Context) -> None:
        context.processes.append(
            Process(
                self.package,
                self.executable,
                text(context, self.namespace),
                tuple(text(context, a) for a in self.arguments),
                {text(context, a): text(context, b) for a, b in self.remappings},
                tuple(self._parameters(context, p) for p in self.parameters),
                tuple(text(context, a) for a in self.ros_arguments),
                lambda status: self.ended(context, status),
            )
        )

    @staticmethod
    def _parameters(context: Context, given: Any) -> Any:
        if not isinstance(given, dict):
            return text(context, given)
        result = {}
        for name, value in given.items():
            if isinstance(value, bool):
                result[name] = value
                continue
            said = text(context, value)
            # What is no ParameterValue is read as YAML, which makes "true" a bool.
            result[name] = said if isinstance(value, ParameterValue) else yaml.safe_load(said)
            assert result[name] is not None, f"{name}: an empty value has no type"
        return result


class LaunchDescription:
    def __init__(self, actions: list[Any]) -> None:
        self.actions = actions


class PackageNotFoundError(LookupError):
    pass


MODULES = {
    "ament_index_python": {},
    "ament_index_python.packages": {"PackageNotFoundError": PackageNotFoundError},
    "launch": {"LaunchDescription": LaunchDescription},
    "launch.actions": {
        "DeclareLaunchArgument": Declare,
        "IncludeLaunchDescription": IncludeLaunchDescription,
        "OpaqueFunction": OpaqueFunction,
        "SetEnvironmentVariable": SetEnvironmentVariable,
        "Shutdown": Shutdown,
    },
    "launch.launch_description_sources": {
        "PythonLaunchDescriptionSource": PythonLaunchDescriptionSource
    },
    "launch.logging": {"get_logger": logging.getLogger},
    "launch.substitutions": {
        "LaunchConfiguration": LaunchConfiguration,
        "PathJoinSubstitution": PathJoinSubstitution,
    },
    "launch_ros": {},
    "launch_ros.actions": {"Node": Node},
    "launch_ros.parameter_descriptions": {"ParameterValue": ParameterValue},
    "launch_ros.substitutions": {"FindPackageShare": FindPackageShare},
}


@contextlib.contextmanager
def _modules(installed: Collection[str]):
    def get_package_prefix(name: str) -> str:
        if name not in installed:
            raise PackageNotFoundError(name)
        return f"/opt/ros/{name}"

    before = {name: sys.modules.get(name) for name in MODULES}
    for name, members in MODULES.items():
        module = types.ModuleType(name)
        module.__path__ = []
        vars(module).update(members)
        sys.modules[name] = module
    vars(sys.modules["ament_index_python.packages"])["get_package_prefix"] = get_package_prefix
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def evaluate(path: Path, *, installed: Collection[str] = (), **arguments: str) -> Context:
    """What `ros2 launch PATH NAME:=VALUE ...` would start where those packages are installed.

    Raises:
        RuntimeError: what the launch file itself refuses, before anything starts.
    """
    with _modules(installed):
        spec = importlib.util.spec_from_file_location(path.name.replace(".", "_"), path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        description = module.generate_launch_description()
    context = Context(dict(arguments), frozenset(installed))
    for action in description.actions:
        action.execute(context)
    unknown = set(arguments) - set(context.declared)
    assert not unknown, f"no such arguments: {unknown}"
    return context
