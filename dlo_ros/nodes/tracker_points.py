# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Input of the observer from another tracker's points (`dlo/points`)."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from dlo_ros.command import NANOSECONDS, Motion
from dlo_ros.errors import InputError, VisionError
from dlo_ros.nodes import qos
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.nodes.transform_listener import TransformListener
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.messages import stamp_of
from dlo_ros.recordings.point_lists import points_on_board
from dlo_ros.recordings.transforms import Transforms, same_frame
from dlo_ros.vision.points.point_observer import PointObserver


class TrackerPointsListener:
    """Observes the DLO in each list of points.

    Args:
        node: node that subscribes.
        motion: the imposed motion, as it is known so far.
        publish: function that is called with each observation; it returns whether it could be
            published.
        has_images: function that returns whether the DLO is seen in images, which come first.
    """

    def __init__(
        self,
        node: DloNode,
        motion: Motion,
        publish: Callable[[Observation], bool],
        has_images: Callable[[], bool],
    ) -> None:
        self._node, self._motion, self._publish = node, motion, publish
        self._has_images = has_images
        self._listener: TransformListener | None = None
        self._settings: Settings | None = None
        self._observer: PointObserver | None = None
        node.subscribe(topics.POINTS, self._on_points, qos.SENSOR)

    def reset(self) -> None:
        """Forget the last shape."""
        if self._observer is not None:
            self._observer.reset()

    def _on_points(self, message: Any) -> None:
        node = self._node
        if not node.ready:
            node.health.count("points before the node was ready")
            return
        stamp = stamp_of(message)
        node.check_stamp(stamp, topics.POINTS)
        if node.is_earlier(stamp):
            return
        node.health.count("lists of points")
        if self._has_images():
            node.health.warn(
                topics.POINTS,
                f"{topics.POINTS} is not used while the DLO is seen in images; to have the points' "
                f"shapes, give the images another name (-r {topics.IMAGE}:=unused "
                "-p image_transport:=raw)",
            )
            return
        began = time.perf_counter()
        settings = node.settings
        if self._observer is None or settings != self._settings:
            self._observer, self._settings = PointObserver(settings, self._motion), settings
        try:
            seen = points_on_board(message, settings, self._transforms(message))
        except InputError as err:
            known = self._listener is None or self._listener.available
            missing = "" if known else " (tf2_msgs is not installed)"
            node.health.warn(topics.POINTS, f"{err}{missing}")
            return
        try:
            result = self._observer.observe(seen)
        except VisionError as err:
            node.health.warn(topics.POINTS, f"no DLO found in {topics.POINTS}: {err}")
            return
        if not self._publish(result.observation):
            return
        node.health.solved(topics.POINTS)
        node.health.values.update(
            {
                "points [mm]": 1000.0 * result.std,
                "points beside the DLO [%]": 100.0 * result.outliers,
                "seen [%]": 100.0 * result.fraction_seen,
                "length seen [m]": result.seen_length,
                "tracked": result.tracked,
                "processing time [ms]": 1000.0 * (time.perf_counter() - began),
                "latency [ms]": 1000.0 * (node.now() - stamp) / NANOSECONDS,
            }
        )

    def _transforms(self, message: Any) -> Transforms:
        """Received transforms; they are subscribed to from the first list in another frame on."""
        foreign = not same_frame(str(message.header.frame_id), self._node.settings.frame_id)
        if self._listener is None and foreign:
            self._listener = TransformListener(self._node)
        return Transforms() if self._listener is None else self._listener.transforms
