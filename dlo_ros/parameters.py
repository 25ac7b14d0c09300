"""The parameters of nodes and tools: one table gives name, type, unit, range and description.

The YAML reader, the nodes' parameter descriptors and the documentation all come from `PARAMETERS`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from dlo_ros.errors import ParameterError

LOG = logging.getLogger(__name__)

Value = float | int | str | bool | tuple[float, ...]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

EFFECTS_PREFIX = "effects."


@dataclass(frozen=True)
class Parameter:
    """One row of the table.

    Args:
        name: dotted name as in the parameter file.
        default: value where the file has none; None means that it must be given.
        description: one sentence.
        unit: SI unit, empty where there is none.
        kind: double, integer, string, bool or double[N].
        lower, upper: range, both ends allowed (numbers only; for arrays each element).
        choices: the allowed strings.
        nodes: the nodes that declare it.
        read_only: whether a change while running has no meaning.
    """

    name: str
    kind: str
    default: Value | None
    description: str
    unit: str = ""
    lower: float = -math.inf
    upper: float = math.inf
    choices: tuple[str, ...] = ()
    nodes: tuple[str, ...] = ("observer", "simulator", "identifier")
    read_only: bool = False

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
                    f"{self.name} is {value!r}; it must be a number [{self.unit}]"
                ) from None
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ParameterError(f"{self.name} is {value!r}; it must be a number [{self.unit}]")
        if not math.isfinite(value) or not self.lower <= value <= self.upper:
            raise ParameterError(
                f"{self.name} is {value:g} {self.unit}; allowed is {self.lower:g} to {self.upper:g}"
            )
        return float(value)


PARAMETERS: tuple[Parameter, ...] = (
    Parameter(
        "frame_id", "string", "board", "fixed frame of all splines and commands", read_only=True
    ),
    Parameter("rod.length", "double", None, "length of the DLO", "m", 1e-2, 1e2, read_only=True),
    Parameter(
        "rod.diameter",
        "double",
        None,
        "diameter of the round cross-section",
        "m",
        1e-4,
        1e-1,
        read_only=True,
    ),
    Parameter(
        "rod.poisson_ratio", "double", 0.33, "Poisson's ratio; G = E / (2 (1 + nu))", "", -0.99, 0.5
    ),
    Parameter(
        "rod.young_modulus", "double", None, "Young's modulus E, initial guess", "Pa", 1e3, 1e12
    ),
    Parameter(
        "rod.density", "double", None, "volumetric density mu, initial guess", "kg/m^3", 1.0, 1e5
    ),
    Parameter(
        "rod.density_std",
        "double",
        0.0,
        "standard deviation of the density where it was weighed; 0: the density is a guess",
        "kg/m^3",
        0.0,
        1e5,
    ),
    Parameter(
        "rod.control_points",
        "integer",
        10,
        "control points n of the published splines",
        "",
        4,
        200,
        read_only=True,
    ),
    Parameter(
        "gravity", "double[3]", (0.0, 0.0, -9.81), "gravity in frame_id", "m/s^2", -100.0, 100.0
    ),
    Parameter(
        "damping.air_drag",
        "double",
        0.01,
        "c: force per length is -c times the velocity",
        "N s/m^2",
        0.0,
        1e3,
    ),
    Parameter(
        "damping.air_drag_std",
        "double",
        0.0,
        "standard deviation of the drag where it is known; 0: a guess",
        "N s/m^2",
        0.0,
        1e3,
    ),
    Parameter(
        "damping.relaxation_time",
        "double",
        0.002,
        "t_r of Kelvin-Voigt damping: stress = E (strain + t_r strain rate)",
        "s",
        0.0,
        10.0,
    ),
    Parameter(
        "damping.relaxation_time_std",
        "double",
        0.0,
        "standard deviation of t_r where it is known; 0: a guess",
        "s",
        0.0,
        10.0,
    ),
    Parameter(
        "camera.translation",
        "double[3]",
        (0.0, 0.0, 1.2),
        "origin of frame_id in the camera's optical frame",
        "m",
        -1e3,
        1e3,
    ),
    Parameter(
        "camera.rotation",
        "double[4]",
        (0.70710678, 0.0, 0.0, 0.70710678),
        "rotation of frame_id in the camera's optical frame, quaternion x y z w",
        "",
        -1.0001,
        1.0001,
    ),
    Parameter(
        "simulation.tolerance",
        "double",
        2e-4,
        "shape error that the discretisation may have, as a fraction of the length",
        "",
        1e-6,
        0.1,
    ),
    Parameter(
        "simulation.start",
        "string",
        "equilibrium",
        "how a simulation starts from the observed shapes",
        choices=("equilibrium", "observed", "moving"),
    ),
    Parameter(
        "simulation.rate",
        "double",
        50.0,
        "rate of dlo/predicted",
        "Hz",
        0.1,
        1000.0,
        read_only=True,
    ),
    Parameter(
        "image_transport",
        "string",
        "auto",
        "which camera topic is used: raw, compressed or whichever is published",
        choices=("auto", "raw", "compressed"),
        nodes=("observer",),
        read_only=True,
    ),
    Parameter(
        "simulator_node",
        "string",
        "simulator",
        "name of the simulator node that the identifier keeps in step",
        nodes=("identifier",),
        read_only=True,
    ),
)

TABLE: Mapping[str, Parameter] = {p.name: p for p in PARAMETERS}


@dataclass(frozen=True)
class RodParameters:
    """Material and geometry of a round DLO, SI units."""

    length: float
    diameter: float
    young_modulus: float
    density: float
    poisson_ratio: float = 0.33
    density_std: float = 0.0
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
class CameraPose:
    """Pose of the board frame in the camera's optical frame (x right, y down, z forward)."""

    translation: Vector = (0.0, 0.0, 1.2)
    rotation: Quaternion = (0.70710678, 0.0, 0.0, 0.70710678)


@dataclass(frozen=True)
class SimulationParameters:
    """How the simulation is discretised, started and published."""

    tolerance: float = 2e-4
    start: str = "equilibrium"
    rate: float = 50.0


@dataclass(frozen=True)
class Settings:
    """A whole parameter file."""

    rod: RodParameters
    frame_id: str = "board"
    gravity: Vector = (0.0, 0.0, -9.81)
    damping: DampingParameters = field(default_factory=DampingParameters)
    camera: CameraPose = field(default_factory=CameraPose)
    simulation: SimulationParameters = field(default_factory=SimulationParameters)
    image_transport: str = "auto"
    simulator_node: str = "simulator"

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Settings:
        """Build from dotted names; what is missing takes its default.

        Raises:
            ParameterError: a required value is missing or a value is unusable.
        """
        checked: dict[str, Value] = {}
        for parameter in PARAMETERS:
            value = values.get(parameter.name, parameter.default)
            if value is None:
                raise ParameterError(
                    f"{parameter.name} is missing; give the {parameter.description} "
                    f"[{parameter.unit}]"
                )
            checked[parameter.name] = parameter.check(value)
        effects = sorted(k for k in values if k.startswith(EFFECTS_PREFIX))
        if effects:
            raise ParameterError(
                f"{effects[0]} names an effect that this model does not contain; remove it"
            )
        rotation = checked["camera.rotation"]
        assert isinstance(rotation, tuple)
        if not 0.9 < math.hypot(*rotation) < 1.1:
            raise ParameterError(
                f"camera.rotation is {list(rotation)}; it must be a unit quaternion x y z w"
            )
        groups: dict[str, dict[str, Any]] = {}
        top: dict[str, Any] = {}
        for name, value in checked.items():
            group, _, key = name.rpartition(".")
            (groups.setdefault(group, {}) if group else top)[key] = value
        return cls(
            rod=RodParameters(**groups["rod"]),
            damping=DampingParameters(**groups["damping"]),
            camera=CameraPose(**groups["camera"]),
            simulation=SimulationParameters(**groups["simulation"]),
            **top,
        )

    @classmethod
    def load(cls, path: Path | str) -> Settings:
        """Read a ROS 2 parameter file.

        Raises:
            ParameterError: the file is missing, is no YAML, or holds an unusable value.
        """
        return cls.from_mapping(read_parameter_file(Path(path)))

    def flat(self) -> dict[str, Value]:
        """All values by dotted name."""
        result: dict[str, Value] = {}
        for name in TABLE:
            target: Any = self
            for part in name.split("."):
                target = getattr(target, part)
            result[name] = target
        return result

    def dump(self, path: Path | str, comment: str = "") -> None:
        """Write a parameter file that nodes and tools load as it is."""
        Path(path).write_text(self.text(comment))

    def text(self, comment: str = "") -> str:
        """Content of a parameter file that nodes and tools load as it is."""
        tree: dict[str, Any] = {}
        for name, value in self.flat().items():
            *groups, key = name.split(".")
            node = tree
            for group in groups:
                node = node.setdefault(group, {})
            node[key] = list(value) if isinstance(value, tuple) else value
        text: str = yaml.safe_dump({"/**": {"ros__parameters": tree}}, sort_keys=False)
        lines = "".join(f"# {line}\n" for line in comment.splitlines())
        return lines + text

    def with_material(self, young_modulus: float, density: float) -> Settings:
        """The same settings with another E [Pa] and mu [kg/m^3]."""
        return replace(self, rod=replace(self.rod, young_modulus=young_modulus, density=density))


def read_parameter_file(path: Path) -> dict[str, Any]:
    """Dotted names and raw values of a ROS 2 parameter file, all node sections merged.

    Raises:
        ParameterError: the file is missing, is no YAML or has no `ros__parameters`.
    """
    try:
        tree = yaml.safe_load(path.read_text())
    except OSError as err:
        raise ParameterError(f"{path}: cannot be read ({err.strerror})") from err
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as err:
        first = str(err).splitlines()[0] if str(err) else type(err).__name__
        raise ParameterError(f"{path}: is no valid YAML ({first})") from err
    values: dict[str, Any] = {}
    sections = tree.values() if isinstance(tree, dict) else []
    blocks = [
        s["ros__parameters"] for s in sections if isinstance(s, dict) and "ros__parameters" in s
    ]
    if not blocks or not all(isinstance(b, dict) for b in blocks):
        raise ParameterError(f"{path}: has no block '/**: ros__parameters:' with parameters")
    for block in blocks:
        _flatten("", block, values)
    groups = {name.split(".")[0] for name in TABLE if "." in name}
    for name in values:
        if name not in TABLE and name.split(".")[0] in groups:
            LOG.warning("%s: unknown parameter %s is ignored", path, name)
    return values


def _flatten(prefix: str, block: Mapping[Any, Any], out: dict[str, Any]) -> None:
    for key, value in block.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            _flatten(f"{name}.", value, out)
        else:
            out[name] = value
