# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters that load, but look wrong: mostly a wrong unit, or a value that was never given."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dlo_ros.doctor.finding import Finding, ok, warning, wrong
from dlo_ros.errors import DloError

if TYPE_CHECKING:
    from dlo_ros.parameters import Settings


@dataclass(frozen=True)
class Usual:
    """The range in which a quantity of a real DLO usually lies.

    Args:
        name: the quantity's name, as it is printed.
        unit: the unit in which the quantity is printed.
        lower, upper: limits of the range.
        low, high: the likely reason for a value below or above the range.
    """

    name: str
    unit: str
    lower: float
    upper: float
    low: str
    high: str

    def judge(self, value: float) -> list[Finding]:
        """A warning where a value lies outside; nothing otherwise."""
        if self.lower <= value <= self.upper:
            return []
        unit = f" {self.unit}" if self.unit else ""
        span = f"usual is {self.lower:g} to {self.upper:g}{unit}"
        remedy = self.low if value < self.lower else self.high
        return [warning(f"{self.name} is {value:.4g}{unit}; {span}", remedy)]


LENGTH = Usual(
    "rod.length", "m", 0.05, 20.0,
    "give the free length in metres",
    "give the free length in metres, not in centimetres",
)  # fmt: skip
DENSITY = Usual(
    "rod.density", "kg/m^3", 20.0, 12000.0,  # foam to copper cable
    "give kg/m^3, not g/cm^3: mass over the volume of the free length",
    "give kg/m^3: mass over the volume of the free length, lead has 11300",
)  # fmt: skip
YOUNG_MODULUS = Usual(
    "rod.young_modulus", "Pa", 1e4, 3e11,  # foam to steel
    "give Pa, not MPa or GPa; a soft rope has 1e6",
    "give Pa; steel has 2e11, a cable of strands 1e8",
)  # fmt: skip
SLENDERNESS = Usual(
    "rod.length / rod.diameter", "", 20.0, 20000.0,
    "a rod is slender: below 20 shear, which the model leaves out, counts; are both in metres?",
    "are both in metres?",
)  # fmt: skip
BENDING_LENGTH = Usual(
    "(E I / (weight per length))^(1/3) / length", "", 0.01, 3.0,
    "it hangs like a chain: E can hardly be seen; is E in Pa?",
    "it hardly bends under its own weight: settled shapes hardly depend on E; is E in Pa?",
)  # fmt: skip
GRAVITY = Usual(
    "the magnitude of gravity", "m/s^2", 9.7, 9.9,
    "on Earth it is 9.81",
    "on Earth it is 9.81",
)  # fmt: skip
DRAG_RATE = Usual(
    "damping.air_drag / (mass per length)", "1/s", 0.0, 50.0,
    "",
    "the DLO creeps through the air as through honey; 0.01 N s/m^2 is a usual drag",
)  # fmt: skip
RELAXATION = Usual(
    "damping.relaxation_time", "s", 0.0, 0.1,
    "",
    "it is t_r in seconds, for most cables some milliseconds",
)  # fmt: skip
TOLERANCE = Usual(
    "simulation.tolerance", "of the length", 1e-5, 2e-3,
    "the simulation is finer than any camera, and slow",
    "the simulation's own error would be taken for the DLO's",
)  # fmt: skip
DISTANCE = Usual(
    "the distance from the camera to the board", "m", 0.1, 10.0,
    "camera.translation is in metres",
    "camera.translation is in metres, not in millimetres",
)  # fmt: skip

OBLIQUE = 60.0
"""Degrees between the view and the normal of the board from which depth errors double."""

UNIT = 1e-3
"""Deviation of a quaternion's norm from 1 that rounding explains."""

CAMERA = "camera.translation"
MESSAGES = "dlo_ros.parameter_file"
"""Who warns of unknown parameters."""


def judge_file(path: Path | str) -> tuple[list[Finding], Settings | None]:
    """Load a parameter file and judge it.

    Args:
        path: path of the parameter file.

    Returns:
        The findings, and the settings; None where the file cannot be used.
    """
    try:
        from dlo_ros.parameter_file import read_parameter_file
        from dlo_ros.parameters import Settings

        with _collected() as said:
            raw = read_parameter_file(Path(path))
            settings = Settings.load(path)
    except ModuleNotFoundError as err:
        return [warning(f"{path}: not judged, {err.name} is not installed")], None
    except DloError as err:
        return [wrong(str(err), "mend the file; config/default.yaml is an example")], None
    found = [warning(text, "mend its name, or take it out") for text in dict.fromkeys(said)]
    found += judge(settings)
    if CAMERA not in raw:
        found.append(
            warning(
                f"{path}: has no block camera; a distance of {settings.camera.translation[2]:g} m "
                "is assumed",
                "dlo_ros calibrate --board writes the block (needed for images only)",
            )
        )
    return found or [ok(f"{path}: loads, and nothing in it is unusual")], settings


def judge(settings: Settings) -> list[Finding]:
    """Warnings of what is unusual, and what cannot be right."""
    rod, damping = settings.rod, settings.damping
    gravity = math.hypot(*settings.gravity)
    found = [
        *LENGTH.judge(rod.length),
        *SLENDERNESS.judge(rod.length / rod.diameter),
        *DENSITY.judge(rod.density),
        *YOUNG_MODULUS.judge(rod.young_modulus),
        *GRAVITY.judge(gravity),
        *DRAG_RATE.judge(damping.air_drag / rod.linear_density),
        *RELAXATION.judge(damping.relaxation_time),
        *TOLERANCE.judge(settings.simulation.tolerance),
    ]
    if gravity:
        length = (rod.bending_stiffness / (rod.linear_density * gravity)) ** (1.0 / 3.0)
        found += BENDING_LENGTH.judge(length / rod.length)
        if settings.gravity[2] >= 0.0:
            found.append(
                warning(
                    f"gravity {list(settings.gravity)} does not point down in {settings.frame_id}",
                    "z points up there: the usual value is [0.0, 0.0, -9.81]",
                )
            )
    if 0.0 < settings.limits.bend_radius < rod.diameter / 2.0:
        found.append(
            warning(
                f"limits.bend_radius is {settings.limits.bend_radius:g} m, less than the DLO's own "
                "radius",
                "it is the radius of the axis, in metres",
            )
        )
    return [*found, *_camera(settings), *_files(settings)]


def _camera(settings: Settings) -> list[Finding]:
    translation, (x, y, z, w) = settings.camera.translation, settings.camera.rotation
    if translation[2] <= 0.0:
        return [
            wrong(
                f"camera.translation is {list(translation)}: the board lies behind the camera",
                "it is the board's origin in the camera's frame, z forward; "
                "dlo_ros calibrate --board writes it",
            )
        ]
    norm = math.hypot(x, y, z, w)
    found = DISTANCE.judge(math.hypot(*translation))
    if abs(norm - 1.0) > UNIT:
        found.append(
            warning(f"camera.rotation has the norm {norm:.4f}", "give a unit quaternion x y z w")
        )
    # The optical axis along the board's y axis: third row, second column of the rotation matrix.
    forward = 2.0 * (y * z + w * x) / norm**2
    angle = math.degrees(math.acos(min(1.0, abs(forward))))
    if angle > OBLIQUE:
        found.append(
            warning(
                f"the camera looks at the plane of the DLO at {angle:.0f} degrees from its normal",
                "is camera.rotation the board's in the camera's frame, as x y z w?",
            )
        )
    elif forward < 0.0:
        found.append(
            warning(
                "the camera looks at the board from behind",
                f"y of {settings.frame_id} points away from the camera",
            )
        )
    return found


def _files(settings: Settings) -> list[Finding]:
    named = {"vision.mask": settings.vision.mask, "vision.empty_board": settings.vision.empty_board}
    return [
        wrong(f"{name} is {path}, which is no file", "mend the path; relative ones start here")
        for name, path in named.items()
        if path and not Path(path).is_file()
    ]


@contextmanager
def _collected() -> Iterator[list[str]]:
    """Collect the parameter reader's warnings instead of printing them."""
    said: list[str] = []

    class Collect(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    logger, handler = logging.getLogger(MESSAGES), Collect(logging.WARNING)
    passed_on, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        yield said
    finally:
        logger.removeHandler(handler)
        logger.propagate = passed_on
