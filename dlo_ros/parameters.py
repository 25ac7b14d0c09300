# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Settings: a whole parameter file, checked against the parameter table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dlo_ros.effects import Body, RopeScale, Values, build, quantities
from dlo_ros.effects.base import PREFIX
from dlo_ros.effects.registry import STD, check_tolerance, tolerance_of
from dlo_ros.effects.registry import check as check_effect
from dlo_ros.errors import ParameterError
from dlo_ros.files import END, HEADER, write_text
from dlo_ros.parameter_cameras import CameraPose as CameraPose
from dlo_ros.parameter_cameras import Vector as Vector
from dlo_ros.parameter_cameras import check_rotation, flat_cameras, read_cameras
from dlo_ros.parameter_file import read_parameter_file
from dlo_ros.parameter_table import PARAMETERS, TABLE, Value
from dlo_ros.parameter_text import parameter_lines
from dlo_ros.spline import FloatArray, SplineBasis

Quadruple = tuple[float, float, float, float]

EFFECTS_PREFIX = PREFIX
STANDARD_GRAVITY = 9.81  # [m/s^2] by which a weight is measured, however gravity is configured


@dataclass(frozen=True)
class RodParameters:
    """Material and geometry of a round DLO, SI units."""

    length: float
    diameter: float
    young_modulus: float
    density: float
    poisson_ratio: float = 0.33
    density_std: float = 0.0
    specific_modulus_std: float = 0.0
    diameter_std: float = 0.0
    length_std: float = 0.0
    control_points: int = 10

    @property
    def area(self) -> float:
        """Cross-section area A [m^2]."""
        return math.pi * self.diameter**2 / 4.0

    @property
    def second_moment(self) -> float:
        """Second moment of area I = pi D^4 / 64 [m^4]."""
        return math.pi * self.diameter**4 / 64.0

    @property
    def bending_stiffness(self) -> float:
        """B = E I [N m^2]."""
        return self.young_modulus * self.second_moment

    @property
    def shear_modulus(self) -> float:
        """G = E / (2 (1 + nu)) [Pa]."""
        return self.young_modulus / (2.0 * (1.0 + self.poisson_ratio))

    @property
    def linear_density(self) -> float:
        """Mass per length [kg/m]."""
        return self.density * self.area

    @property
    def specific_modulus(self) -> float:
        """E / mu [m^2/s^2], which is all that settled shapes can tell."""
        return self.young_modulus / self.density


@dataclass(frozen=True)
class DampingParameters:
    """Damping and how well it is known; a standard deviation of 0 means a guess."""

    air_drag: float = 0.01
    air_drag_std: float = 0.0
    relaxation_time: float = 0.002
    relaxation_time_std: float = 0.0


@dataclass(frozen=True)
class SimulationParameters:
    """How the simulation is discretised, started and published."""

    tolerance: float = 2e-4
    start: str = "equilibrium"
    rate: float = 50.0


@dataclass(frozen=True)
class LimitParameters:
    """What the DLO bears: bend radius [m] and tension [N]; 0 where there is no limit."""

    bend_radius: float = 0.0
    tension: float = 0.0


@dataclass(frozen=True)
class WrenchParameters:
    """How well force-torque sensors at the grips measure; a standard deviation of 0: not known."""

    force_std: float = 0.0
    torque_std: float = 0.0
    force_bias_std: float = 0.0
    tool_mass_std: float = 0.1
    delay_std: float = 0.01


Offset = tuple[float, float, float, float, float, float, float]
NO_OFFSET: Offset = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class CommandParameters:
    """Where the imposed motion comes from.

    Offsets are the clamp's pose in its frame: x y z [m], quaternion x y z w, x along growing u.
    """

    source: str = "topic"
    start_frame: str = ""
    end_frame: str = ""
    start_offset: Offset = NO_OFFSET
    end_offset: Offset = NO_OFFSET


@dataclass(frozen=True)
class DiagnosisParameters:
    """What difference between model and DLO matters."""

    material_err: float = 5e-4


@dataclass(frozen=True)
class VisionParameters:
    """What is known of where the DLO is in the picture; the defaults say nothing."""

    region: Quadruple = (0.0, 0.0, 0.0, 0.0)
    colour_low: Vector = (0.0, 0.0, 0.0)
    colour_high: Vector = (180.0, 255.0, 255.0)
    mask: str = ""
    empty_board: str = ""
    depth: str = "auto"


@dataclass(frozen=True)
class Settings:
    """A whole parameter file.

    `effects` are the values of those that the model contains; `tolerances` ("clamp_angle.start":
    std) what the file states of how well a set-up was made, also of effects that the model does not
    contain, see `tolerance`; `cameras` the poses of several by name, empty where there is but one.
    """

    rod: RodParameters
    frame_id: str = "board"
    gravity: Vector = (0.0, 0.0, -9.81)
    damping: DampingParameters = field(default_factory=DampingParameters)
    camera: CameraPose = field(default_factory=CameraPose)
    simulation: SimulationParameters = field(default_factory=SimulationParameters)
    limits: LimitParameters = field(default_factory=LimitParameters)
    command: CommandParameters = field(default_factory=CommandParameters)
    wrench: WrenchParameters = field(default_factory=WrenchParameters)
    diagnosis: DiagnosisParameters = field(default_factory=DiagnosisParameters)
    vision: VisionParameters = field(default_factory=VisionParameters)
    image_transport: str = "auto"
    publish_tf: bool = True
    simulator_node: str = "simulator"
    effects: Values = field(default_factory=dict)
    tolerances: Mapping[str, float] = field(default_factory=dict)
    cameras: Mapping[str, CameraPose] = field(default_factory=dict)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], node: str | None = None) -> Settings:
        """Build from dotted names; what is missing takes its default.

        Args:
            values: by dotted name.
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

    def check_effects(self) -> None:
        """Refuse effects that leave no DLO.

        Raises:
            ParameterError: which quantity, its value, what is allowed.
        """
        if self.effects:
            self.body(SplineBasis(self.rod.control_points, self.rod.length)).check()

    @cached_property
    def slips(self) -> bool:
        """Whether a grip slips (maybe by nothing), so that the path of the motion counts."""
        basis = SplineBasis(self.rod.control_points, self.rod.length)
        return bool(self.effects) and self.body(basis).slip is not None

    def body(self, basis: SplineBasis, section: Vector = (1.0, 1.0, 1.0)) -> Body:
        """Material, mass and loads of the DLO, effects included, in a spline basis.

        Args:
            section: see `dlo_ros.rod.model.RodModel`.

        Raises:
            ParameterError: an effect acts on a place that is not on the DLO.
        """
        points, weight = basis.quadrature(3)
        nb = weight.size
        body = Body(
            basis, points, weight, self.rod.bending_stiffness * np.tile(section[:2], (nb, 1)),
            np.zeros((nb, 2)), np.zeros(nb), self.rod.linear_density, self.damping.air_drag,
            self.damping.relaxation_time, np.array(self.gravity),
        )  # fmt: skip
        for effect in build(self.effects):
            effect.shape_body(body)
        for angle, place in body.kinks:  # an angle, however long the DLO is
            hat = body.hat(place)
            body.bend_rest[:, 0] += angle / (body.lengthening * (hat @ body.weight)) * hat
        body.give_at_grips()
        return body

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

    @property
    def scale(self) -> RopeScale:
        """What numbers of effects are measured by."""
        rod, damping = self.rod, self.damping
        weight, mass = rod.linear_density * STANDARD_GRAVITY, rod.linear_density * rod.length
        return RopeScale(rod.length, weight, mass, damping.air_drag, damping.relaxation_time)

    def with_effects(self, effects: Values) -> Settings:
        """The same settings with these effects, by name and key, and no others."""
        return replace(self, effects=effects)

    def dump(self, path: Path | str, comment: str = "") -> None:
        """Write a parameter file that nodes and tools load as it is."""
        write_text(path, self.text(comment))

    def text(self, comment: str = "") -> str:
        """Content of a parameter file that nodes and tools load as it is."""
        lines = "".join(f"# {line}\n" for line in comment.splitlines())
        return f"{HEADER}\n{lines}{parameter_lines(self.flat())}{END}\n"

    @property
    def camera_poses(self) -> dict[str, CameraPose]:
        """Poses of the board in all cameras by their names; that of the only one is empty."""
        return dict(self.cameras) or {"": self.camera}

    @property
    def camera_positions(self) -> dict[str, FloatArray]:
        """Positions [m] of the cameras that have names, shape (3,) each."""
        return {name: pose.position for name, pose in self.cameras.items()}

    def with_material(self, young_modulus: float, density: float) -> Settings:
        """The same settings with another E [Pa] and mu [kg/m^3]."""
        return replace(self, rod=replace(self.rod, young_modulus=young_modulus, density=density))


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
