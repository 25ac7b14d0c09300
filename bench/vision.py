# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The observer's speed on rendered 1080p pictures: `python -m bench.vision`.

A rope of 1 m, ten pixels wide, hangs between two clamps in front of a board with holes and swings
by about a diameter a frame. First detection is measured with a new observer for each picture.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import cached_property
from statistics import median

import cv2
import numpy as np
from rich.console import Console

from bench.report import Row, show
from dlo_ros.command import Command, Motion
from dlo_ros.parameters import CameraPose, RodParameters, Settings
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.camera_geometry import Geometry
from dlo_ros.synthesis.picture_settings import Look, SimulatedCamera
from dlo_ros.synthesis.render import Renderer
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.planar_observer import Observer
from dlo_ros.vision.segmentation.ridge_map import Image

LENGTH, DIAMETER = 1.0, 0.008  # [m]
SPAN = 0.7  # [m] between the clamps
FRAMES = 12
INTERVAL = 33_333_333  # [ns]
SWING = 0.03  # [m] by which the middle moves from the first to the last picture
GOALS = {
    "tracking": 6.0,
    "first detection": 20.0,
    "first detection, ends unknown": 30.0,
}  # [ms]


def hanging(sway: float) -> FloatArray:
    """A curve of the length L between the clamps, its middle moved aside, (x, z), shape (m, 2)."""
    s = np.linspace(0.0, 1.0, 1001)
    low, high = 0.0, 1.0
    curve = np.zeros((len(s), 2))
    for _ in range(40):  # the sag that has the right length
        sag = 0.5 * (low + high)
        curve[:, 0] = SPAN * (s - 0.5) + sway * np.sin(np.pi * s) ** 2
        curve[:, 1] = 0.2 - sag * np.sin(np.pi * s)
        if np.sum(np.hypot(*np.diff(curve, axis=0).T)) < LENGTH:
            low = sag
        else:
            high = sag
    return curve


class Pictures:
    """The pictures, and the hints that the observer gets."""

    def __init__(self) -> None:
        view = SimulatedCamera()
        self.settings = Settings(
            RodParameters(LENGTH, DIAMETER, 1e6, 1000.0, control_points=16),
            camera=CameraPose((0.0, 0.0, 1.2), (2**-0.5, 0.0, 0.0, 2**-0.5)),
        )
        self.camera = Camera(
            view.matrix, (-0.05, 0.01, 0.0, 0.0, 0.0), view.width, view.height, self.settings.camera
        )
        geometry = Geometry(
            SimulatedCamera(distortion=self.camera.distortion), self.settings.camera
        )
        self._renderer = Renderer(geometry, Look(), DIAMETER, 1)
        self.curves = [hanging(sway) for sway in np.linspace(0.0, SWING, FRAMES)]

    @cached_property
    def images(self) -> list[Image]:
        """One picture for each curve."""
        result = []
        for curve in self.curves:
            line = np.column_stack([curve[:, 0], np.zeros(len(curve)), curve[:, 1]])
            u = np.linspace(0.0, LENGTH, len(curve))
            result.append(self._renderer.frame([line], u, np.zeros(0)))
        return result

    @cached_property
    def motion(self) -> Motion:
        """Both clamps at rest."""
        curve = self.curves[0]
        positions, rotations = [], []
        for at, beside in ((0, 1), (-1, -2)):
            along = (curve[beside] - curve[at]) * (1.0 if at == 0 else -1.0)
            angle = -np.arctan2(along[1], along[0])
            positions.append([curve[at, 0], 0.0, curve[at, 1]])
            rotations.append([0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)])
        motion = Motion()
        motion.add(
            Command(
                0,
                ("start", "end"),
                np.zeros(1),
                np.array([positions]),
                np.array([rotations]),
                np.full((1, 2, 3), np.nan),
                self.settings.rod.control_points,
            )
        )
        return motion

    def detection(self, *, clamps: bool) -> float:
        """CPU time of a first detection [ms], the median over the pictures."""
        used = []
        for image in self.images:
            observer = Observer(self.settings, self.camera, self.motion if clamps else None)
            used.append(timed(lambda o=observer, i=image: o.observe(0, i)))  # type: ignore[misc]
        return median(used)

    def tracking(self) -> float:
        """CPU time of an image that follows another one [ms], the median over the pictures."""
        observer = Observer(self.settings, self.camera, self.motion)
        used = []
        for k, image in enumerate(self.images):
            used.append(timed(lambda n=k, i=image: observer.observe(n * INTERVAL, i)))  # type: ignore[misc]
        return median(used[1:])


def timed(run: Callable[[], object]) -> float:
    """CPU time of a call [ms]."""
    began = time.process_time()
    run()
    return 1e3 * (time.process_time() - began)


def vision_rows(rounds: int) -> list[Row]:
    """The observer against its goals, on one core; the least of the rounds after one to warm up."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        pictures = Pictures()
        measured: dict[str, Callable[[], float]] = {
            "tracking": pictures.tracking,
            "first detection": lambda: pictures.detection(clamps=True),
            "first detection, ends unknown": lambda: pictures.detection(clamps=False),
        }
        found: dict[str, list[float]] = {name: [] for name in measured}
        for turn in range(rounds + 1):
            for name, measure in measured.items():
                value = measure()
                if turn:
                    found[name].append(value)
    finally:
        cv2.setNumThreads(threads)
    return [
        Row(
            f"observer, 1920 x 1080 colour, {name}",
            min(values),
            "ms",
            "goal",
            GOALS[name],
            1.0,
        )
        for name, values in found.items()
    ]


def main() -> None:
    """Measure and show."""
    parser = argparse.ArgumentParser(prog="python -m bench.vision", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="rounds (default 5)")
    show(Console(), vision_rows(parser.parse_args().rounds))


if __name__ == "__main__":
    main()
