# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measured forces of the grips as they arrive, transformed to `frame_id`."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from dlo_ros.command import Command
from dlo_ros.errors import InputError
from dlo_ros.nodes import qos
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.nodes.transform_listener import TransformListener
from dlo_ros.observation import Wrenches
from dlo_ros.recordings.messages import stamp_of
from dlo_ros.recordings.transforms import LATE, Transforms, same_frame
from dlo_ros.recordings.wrenches import TOPICS, in_fixed_frame, wrench_of
from dlo_ros.spline import FloatArray

KEPT = 2000
"""Messages of an end that wait for a spline, or for the pose of their frame: two seconds at 1 kHz.
"""

PATIENCE = 1.0
"""Seconds that transforms have to come, once they are asked for."""


class MeasuredForces:
    """Messages of `dlo/wrench_start` and `dlo/wrench_end`, transformed to `frame_id`.

    Args:
        node: node that subscribes; to transforms only once a message is in another frame.
    """

    def __init__(self, node: DloNode) -> None:
        self._node = node
        self._waiting: dict[str, deque[tuple[int, str, FloatArray]]] = {}
        self._listener: TransformListener | None = None
        self._since = 0.0  # when transforms were asked for
        for end, topic in TOPICS.items():
            node.subscribe(topic, partial(self.hear, end), qos.FORCES)

    def hear(self, end: str, message: Any) -> None:
        """Take a geometry_msgs/WrenchStamped.

        Raises:
            InputError: its stamp is none, or another clock's; see `wrench_of`.
        """
        frame, stamp = str(message.header.frame_id), stamp_of(message)
        values = wrench_of(message, TOPICS[end])
        self._node.check_stamp(stamp, TOPICS[end])
        if self._node.is_earlier(stamp):
            return
        if self._listener is None and not same_frame(frame, self._node.settings.frame_id):
            self._listener, self._since = TransformListener(self._node), time.monotonic()
        self._node.health.count("measured forces")
        self._waiting.setdefault(end, deque(maxlen=KEPT)).append((stamp, frame, values))

    def forget(self) -> None:
        """Drop the messages that wait."""
        self._waiting.clear()

    def take(self, commands: Sequence[Command]) -> list[Wrenches]:
        """The messages so far in `frame_id`; those whose frame has no pose yet wait.

        Args:
            commands: commands that say where the ends are held.
        """
        result = []
        for end, waiting in self._waiting.items():
            frames = {frame for _, frame, _ in waiting}
            left: list[tuple[int, str, FloatArray]] = []
            for frame in frames:
                rows = {s: values for s, f, values in waiting if f == frame}
                until = self._known_until(frame, max(rows))
                ready = np.array(sorted(s for s in rows if s <= until), dtype=np.int64)
                left += [(s, frame, rows[s]) for s in sorted(rows) if s > until]
                if len(ready):
                    table = np.array([rows[int(s)] for s in ready])
                    result += self._turned(end, ready, table, frame, commands)
            waiting.clear()
            waiting.extend(left)
        return result

    @property
    def _transforms(self) -> Transforms:
        return Transforms() if self._listener is None else self._listener.transforms

    def _known_until(self, frame: str, newest: int) -> float:
        """Stamp [ns] until which a frame's pose is known; infinite where waiting is of no use.

        Args:
            newest: stamp of the last message [ns].
        """
        fixed = self._node.settings.frame_id
        if same_frame(frame, fixed):
            return np.inf
        try:
            stamps = self._transforms.instants(frame, fixed)
        except InputError:
            return -np.inf if time.monotonic() < self._since + PATIENCE else np.inf
        return stamps[-1] if stamps and newest < stamps[-1] + LATE else np.inf

    def _turned(
        self, end: str, stamps: np.ndarray, table: FloatArray, frame: str,
        commands: Sequence[Command],
    ) -> list[Wrenches]:  # fmt: skip
        """Forces (k, 6) of a frame in `frame_id`; empty, with a warning, where its pose is
        unknown.
        """
        settings, topic, transforms = self._node.settings, TOPICS[end], self._transforms
        try:
            if not same_frame(frame, settings.frame_id):
                transforms.check(frame, settings.frame_id, int(stamps[-1]))
            found = in_fixed_frame(end, stamps, table, frame, settings, commands, transforms)
        except InputError as err:
            said = f"{topic} is in frame '{frame[:60]}' and not used: {err}"
            mend = "" if same_frame(frame, settings.frame_id) else f"; {self._mend(frame)}"
            self._node.health.warn(topic, said + mend)
            return []
        self._node.health.solved(topic)
        return [found]

    def _mend(self, frame: str) -> str:
        """Remedy for an unknown frame."""
        fixed = self._node.settings.frame_id
        if self._listener is not None and not self._listener.available:
            return (
                f"transforms need tf2_msgs, which is missing: install ros-jazzy-tf2-msgs, or "
                f"publish forces in '{fixed}'"
            )
        return (
            f"publish where it is, such as by 'ros2 run tf2_ros static_transform_publisher "
            f"--frame-id {fixed} --child-frame-id {frame[:60]} ...', or publish forces in '{fixed}'"
        )
