# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Settings: a whole parameter file, checked against the parameter table."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from dlo_ros.effects import quantities
from dlo_ros.effects.registry import STD, build, check_tolerance, tolerance_of
from dlo_ros.effects.registry import check as check_effect
from dlo_ros.errors import ParameterError
from dlo_ros.file_parameter import Value
from dlo_ros.files import END, HEADER, write_text
from dlo_ros.parameter_cameras import CameraPose as CameraPose
from dlo_ros.parameter_cameras import Vector as Vector
from dlo_ros.parameter_cameras import check_rotation, flat_cameras, read_cameras
from dlo_ros.parameter_file import read_parameter_file
from dlo_ros.parameter_table import PARAMETERS, TABLE
from dlo_ros.parameter_text import parameter_lines
from dlo_ros.rod_settings import EFFECTS_PREFIX as EFFECTS_PREFIX
from dlo_ros.rod_settings import STANDARD_GRAVITY as STANDARD_GRAVITY
from dlo_ros.rod_settings import DampingParameters as DampingParameters
from dlo_ros.rod_settings import LimitParameters as LimitParameters
from dlo_ros.rod_settings import RodParameters as RodParameters
from dlo_ros.rod_settings import RodSettings as RodSettings
from dlo_ros.rod_settings import SimulationParameters as SimulationParameters
from dlo_ros.spline import FloatArray

Quadruple = tuple[float, float, float, float]


@dataclass(frozen=True)
class WrenchParameters:
    """Noise of force-torque sensors at the grips; a standard deviation of 0: not known."""

    force_std: float = 0.0
    torque_std: float = 0.0
    force_bias_std: float = 0.0
    tool_mass_std: float = 0.1
    delay_std: float = 0.01


Offset = tuple[float, float, float, float, float, float, float]
NO_OFFSET: Offset = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class CommandParameters:
    """Source of the imposed motion.

    Offsets are the clamp's pose in its frame: x y z [m], quaternion x y z w, x along growing u.
    """

    source: str = "topic"
    start_frame: str = ""
    end_frame: str = ""
    start_offset: Offset = NO_OFFSET
    end_offset: Offset = NO_OFFSET


@dataclass(frozen=True)
class DiagnosisParameters:
    """Limit above which a difference between model and DLO matters."""

    material_err: float = 5e-4


@dataclass(frozen=True)
class VisionParameters:
    """Prior knowledge of the DLO's place in the picture; the defaults state nothing."""

    region: Quadruple = (0.0, 0.0, 0.0, 0.0)
    colour_low: Vector = (0.0, 0.0, 0.0)
    colour_high: Vector = (180.0, 255.0, 255.0)
    mask: str = ""
    empty_board: str = ""
    depth: str = "auto"


@dataclass(frozen=True)
class Settings(RodSettings):
    """A whole parameter file.

    Beside the physics, `tolerances` are ("clamp_angle.start":
    std) what the file states of how well a set-up was made, also of effects that the model does not
    contain, see `tolerance`; `cameras` the poses of several by name, empty where there is but one.
    No part of a file is `own`: values that numbers have in single recordings, by both names, such
    as "effects.clamp_slip.onset@swing".
    """

    frame_id: str = "board"
    camera: CameraPose = field(default_factory=CameraPose)
    limits: LimitParameters = field(default_factory=LimitParameters)
    command: CommandParameters = field(default_factory=CommandParameters)
    wrench: WrenchParameters = field(default_factory=WrenchParameters)
    diagnosis: DiagnosisParameters = field(default_factory=DiagnosisParameters)
    vision: VisionParameters = field(default_factory=VisionParameters)
    image_transport: str = "auto"
    publish_tf: bool = True
    simulator_node: str = "simulator"
    tolerances: Mapping[str, float] = field(default_factory=dict)
    cameras: Mapping[str, CameraPose] = field(default_factory=dict)
    own: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], node: str | None = None) -> Settings:
        """Build from dotted names; what is missing takes its default.

        Args:
            values: values by their dotted names.
            node: name of the node whose settings they are, which need not be given what it does
                not use; None for a tool, which may use all.

        Raises:
            ParameterError: a required value is missing or a value is unusable.
        """
        checked: dict[str, Value] = {}
        for parameter in PARAMETERS:
            value = values.get(parameter.name, parameter.default)
            if value is None and node is not None and node not in parameter.nodes:
                value = parameter.unused
            if value is None:
                raise ParameterError(
                    f"{parameter.name} is missing; give the {parameter.description}"
                    f"{parameter.bracketed}"
                )
            checked[parameter.name] = parameter.check(value)
        effects: dict[str, dict[str, float | tuple[float, ...]]] = {}
        tolerances: dict[str, float] = {}
        whole = EFFECTS_PREFIX.rstrip(".")
        if values.get(whole) is not None:  # neither absent nor an empty block
            raise ParameterError(
                f"{whole} is {values[whole]!r:.80}; it must be a block of blocks, one for each "
                "effect, such as effects: {point_mass: {mass: 0.01, position: 0.2}}"
            )
        for key in sorted(k for k in values if k.startswith(EFFECTS_PREFIX)):
            name, _, part = key.removeprefix(EFFECTS_PREFIX).partition(".")
            stated = tolerance_of(name, part)
            if stated is not None:
                tolerances[f"{name}.{stated}"] = check_tolerance(name, stated, values[key])
            else:
                effects.setdefault(name, {})[part] = check_effect(name, part, values[key])
        rotation = checked["camera.rotation"]
        assert isinstance(rotation, tuple)
        check_rotation(rotation, "camera.rotation")  # type: ignore[arg-type]
        _check_command(checked)
        groups: dict[str, dict[str, Any]] = {}
        top: dict[str, Any] = {}
        for name, value in checked.items():
            group, _, key = name.rpartition(".")
            (groups.setdefault(group, {}) if group else top)[key] = value
        result = cls(
            rod=RodParameters(**groups["rod"]),
            damping=DampingParameters(**groups["damping"]),
            camera=CameraPose(**groups["camera"]),
            simulation=SimulationParameters(**groups["simulation"]),
            effects=effects,
            tolerances=tolerances,
            cameras=read_cameras(values),
            limits=LimitParameters(**groups["limits"]),
            command=CommandParameters(**groups["command"]),
            wrench=WrenchParameters(**groups["wrench"]),
            diagnosis=DiagnosisParameters(**groups["diagnosis"]),
            vision=VisionParameters(**groups["vision"]),
            **top,
        )
        result.check_effects()
        return result

    @classmethod
    def load(cls, path: Path | str) -> Settings:
        """Read a ROS 2 parameter file.

        Raises:
            ParameterError: the file is missing, is no YAML, or holds an unusable value.
        """
        values = read_parameter_file(Path(path))
        try:
            return cls.from_mapping(values)
        except ParameterError as err:
            raise ParameterError(f"{path}: {err}") from err

    def flat(self) -> dict[str, Value]:
        """All values by dotted name, those of effects and their tolerances after the others."""
        result: dict[str, Value] = {}
        for name in TABLE:
            target: Any = self
            for part in name.split("."):
                target = getattr(target, part)
            result[name] = target
        for effect, keys in self.effects.items():
            for key, number in keys.items():
                result[f"{EFFECTS_PREFIX}{effect}.{key}"] = number
        for key, std in self.tolerances.items():
            result[f"{EFFECTS_PREFIX}{key}{STD}"] = std
        return result | flat_cameras(self.cameras)

    def with_physics(self, other: RodSettings) -> Settings:
        """These settings, with all that a simulated DLO depends on taken from others."""
        parts = {f.name: getattr(other, f.name) for f in fields(RodSettings)}
        return replace(self, **parts)

    def dump(self, path: Path | str, comment: str = "") -> None:
        """Write a parameter file that nodes and tools load as it is."""
        write_text(path, self.text(comment))

    def text(self, comment: str = "", without: Collection[str] = ()) -> str:
        """Content of a parameter file that nodes and tools load as it is.

        Args:
            without: names of parameters that it shall not state.
        """
        lines = "".join(f"# {line}\n" for line in comment.splitlines())
        values = {name: x for name, x in self.flat().items() if name not in without}
        return f"{HEADER}\n{lines}{parameter_lines(values)}{END}\n"

    @property
    def command_delay(self) -> float:
        """Delay of the DLO's motion behind its commands that the file states [s]."""
        return sum(effect.later() for effect in build(self.effects))

    @property
    def camera_poses(self) -> dict[str, CameraPose]:
        """Poses of the board in all cameras by their names; that of the only one is empty."""
        return dict(self.cameras) or {"": self.camera}

    @property
    def camera_positions(self) -> dict[str, FloatArray]:
        """Positions [m] of the cameras that have names, shape (3,) each."""
        return {name: pose.position for name, pose in self.cameras.items()}


def _check_command(values: Mapping[str, Value]) -> None:
    """Refuse sources of the motion that name no frame, or offsets that turn by no rotation.

    Raises:
        ParameterError: which parameter, and what it must be.
    """
    for name in ("command.start_offset", "command.end_offset"):
        offset = values[name]
        assert isinstance(offset, tuple)
        if not 0.9 < math.hypot(*offset[3:]) < 1.1:
            raise ParameterError(
                f"{name} is {list(offset)}; its last four must be a unit quaternion x y z w"
            )
    named = values["command.start_frame"] or values["command.end_frame"]
    if values["command.source"] == "tf" and not named:
        raise ParameterError(
            "command.source is 'tf'; give command.start_frame or command.end_frame, the frame of "
            "/tf that holds that end"
        )


def tolerance(settings: Settings, name: str) -> float | None:
    """Standard deviation within which a number of a set-up is taken to be right.

    It is what the parameter file says (`effects.NAME.KEY_std`, `rod.length_std`), else the effect's
    own.

    Args:
        settings: parameter file.
        name: effect and key, such as "clamp_angle.start".

    Returns:
        In the number's SI unit, of its logarithm for a ratio; None: it has no tolerance.

    Raises:
        ParameterError: there is no such effect or key.
    """
    effect, _, key = name.partition(".")
    known = quantities(effect)
    if key not in known:
        raise ParameterError(
            f"effects.{name}: '{effect}' has no parameter '{key}'; it has {', '.join(known)}"
        )
    if name in settings.tolerances:
        return settings.tolerances[name]
    stated: Any = settings.flat()[known[key].stated_by] if known[key].stated_by else 0.0
    return stated if stated > 0.0 else known[key].tolerance_for(settings.scale)
