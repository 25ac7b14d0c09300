# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The parameters of nodes and tools: one table gives name, type, unit, range and description.

The YAML reader, the nodes' parameter descriptors and the documentation all come from `PARAMETERS`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
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
        description: one sentence.
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


WRENCH = (
    ("force_std", 0.0, "white noise of a measured force at a grip; 0: not known", "N", 1e6),
    ("torque_std", 0.0, "white noise of a measured torque at a grip; 0: not known", "N m", 1e6),
    ("force_bias_std", 0.0, "how well a force sensor's zero is known; 0: not at all", "N", 1e6),
    ("tool_mass_std", 0.1, "how well a tared tool before the sensor is compensated", "kg", 1e3),
    ("delay_std", 0.01, "how well forces and pictures have one clock", "s", 1.0),
)
"""Of sensors at the grips: name, default, description, unit, largest value."""

PARAMETERS: tuple[FileParameter, ...] = (
    FileParameter(
        "frame_id", "string", "board", "fixed frame of all splines and commands", read_only=True
    ),
    FileParameter(
        "rod.length", "double", None, "length of the DLO", "m", 1e-2, 1e2, read_only=True
    ),
    FileParameter(
        "rod.diameter",
        "double",
        None,
        "diameter of the round cross-section",
        "m",
        1e-4,
        1e-1,
        read_only=True,
    ),
    FileParameter(
        "rod.poisson_ratio",
        "double",
        0.33,
        "Poisson's ratio; G = E / (2 (1 + nu))",
        "",
        -0.99,
        0.5,
        nodes=MODEL,
    ),
    FileParameter(
        "rod.young_modulus",
        "double",
        None,
        "Young's modulus E, initial guess",
        "Pa",
        1e3,
        1e12,
        nodes=MODEL,
        unused=1e6,
    ),
    FileParameter(
        "rod.density",
        "double",
        None,
        "volumetric density mu, initial guess",
        "kg/m^3",
        1.0,
        1e5,
        nodes=MODEL,
        unused=1e3,
    ),
    FileParameter(
        "rod.density_std",
        "double",
        0.0,
        "standard deviation of the density where it was weighed; 0: the density is a guess",
        "kg/m^3",
        0.0,
        1e5,
        nodes=MODEL,
    ),
    FileParameter(
        "rod.specific_modulus_std",
        "double",
        0.0,
        "standard deviation of E/mu as it was identified, for the band of a rehearsal; 0: unknown",
        "m^2/s^2",
        0.0,
        1e12,
        nodes=("simulator",),
    ),
    FileParameter(
        "rod.diameter_std",
        "double",
        0.0,
        "standard deviation of the diameter; 0: 2 % of it, as a caliper has it on a soft DLO",
        "m",
        0.0,
        1e-1,
        nodes=("identifier",),
    ),
    FileParameter(
        "rod.length_std",
        "double",
        0.0,
        "standard deviation of the length; 0: 0.5 % of it, as a tape measure has it",
        "m",
        0.0,
        1e2,
        nodes=("identifier",),
    ),
    FileParameter(
        "rod.control_points",
        "integer",
        10,
        "control points n of the published splines",
        "",
        4,
        200,
        read_only=True,
    ),
    FileParameter(
        "gravity",
        "double[3]",
        (0.0, 0.0, -9.81),
        "gravity in frame_id",
        "m/s^2",
        -100.0,
        100.0,
        nodes=MODEL,
    ),
    FileParameter(
        "command.source",
        "string",
        "topic",
        "where the imposed motion comes from: dlo/command, frames of /tf, or poses",
        choices=("topic", "tf", "pose"),
        read_only=True,
    ),
    FileParameter(
        "command.start_frame",
        "string",
        "",
        "source tf: frame that holds the start of the DLO; empty: it is free",
        read_only=True,
    ),
    FileParameter(
        "command.end_frame",
        "string",
        "",
        "source tf: frame that holds the end of the DLO; empty: it is free",
        read_only=True,
    ),
    FileParameter(
        "command.start_offset",
        "double[7]",
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        "clamp of the start in its frame or pose: x y z [m], quaternion x y z w; x along growing u",
        lower=-1e2,
        upper=1e2,
        read_only=True,
    ),
    FileParameter(
        "command.end_offset",
        "double[7]",
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        "clamp of the end in its frame or pose: x y z [m], quaternion x y z w; x along growing u",
        lower=-1e2,
        upper=1e2,
        read_only=True,
    ),
    FileParameter(
        "damping.air_drag",
        "double",
        0.01,
        "c: force per length is -c times the velocity",
        "N s/m^2",
        0.0,
        1e3,
        nodes=MODEL,
    ),
    FileParameter(
        "damping.air_drag_std",
        "double",
        0.0,
        "standard deviation of the drag where it is known; 0: a guess",
        "N s/m^2",
        0.0,
        1e3,
        nodes=MODEL,
    ),
    FileParameter(
        "damping.relaxation_time",
        "double",
        0.002,
        "t_r of Kelvin-Voigt damping: stress = E (strain + t_r strain rate)",
        "s",
        0.0,
        10.0,
        nodes=MODEL,
    ),
    FileParameter(
        "damping.relaxation_time_std",
        "double",
        0.0,
        "standard deviation of t_r where it is known; 0: a guess",
        "s",
        0.0,
        10.0,
        nodes=MODEL,
    ),
    FileParameter(
        "camera.translation",
        "double[3]",
        (0.0, 0.0, 1.2),
        "origin of frame_id in the camera's optical frame",
        "m",
        -1e3,
        1e3,
        nodes=("observer",),
    ),
    FileParameter(
        "camera.rotation",
        "double[4]",
        (0.70710678, 0.0, 0.0, 0.70710678),
        "rotation of frame_id in the camera's optical frame, quaternion x y z w",
        "",
        -1.0001,
        1.0001,
        nodes=("observer",),
    ),
    FileParameter(
        "simulation.tolerance",
        "double",
        2e-4,
        "shape error that the discretisation may have, as a fraction of the length",
        "",
        1e-6,
        0.1,
        nodes=MODEL,
    ),
    FileParameter(
        "simulation.start",
        "string",
        "equilibrium",
        "how a simulation starts from the observed shapes",
        choices=("equilibrium", "observed", "moving"),
        nodes=MODEL,
    ),
    FileParameter(
        "simulation.model",
        "string",
        "spline",
        "the rod model; other packages may add theirs beside spline",
        nodes=MODEL,
        read_only=True,
    ),
    FileParameter(
        "simulation.rate",
        "double",
        50.0,
        "rate of dlo/predicted",
        "Hz",
        0.1,
        1000.0,
        read_only=True,
        nodes=("simulator",),
    ),
    FileParameter(
        "limits.bend_radius",
        "double",
        0.0,
        "smallest bend radius that the DLO bears; a prediction below raises an alarm; 0: no limit",
        "m",
        0.0,
        1e2,
        nodes=("simulator",),
    ),
    FileParameter(
        "limits.tension",
        "double",
        0.0,
        "largest tension that the DLO bears; a prediction beyond raises an alarm; 0: no limit",
        "N",
        0.0,
        1e6,
        nodes=("simulator",),
    ),
    *(
        FileParameter(
            f"wrench.{name}", "double", default, text, unit, 0.0, most, nodes=("identifier",)
        )
        for name, default, text, unit, most in WRENCH
    ),
    FileParameter(
        "diagnosis.material_err",
        "double",
        5e-4,
        "ERR from which a difference between model and DLO matters, as a fraction of the length",
        "",
        0.0,
        0.1,
        nodes=("identifier",),
    ),
    FileParameter(
        "vision.region",
        "double[4]",
        (0.0, 0.0, 0.0, 0.0),
        "part of the image in which the DLO is: x, y, width, height; width 0: the whole image",
        "px",
        0.0,
        1e5,
        nodes=("observer",),
    ),
    FileParameter(
        "vision.colour_low",
        "double[3]",
        (0.0, 0.0, 0.0),
        "least hue (0 to 180), saturation and value (0 to 255) of the DLO; "
        "a least hue above the largest means a range over red",
        "",
        0.0,
        255.0,
        nodes=("observer",),
    ),
    FileParameter(
        "vision.colour_high",
        "double[3]",
        (180.0, 255.0, 255.0),
        "largest hue, saturation and value of the DLO",
        "",
        0.0,
        255.0,
        nodes=("observer",),
    ),
    FileParameter(
        "vision.mask",
        "string",
        "",
        "image file, black where the DLO cannot be",
        nodes=("observer",),
    ),
    FileParameter(
        "vision.empty_board",
        "string",
        "",
        "image file of the same view without the DLO",
        nodes=("observer",),
    ),
    FileParameter(
        "vision.depth",
        "string",
        "auto",
        "whether depth images aligned with the one camera are used where they are published",
        choices=("auto", "off"),
        nodes=("observer",),
        read_only=True,
    ),
    FileParameter(
        "image_transport",
        "string",
        "auto",
        "which camera topic is used: raw, compressed or whichever is published",
        choices=("auto", "raw", "compressed"),
        nodes=("observer",),
        read_only=True,
    ),
    FileParameter(
        "publish_tf",
        "bool",
        True,
        "whether the board's pose in the camera is published on /tf_static",
        nodes=("observer",),
        read_only=True,
    ),
    FileParameter(
        "simulator_node",
        "string",
        "simulator",
        "name of the simulator node that the identifier keeps in step",
        nodes=("identifier",),
        read_only=True,
    ),
)

TABLE: Mapping[str, FileParameter] = {p.name: p for p in PARAMETERS}
