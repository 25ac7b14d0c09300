# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Settings of a simulated camera's pictures: intrinsics, board, rope, light, noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlo_ros.errors import InputError
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.experiment_block import ExperimentBlock

Colour = tuple[float, float, float]

COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8}

LARGEST_STD = 1.0  # [m] of a measured point


@dataclass(frozen=True)
class SimulatedCamera:
    """Intrinsics as in sensor_msgs/CameraInfo, and the rate of images.

    Args:
        width, height: size of the image [px].
        focal_length: fx and fy [px].
        principal_point: cx and cy [px].
        model: plumb_bob or rational_polynomial.
        distortion: coefficients in the order of OpenCV, 5 or 8.
        rate: images per second [Hz].
        noise: standard deviation of the sensor noise [grey levels].
        blur: standard deviation of the lens's point spread [px].
        jpeg_quality: 1 to 100.
        exposure: time over which an image is gathered [s], centred at its stamp.
    """

    width: int = 1920
    height: int = 1080
    focal_length: tuple[float, float] = (1450.0, 1450.0)
    principal_point: tuple[float, float] = (959.5, 539.5)
    model: str = "plumb_bob"
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    rate: float = 30.0
    noise: float = 2.0
    blur: float = 0.6
    jpeg_quality: int = 92
    exposure: float = 0.0

    @property
    def matrix(self) -> FloatArray:
        """Camera matrix K [px], shape (3, 3)."""
        (fx, fy), (cx, cy) = self.focal_length, self.principal_point
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @classmethod
    def read(cls, section: ExperimentBlock) -> SimulatedCamera:
        """From the block `camera` of an experiment file."""
        width = section.whole("width", cls.width, 32, 8192)
        height = section.whole("height", cls.height, 32, 8192)
        fx, fy = section.numbers("focal_length", cls.focal_length, 10.0, 1e5)
        middle = ((width - 1) / 2.0, (height - 1) / 2.0)
        cx, cy = section.numbers("principal_point", middle, -1e5, 1e5)
        model = section.raw("distortion_model", cls.model)
        if model not in COEFFICIENTS:
            raise InputError(
                f"{section.where}: distortion_model is {str(model)[:40]!r}; "
                f"it must be {' or '.join(COEFFICIENTS)}"
            )
        none = (0.0,) * COEFFICIENTS[model]
        return cls(
            width=width,
            height=height,
            focal_length=(fx, fy),
            principal_point=(cx, cy),
            model=model,
            distortion=section.numbers("distortion", none, -10.0, 10.0),
            rate=section.number("rate", cls.rate, 0.1, 1000.0),
            noise=section.number("noise", cls.noise, 0.0, 40.0),
            blur=section.number("blur", cls.blur, 0.0, 10.0),
            jpeg_quality=section.whole("jpeg_quality", cls.jpeg_quality, 1, 100),
            exposure=section.number("exposure", cls.exposure, 0.0, 0.2),
        )


@dataclass(frozen=True)
class Look:
    """Colours are red, green, blue from 0 to 255; lengths in m.

    Args:
        board_colour: colour of the extruded polystyrene.
        hole_pitch: distance of the pre-drilled holes; one lies at the board's origin.
        hole_diameter: 0 for a board without holes.
        grain: standard deviation of the board's texture [grey levels].
        unevenness: relative darkness of the darkest corner, 0 to 1.
        shadow: darkness of the rope's shadow, 0 to 1.
        rope_colour: colour of the rope.
        strand_pitch: length of one turn of the rope's strands, in diameters; 0 for a smooth wire.
        strand_contrast: darkness of the grooves between strands, 0 to 1.
        pin_colour: colour of the pins that hold the rope.
        pin_diameter: diameter of the pins' heads, in diameters of the rope; 0 for none.
        board_distance: y of the board's surface, where several cameras, a depth sensor or a rope in
            space are drawn; else it is the rope's radius.
    """

    board_colour: Colour = (214.0, 221.0, 226.0)
    hole_pitch: float = 0.02
    hole_diameter: float = 0.004
    grain: float = 2.5
    unevenness: float = 0.25
    shadow: float = 0.35
    rope_colour: Colour = (36.0, 52.0, 118.0)
    strand_pitch: float = 3.5
    strand_contrast: float = 0.45
    pin_colour: Colour = (150.0, 146.0, 140.0)
    pin_diameter: float = 0.6
    board_distance: float = 0.25

    @classmethod
    def read(cls, section: ExperimentBlock) -> Look:
        """From the block `look` of an experiment file."""

        def colour(key: str, default: Colour) -> Colour:
            r, g, b = section.numbers(key, default, 0.0, 255.0)
            return r, g, b

        return cls(
            board_colour=colour("board_colour", cls.board_colour),
            hole_pitch=section.number("hole_pitch", cls.hole_pitch, 1e-3, 10.0),
            hole_diameter=section.number("hole_diameter", cls.hole_diameter, 0.0, 10.0),
            grain=section.number("grain", cls.grain, 0.0, 50.0),
            unevenness=section.number("unevenness", cls.unevenness, 0.0, 0.95),
            shadow=section.number("shadow", cls.shadow, 0.0, 1.0),
            rope_colour=colour("rope_colour", cls.rope_colour),
            strand_pitch=section.number("strand_pitch", cls.strand_pitch, 0.0, 100.0),
            strand_contrast=section.number("strand_contrast", cls.strand_contrast, 0.0, 1.0),
            pin_colour=colour("pin_colour", cls.pin_colour),
            pin_diameter=section.number("pin_diameter", cls.pin_diameter, 0.0, 20.0),
            board_distance=section.number("board_distance", cls.board_distance, 1e-3, 1e2),
        )


@dataclass(frozen=True)
class DepthSensor:
    """The errors of a depth sensor beside the camera.

    Args:
        std: standard deviation of each pixel's depth [m].
        holes: share of all pixels without a depth.
        mixed: share of the pixels at the rope's edges whose depth lies between rope and board; the
            others there see the board.
        thin: half width of a rope [px] of which a seventh of the pixels is lost, more of thinner
            ones; 0: none.
    """

    std: float = 2e-3
    holes: float = 0.01
    mixed: float = 0.7
    thin: float = 1.5

    @classmethod
    def read(cls, section: ExperimentBlock) -> DepthSensor:
        """From the block `depth` of an experiment file."""
        return cls(
            std=section.number("std", cls.std, 0.0, 1.0),
            holes=section.number("holes", cls.holes, 0.0, 1.0),
            mixed=section.number("mixed", cls.mixed, 0.0, 1.0),
            thin=section.number("thin", cls.thin, 0.0, 1e3),
        )


@dataclass(frozen=True)
class Measurement:
    """The errors of an observer, where no images are made.

    Args:
        std: standard deviation of each point across the rope [m].
        spacing: distance of the measured points along the rope [m].
        twist_std: standard deviation of each point's twist angle [rad]; 0: twist is not measured.
    """

    std: float = 3e-4
    spacing: float = 4e-3
    twist_std: float = 0.0

    @classmethod
    def read(cls, section: ExperimentBlock) -> Measurement:
        """From the block `measurement` of an experiment file."""
        return cls(
            std=section.number("std", cls.std, 0.0, LARGEST_STD),
            spacing=section.number("spacing", cls.spacing, 1e-5, 1.0),
            twist_std=section.number("twist_std", cls.twist_std, 0.0, 10.0),
        )
