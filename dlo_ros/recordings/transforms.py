# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Poses of frames in one another, from the transforms of a bag or of a running system."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.errors import InputError
from dlo_ros.recordings.messages import array, stamp_of
from dlo_ros.spline import FloatArray

Pose = tuple[FloatArray, FloatArray]
"""Rotation (3, 3) and origin (3,) [m] of a frame in another."""


@dataclass
class Transforms:
    """What was told of frames: for each its parent, and its pose there over time."""

    parents: dict[str, str] = field(default_factory=dict)
    stamps: dict[str, list[int]] = field(default_factory=dict)
    poses: dict[str, list[Pose]] = field(default_factory=dict)

    def add(self, message: Any, *, fixed: bool) -> None:
        """Take a tf2_msgs/TFMessage.

        Args:
            fixed: whether its transforms hold for good.

        Raises:
            InputError: a transform is none.
        """
        for one in message.transforms:
            child = str(one.child_frame_id).lstrip("/")
            t, r = one.transform.translation, one.transform.rotation
            turned = array((r.x, r.y, r.z, r.w), f"the rotation of {child[:60]}")
            if not np.linalg.norm(turned) > 0.0:
                raise InputError(f"the rotation of {child[:60]} is no quaternion")
            pose = Rotation.from_quat(turned).as_matrix(), array((t.x, t.y, t.z), "a translation")
            self.parents[child] = str(one.header.frame_id).lstrip("/")
            stamps = self.stamps.setdefault(child, [])
            poses = self.poses.setdefault(child, [])
            at = 0 if fixed else bisect_right(stamps, stamp_of(one))
            stamps.insert(at, 0 if fixed else stamp_of(one))
            poses.insert(at, pose)

    def lookup(
        self, frame: str, fixed: str, stamps: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Poses of a frame in another at stamps [ns], between two that were told linearly.

        Returns:
            Rotations, shape (k, 3, 3), and origins [m], shape (k, 3).

        Raises:
            InputError: nothing connects the two.
        """
        up, down = self._way(frame.lstrip("/")), self._way(fixed.lstrip("/"))
        root = next((name for name in up if name in down), None)
        if root is None:
            known = ", ".join(sorted({*self.parents, *self.parents.values()})[:8]) or "none"
            raise InputError(
                f"no transform leads from '{frame[:60]}' to '{fixed}' (frames on /tf and "
                f"/tf_static: {known}); record them, or measure in '{fixed}'"
            )
        rotations, origins = self._chain(up[: up.index(root)], stamps)
        base, zero = self._chain(down[: down.index(root)], stamps)
        back = base.transpose(0, 2, 1)
        return back @ rotations, np.einsum("kij,kj->ki", back, origins - zero)

    def _way(self, frame: str) -> list[str]:
        """A frame and all above it."""
        result = [frame]
        while result[-1] in self.parents and self.parents[result[-1]] not in result:
            result.append(self.parents[result[-1]])
        return result

    def _chain(self, frames: list[str], stamps: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Pose of the first frame in the parent of the last."""
        count = len(stamps)
        rotation, origin = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
        for name in frames:
            turned, moved = self._poses(name, stamps)
            origin = moved + np.einsum("kij,kj->ki", turned, origin)
            rotation = turned @ rotation
        return rotation, origin

    def _poses(self, name: str, stamps: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Poses of a frame in its parent."""
        told = np.array(self.stamps[name], dtype=np.int64)
        first, poses = int(told[0]), self.poses[name]
        at = np.interp(np.array(stamps) - first, told - first, np.arange(len(told)))
        before = np.minimum(at.astype(int), len(told) - 1)
        after = np.minimum(before + 1, len(told) - 1)
        share = (at - before)[:, None]
        a = Rotation.from_matrix([poses[k][0] for k in before])
        b = Rotation.from_matrix([poses[k][0] for k in after])
        turned = a * Rotation.from_rotvec(share * (a.inv() * b).as_rotvec())
        origins = np.array([p[1] for p in poses])
        return turned.as_matrix(), (1.0 - share) * origins[before] + share * origins[after]
