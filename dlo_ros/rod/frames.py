"""Frames along the rod: a twist-free start, and the material frames that clamps impose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dlo_ros.rod.kernels import Reference, carry
from dlo_ros.spline import FloatArray, SplineBasis


@dataclass
class EndFrame:
    """Reference frame at one end of the rod and the material direction of the clamp there.

    Args:
        tangent, director: of the reference frame, transported in time without spin, shape (3,).
        body: the material director in the clamp's own coordinates; None until a clamp holds it.
        theta: imposed twist angle [rad], accumulated over full turns.
    """

    tangent: FloatArray
    director: FloatArray
    body: FloatArray | None = None
    theta: float = 0.0

    def turn(self, rotation: FloatArray) -> float:
        """Follow the clamp to a new orientation; returns the twist angle that it imposes [rad].

        Args:
            rotation: matrix of the clamp, shape (3, 3), its x axis along the rod.
        """
        tangent = rotation[:, 0]
        self.follow(tangent)
        second = np.cross(tangent, self.director)
        if self.body is None:
            material = np.cos(self.theta) * self.director + np.sin(self.theta) * second
            self.body = rotation.T @ material
        material = rotation @ self.body
        angle = float(np.arctan2(material @ second, material @ self.director))
        turns = (angle - self.theta + np.pi) % (2.0 * np.pi) - np.pi
        self.theta += turns
        return self.theta

    def follow(self, tangent: FloatArray) -> None:
        """Transport the reference frame to a new tangent."""
        director = np.empty(3)
        carry(self.director, self.tangent, np.ascontiguousarray(tangent), director)
        self.tangent, self.director = np.array(tangent, dtype=np.float64), director

    def copy(self) -> EndFrame:
        """An independent copy."""
        return EndFrame(self.tangent.copy(), self.director.copy(), self.body, self.theta)


def twist_free(
    q: FloatArray, basis: SplineBasis, points: FloatArray, director: FloatArray | None = None
) -> tuple[Reference, EndFrame, EndFrame]:
    """A twist-free (Bishop) frame along a shape.

    Args:
        q: control points, shape (n, 4) (theta is not used).
        basis: their basis.
        points: material coordinates of the bending points [m], shape (nb,), growing.
        director: first director at u = 0, shape (3,); default: any.

    Returns:
        The reference at the points, and the frames at both ends.
    """
    between = np.linspace(0.0, basis.length, 16 * basis.spans + 1)
    u = np.unique(np.concatenate([between, points]))
    p = basis.evaluate(q[:, :3], u, 1)
    s = basis.evaluate(q[:, :3], u, 2)
    speed = np.linalg.norm(p, axis=1, keepdims=True)
    tangent = p / speed
    rate = (s - tangent * np.sum(tangent * s, axis=1, keepdims=True)) / speed
    r = basis.evaluate(q[:, :3], u)
    start = director
    if start is None:
        start = np.eye(3)[1] if abs(tangent[0, 1]) < 0.9 else np.eye(3)[2]
    start = start - tangent[0] * (tangent[0] @ start)
    frame = np.empty_like(tangent)
    frame[0] = start / np.linalg.norm(start)
    for k in range(len(u) - 1):
        # Two reflections carry the frame with an error of fourth order in the spacing.
        v1 = r[k + 1] - r[k]
        c1 = max(float(v1 @ v1), 1e-300)
        d = frame[k] - 2.0 / c1 * (v1 @ frame[k]) * v1
        t = tangent[k] - 2.0 / c1 * (v1 @ tangent[k]) * v1
        v2 = tangent[k + 1] - t
        c2 = float(v2 @ v2)
        if c2 > 1e-30:
            d = d - 2.0 / c2 * (v2 @ d) * v2
        d = d - tangent[k + 1] * (tangent[k + 1] @ d)
        frame[k + 1] = d / np.linalg.norm(d)
    at = np.searchsorted(u, points)
    reference = Reference(
        np.ascontiguousarray(tangent[at]),
        np.ascontiguousarray(rate[at]),
        np.ascontiguousarray(frame[at]),
        np.zeros(len(points)),
    )
    ends = [EndFrame(tangent[k].copy(), frame[k].copy()) for k in (0, -1)]
    return reference, ends[0], ends[1]


def rotation_matrix(quaternion: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of a unit quaternion x y z w."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
