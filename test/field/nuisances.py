# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What is a little wrong with every set-up, and how its camera errs."""

from dataclasses import dataclass

import numpy as np

DEGREE = np.pi / 180.0
SAMPLES = 41  # of curvature along the rope
REACH = 0.2  # over L, of smooth functions along the rope


def smooth(rng: np.random.Generator, u: np.ndarray, reach: float = REACH) -> np.ndarray:
    """A random smooth function of u / L with standard deviation 1, shape (m,)."""
    apart = np.subtract.outer(u, u) / reach
    values, vectors = np.linalg.eigh(np.exp(-0.5 * apart**2))
    return vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=len(u)))


def set_up(rng: np.random.Generator, length: float, ends: tuple[str, ...]) -> dict[str, dict]:
    """Errors of a set-up as careful people build it, as effects of an experiment file.

    Args:
        ends: ends that are clamped in any recording.
    """
    n = rng.normal
    curvature = 0.5 / length * smooth(rng, np.linspace(0.0, 1.0, SAMPLES), 2.0 * REACH)
    effects: dict[str, dict] = {
        "gravity_tilt": {"angle": DEGREE * n()},
        "length_error": {"difference": 5e-3 * length * n()},
        "camera_scale": {"ratio": 1.0 + 5e-3 * n()},
        "camera_rotation": {"angle": 0.5 * DEGREE * n()},
        "camera_shift": {"x": 5e-3 * length * n(), "z": 5e-3 * length * n()},
        "intrinsic_curvature": {"curvature": curvature.tolist()},
        "stiffness_gradient": {"change": float(np.clip(0.3 * n(), -0.9, 0.9))},
        "command_delay": {"delay": abs(0.02 * n())},
    }
    if ends:
        effects["clamp_angle"] = {e: 3.0 * DEGREE * n() for e in ends}
        effects["clamp_offset"] = {e: list(5e-3 * length * n(size=2)) for e in ends}
    return effects


@dataclass(frozen=True)
class Errors:
    """How shapes are measured wrongly.

    Args:
        fixed: error of each control point along `axes` that is the same in every picture [m], shape
            (n, axes).
        fading: standard deviation of what is new, slowly, in each picture [m].
        memory: correlation of neighbouring pictures.
        stretch: relative error of u where the end is free.
        gross, missing: shares of the pictures.
        axes: coordinates that are measured.
    """

    fixed: np.ndarray
    fading: float
    memory: float
    stretch: float
    gross: float = 0.02
    missing: float = 0.05
    axes: tuple[int, ...] = (0, 2)

    @classmethod
    def drawn(
        cls, rng: np.random.Generator, u: np.ndarray, length: float, axes: tuple[int, ...] = (0, 2)
    ) -> "Errors":
        """Errors of a camera that was set up with care.

        Args:
            u: material coordinates of the control points over L, shape (n,).
            length: L [m].
            axes: coordinates that are measured.
        """
        fixed = 1e-3 * length * np.column_stack([smooth(rng, u) for _ in axes])
        memory, stretch = float(rng.uniform(0.2, 0.6)), 5e-3 * rng.normal()
        return cls(fixed, 3e-4, memory, stretch, axes=axes)

    def of(
        self, rng: np.random.Generator, shapes: np.ndarray, u: np.ndarray, free: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Shapes as they are seen.

        Args:
            shapes: control points, (F, n, 3).
            u: material coordinates of the control points over L.
            free: whether the rope's end is.

        Returns:
            Control points, and which pictures there are, shape (F,).
        """
        seen = shapes.copy()
        axes = list(self.axes)
        fading = np.zeros((len(u), len(axes)))
        kept = rng.random(len(shapes)) >= self.missing
        kept[0] = True
        for picture in seen:
            new = self.fading * rng.normal(size=fading.shape)
            fading = self.memory * fading + np.sqrt(1.0 - self.memory**2) * new
            if free:
                picture += (self.stretch * u)[:, None] * np.gradient(picture, u, axis=0)
            picture[:, axes] += fading + self.fixed
            if rng.random() < self.gross:
                size = np.ptp(shapes[0], axis=0).max()
                wrong = np.column_stack([smooth(rng, u) for _ in axes])
                picture[:, axes] += 0.1 * size * wrong
        return seen, kept
