# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Poses of frames in one another, from the transforms of a bag or of a running system."""

from __future__ import annotations

import logging
import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import NANOSECONDS, NORM, UNIT
from dlo_ros.errors import InputError
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import Bag, deserialise
from dlo_ros.recordings.messages import MAX_DISTANCE, array, stamp_of
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

Pose = tuple[FloatArray, FloatArray]
"""Rotation (3, 3) and origin (3,) [m] of a frame in another."""

LATE = 500_000_000
"""Nanoseconds beyond the first and the last known instant for which a pose is taken to hold."""


def same_frame(one: str, other: str) -> bool:
    """Whether two names are of one frame; a slash before a name means nothing."""
    return one.lstrip("/") == other.lstrip("/")


def common_instants(
    stamps: Sequence[Sequence[int]], since: int = 0, settled: float = math.inf
) -> list[int]:
    """All stamps [ns] from one on at which each of several growing series has begun and lasts.

    What was told once, while others are told again and again, stays where it is: it neither begins
    nor ends.

    Args:
        stamps: the series, none of them empty.
        since: stamp before which none is wanted.
        settled: stamp from which on what was told once may be told again.

    Raises:
        InputError: they have no time in common, as where clocks differ.
    """
    if not stamps:
        return []
    bounds = [s for s in stamps if len(s) > 1 or s[0] >= settled]
    first, last = (f(s[k] for s in bounds or stamps) for f, k in ((max, 0), (min, -1)))
    if bounds and first > last + LATE:
        raise InputError(
            f"one of the frames is known until {last / NANOSECONDS:.3f} s, and another one from "
            f"{first / NANOSECONDS:.3f} s on; let their clocks agree"
        )
    first = max(first, since)
    return sorted(
        {s for each in bounds or stamps for s in each[bisect_left(each, first) :] if s <= last}
    )


@dataclass
class Transforms:
    """Parent of each frame, and its pose there over time."""

    parents: dict[str, str] = field(default_factory=dict)
    stamps: dict[str, list[int]] = field(default_factory=dict)
    poses: dict[str, list[Pose]] = field(default_factory=dict)

    def add(self, message: Any, *, fixed: bool) -> None:
        """Take a tf2_msgs/TFMessage.

        Args:
            fixed: whether its transforms hold for good.

        Raises:
            InputError: one of the transforms is none; the others are taken.
        """
        wrong: InputError | None = None
        for one in message.transforms:
            child, parent = str(one.child_frame_id), str(one.header.frame_id)
            t, r = one.transform.translation, one.transform.rotation
            try:
                pose = _pose(child, t, r)
            except InputError as err:  # the others of the message are as good as ever
                wrong = err
                continue
            self._take(child, parent, 0 if fixed else stamp_of(one), pose, fixed=fixed)
        if wrong is not None:
            raise wrong

    def add_pose(self, frame: str, message: Any) -> None:
        """Take a geometry_msgs/PoseStamped as the pose of a frame of this name.

        Raises:
            InputError: it is none.
        """
        if not stamp_of(message):
            raise InputError(f"a pose on {frame[:60]} has no stamp, which is needed")
        pose = _pose(frame, message.pose.position, message.pose.orientation)
        self._take(frame, str(message.header.frame_id), stamp_of(message), pose, fixed=False)

    def _take(self, child: str, parent: str, stamp: int, pose: Pose, *, fixed: bool) -> None:
        child, parent = child.lstrip("/"), parent.lstrip("/")
        if fixed or self.parents.get(child, parent) != parent:
            self.stamps[child], self.poses[child] = [], []
        self.parents[child] = parent
        stamps, poses = self.stamps.setdefault(child, []), self.poses.setdefault(child, [])
        at = bisect_right(stamps, stamp)
        if at and stamps[at - 1] == stamp:
            return
        stamps.insert(at, stamp)
        poses.insert(at, pose)

    def forget(self, until: int | None = None) -> None:
        """Drop the poses until a stamp [ns], but for the last before it; None: all of them."""
        for child, stamps in list(self.stamps.items()):
            if stamps == [0]:
                continue
            if until is None:
                del self.stamps[child], self.poses[child], self.parents[child]
                continue
            old = max(bisect_right(stamps, until) - 1, 0)
            del stamps[:old], self.poses[child][:old]

    def check(self, frame: str, fixed: str, stamp: int) -> None:
        """Refuse an instant [ns] at which a frame's pose in another is not known.

        Raises:
            InputError: nothing connects the two, or what does ends before it or begins after it.
        """
        up, down = self._joined(frame, fixed)
        for name in (*up, *down):
            first, last = self.stamps[name][0], self.stamps[name][-1]
            away = max(first - stamp, stamp - last)
            if first != 0 and away > LATE:
                when = "ends {} before" if stamp > last else "begins {} after"
                raise InputError(
                    f"the transform of '{name[:60]}' in '{self.parents[name][:60]}' "
                    f"{when.format(f'{away / 1e9:.2f} s')} the instant for which it is needed; "
                    "look at what publishes it, and whether its clock is that of the others"
                )

    def instants(self, frame: str, fixed: str, since: int = 0) -> list[int]:
        """Stamps [ns] at which a frame's pose in another is updated, while all of it is known.

        Empty where all that joins them holds for good.

        Args:
            since: stamp [ns] before which none is wanted.

        Raises:
            InputError: nothing connects the two, or what does has no time in common.
        """
        return common_instants(self.series(frame, fixed), since)

    def series(self, frame: str, fixed: str) -> list[list[int]]:
        """Growing stamps [ns] of each transform that leads from a frame to another.

        Those that hold for good are left out.

        Raises:
            InputError: nothing connects the two.
        """
        up, down = self._joined(frame, fixed)
        return [self.stamps[name] for name in (*up, *down) if self.stamps[name] != [0]]

    def lookup(
        self, frame: str, fixed: str, stamps: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Poses of a frame in another at stamps [ns], linear between two received ones.

        Returns:
            Rotations, shape (k, 3, 3), and origins [m], shape (k, 3).

        Raises:
            InputError: nothing connects the two.
        """
        up, down = self._joined(frame, fixed)
        rotations, origins = self._chain(up, stamps)
        base, zero = self._chain(down, stamps)
        back = base.transpose(0, 2, 1)
        return back @ rotations, np.einsum("kij,kj->ki", back, origins - zero)

    def _joined(self, frame: str, fixed: str) -> tuple[list[str], list[str]]:
        """The frames between each of two and what joins them."""
        up, down = self._way(frame.lstrip("/")), self._way(fixed.lstrip("/"))
        root = next((name for name in up if name in down), None)
        if root is None:
            known = ", ".join(sorted({*self.parents, *self.parents.values()})[:8]) or "none"
            raise InputError(
                f"no transform leads from '{frame[:60]}' to '{fixed}' (frames on /tf and "
                f"/tf_static: {known}); record them, or measure in '{fixed}'"
            )
        return up[: up.index(root)], down[: down.index(root)]

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
        known = np.array(self.stamps[name], dtype=np.int64)
        first, poses = int(known[0]), self.poses[name]
        at = np.interp(np.array(stamps) - first, known - first, np.arange(len(known)))
        before = np.minimum(at.astype(int), len(known) - 1)
        after = np.minimum(before + 1, len(known) - 1)
        share = (at - before)[:, None]
        a = Rotation.from_matrix([poses[k][0] for k in before])
        b = Rotation.from_matrix([poses[k][0] for k in after])
        turned = a * Rotation.from_rotvec(share * (a.inv() * b).as_rotvec())
        origins = np.array([p[1] for p in poses])
        return turned.as_matrix(), (1.0 - share) * origins[before] + share * origins[after]


def _pose(frame: str, position: Any, rotation: Any) -> Pose:
    """A pose of a message.

    Raises:
        InputError: a number is not finite, a place is far away, or the quaternion is not of norm 1.
    """
    turned = array(
        (rotation.x, rotation.y, rotation.z, rotation.w), f"the rotation of {frame[:60]}"
    )
    norm = float(np.linalg.norm(turned))
    if abs(norm - 1.0) > NORM:
        raise InputError(f"the rotation of {frame[:60]} has norm {norm:.3g}; {UNIT}")
    place = array((position.x, position.y, position.z), f"the position of {frame[:60]}")
    if float(np.abs(place).max()) > MAX_DISTANCE:
        raise InputError(f"{frame[:60]} is more than {MAX_DISTANCE:g} m away; metres are meant")
    return Rotation.from_quat(turned).as_matrix(), place


def transforms_of(bag: Bag) -> Transforms:
    """All transforms of a bag."""
    result = Transforms()
    for topic, fixed in ((topics.TRANSFORMS, True), (topics.MOVING_TRANSFORMS, False)):
        for raw in bag.messages([c for c in bag.connections if c.topic == topic]):
            try:
                result.add(deserialise(raw), fixed=fixed)
            except InputError as err:
                LOG.warning("%s: a message on %s is left out: %s", bag.path, topic, err)
    return result
