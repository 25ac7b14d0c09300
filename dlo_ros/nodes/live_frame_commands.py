# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Commands from a robot's frames or poses as they arrive (`command.source`)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import InputError, ParameterError
from dlo_ros.nodes import qos
from dlo_ros.nodes.node_base import JUMP_BACK, DloNode, latest
from dlo_ros.nodes.transform_listener import KEPT, TransformListener
from dlo_ros.recordings.frame_commands import (
    LONGEST_SILENCE,
    POSES,
    clamp_frames,
    command_of,
    instants,
)
from dlo_ros.recordings.messages import stamp_of

PERIOD = 0.02
"""Seconds of wall time between two commands: a robot publishes its frames more often than that."""

POLL = 0.5
"""Seconds between two looks at whether the frames are there."""

SILENCE_TIMEOUT = 1.0
"""Seconds after which a warning says that a robot publishes nothing any more."""


class FrameCommands:
    """Commands from frames: each leads from the last known pose to the newest one.

    Args:
        node: node that subscribes; its settings name the frames.
        callback: function that is called with each command.

    Raises:
        ParameterError: tf2_msgs is missing, and frames are wanted.
    """

    def __init__(self, node: DloNode, callback: Callable[[Command], None]) -> None:
        self._node, self._callback = node, callback
        self._listener = TransformListener(node)
        self._source = node.settings.command.source
        self._frames = clamp_frames(node.settings)
        self._last, self._now = 0, 0
        if self._source == "tf" and not self._listener.available:
            raise ParameterError("command.source is 'tf', but the package tf2_msgs is missing")
        if self._source == "pose":
            for topic in POSES.values():
                node.subscribe(topic, partial(self._on_pose, topic), qos.DEEP, drain=True)
        node.every(PERIOD, self._proceed)
        node.every(POLL, self._look)

    def _on_pose(self, topic: str, message: Any) -> None:
        self._node.check_stamp(stamp_of(message), topic)
        self._listener.transforms.add_pose(topic, message)
        now = self._node.now()
        if now:
            self._listener.transforms.forget(now - KEPT)
        self._node.health.solved(topic)

    def _known(self) -> dict[str, Any]:
        """Frames of the ends that are held: of poses those that come, or are to come."""
        if self._source == "tf":
            return self._frames
        known = self._listener.transforms.parents
        return {
            end: each
            for end, each in self._frames.items()
            if each[0] in known or self._node.is_published(each[0])
        }

    def _proceed(self) -> None:
        """Send a command for the poses beyond the last one."""
        transforms, frames = self._listener.transforms, self._known()
        before_now, self._now = self._now, self._node.now()
        if self._now < before_now - JUMP_BACK * NANOSECONDS:
            transforms.forget()
            self._last = 0
        if not frames:
            return
        try:
            stamps = self._instants(frames, self._last)
        except InputError:
            return  # not all has come yet; `_look` reports where it stays so
        if not stamps and self._now and not self._last:  # all of it holds for good
            stamps = [self._now]
        new = [s for s in stamps if self._last < s <= latest(self._now)]  # of /tf, too
        if not new:
            return
        before = [s for s in stamps if s <= self._last][-1:]
        self._callback(command_of(transforms, frames, [*before, *new], self._node.settings))
        self._last = new[-1]
        self._node.health.count("commands")
        self._node.health.solved("command")

    def _instants(self, frames: dict[str, Any], since: int = 0) -> list[int]:
        """Stamps of the clamps' poses; one that was told once may be of a robot that begins."""
        node, settled = self._node, self._node.now() - LONGEST_SILENCE
        return instants(self._listener.transforms, frames, node.settings.frame_id, since, settled)

    def _look(self) -> None:
        """Report missing frames, and frames without new poses."""
        frames, node = self._known(), self._node
        if not frames:
            wanted = " and ".join(POSES.values())
            node.health.warn("command", f"command.source is 'pose', and nobody publishes {wanted}")
            return
        try:
            moving = self._instants(frames)
        except InputError as err:
            node.health.warn("command", f"command.source is '{self._source}': {err}")
            return
        now = node.now()
        if moving and moving[-1] > latest(now):
            node.health.warn(
                "command",
                f"the clamps' frames are stamped {(moving[-1] - now) / NANOSECONDS:.1f} s ahead of "
                "the clock, and not used; with a recording set use_sim_time and play it with "
                "/clock",
            )
            return
        silent = (now - self._last) / NANOSECONDS
        if now and moving and silent > SILENCE_TIMEOUT:
            node.health.warn(
                "command", f"the last pose of the clamps' frames came {silent:.1f} s ago"
            )
