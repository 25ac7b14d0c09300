# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The node `observer`: camera images, or another tracker's points, in; observed splines out."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from dlo_ros.command import NANOSECONDS, Command, Motion
from dlo_ros.errors import InputError, VisionError
from dlo_ros.nodes import qos
from dlo_ros.nodes.commands import CommandSubscription
from dlo_ros.nodes.image_statistics import ImageStatistics
from dlo_ros.nodes.markers import Markers
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.multi_camera_listener import MultiCameraListener, transport_of
from dlo_ros.nodes.node_base import JUMP_BACK, DloNode
from dlo_ros.nodes.runtime import run
from dlo_ros.nodes.tracker_points import TrackerPointsListener
from dlo_ros.nodes.transform_broadcaster import BoardTransform
from dlo_ros.observation import CentrelinePoints, Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.image_building import image_message
from dlo_ros.recordings.images import (
    CameraInfo,
    Image,
    read_camera_info,
    read_image,
    read_mask,
)
from dlo_ros.recordings.message_building import points_message, spline_message
from dlo_ros.recordings.messages import read_spline, stamp_of
from dlo_ros.spline import FloatArray
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.compile_vision import compile_kernels
from dlo_ros.vision.fit.control_point_count import enough_control_points, follows, misfit
from dlo_ros.vision.overlay import draw_overlay
from dlo_ros.vision.planar_observer import Observer
from dlo_ros.vision.planar_result import VisionResult
from dlo_ros.vision.predictions import Predictions
from dlo_ros.vision.segmentation.user_hints import Hints

POLL = 0.2
"""Seconds between two looks at which transport is published."""

PATIENCE = 0.5
"""Seconds of wall time that the first images wait for the command, where somebody publishes it.

Without it nobody knows which end of the DLO is the start.
"""

HELD_IMAGES = 10
"""Images that may wait so; the oldest are dropped."""

IMAGES_FRESH = 1.0
"""Seconds for which an image that showed the DLO keeps the points of another tracker out."""

JUDGED_EVERY = 5.0
"""Seconds between two looks at whether the splines have enough control points: 10 ms of work."""


class ObserverNode(DloNode):
    """Fits a spline to the DLO in every image that shows one credibly."""

    def __init__(self, **options: Any) -> None:
        super().__init__("observer", "observation", "images", **options)
        self._motion = Motion()
        self._info: CameraInfo | None = None
        self.check_settings(self.settings)
        self._observer: Observer | None = None
        self._predictions = Predictions()
        self._mask: Image | None = None
        self._last_stamp = 0
        self._frames = ImageStatistics()
        self._held: deque[Any] = deque(maxlen=HELD_IMAGES)
        self._hold_until = 0.0
        self._judge_at = 0.0
        self._found_at = -IMAGES_FRESH  # when the last image showed the DLO
        self._spline_publisher = self.publisher(topics.OBSERVED, qos.RELIABLE)
        self._points_publisher = self.publisher(topics.OBSERVED_POINTS, qos.RELIABLE)
        self._overlay_publisher = self.publisher(topics.OVERLAY, qos.RELIABLE)
        self._transform = BoardTransform(self)
        self._markers = Markers(self, "observed", (0.2, 0.9, 0.3))
        self._command_subscription = CommandSubscription(self, self._on_command)
        self._views = MultiCameraListener(
            self, self._motion, self._publish, self._predictions.at, self._transform.seen_by
        )
        if not self._views.cameras:
            self.subscribe(topics.CAMERA_INFO, self._on_camera_info, qos.SENSOR)
        self.subscribe(topics.MASK, self._on_mask, qos.SENSOR)
        self.subscribe(topics.PREDICTED, self._on_predicted, qos.RELIABLE)
        self._tracker = TrackerPointsListener(
            self, self._motion, self._publish_observation, self._has_images
        )
        self._transport = ""
        self._image_subscription: Any = None
        if self._views.cameras:
            self._views.poll()
        else:
            self._choose_transport()
            self.every(POLL, self._choose_transport)
        self.every(POLL, self._views.poll)
        self.every(POLL, self._release)
        images = " and ".join(
            topics.of_camera(name, topics.IMAGE) for name in self._views.cameras or ("",)
        )
        self.health.waiting(f"{images} and {topics.CAMERA_INFO}, or {topics.POINTS}")
        self.prepare(("vision",), compile_kernels)

    def begin(self) -> None:
        """Process the intrinsics that have arrived meanwhile."""
        self._build()

    def reset(self) -> None:
        """Forget the last shape; the next image is searched as a whole."""
        self._predictions.clear()
        self._last_stamp = 0
        self._frames.reset()
        if self._observer is not None:
            self._observer.reset()
        self._views.reset()
        self._tracker.reset()

    def restart(self, now: int) -> None:
        """Time went back: later shapes predict nothing, and images that wait are dropped."""
        self._held.clear()
        if max(self._last_stamp, self._views.last_stamp) > now + JUMP_BACK * NANOSECONDS:
            self.reset()

    def apply(self, settings: Settings) -> None:
        """Take a changed pose of the camera (and all else) over."""
        self._transform.update()
        self._views.build()
        self._build()

    def check_settings(self, settings: Settings) -> None:
        """Refuse image files that cannot be read, or that do not fit the camera's images, and a
        camera that lies in the board's plane.
        """
        hints = Hints(settings.vision)
        if self._info is not None:
            hints.check_size(self._info.width, self._info.height)
            _camera(self._info, settings).check_before_board()

    def _choose_transport(self) -> None:
        """Subscribe to raw or compressed images, whichever is published; compressed if both."""
        wanted, topic = transport_of(self, "", self._transport)
        if wanted == self._transport:
            return
        if self._image_subscription is not None:
            self.destroy_subscription(self._image_subscription)
        self._image_subscription = self.subscribe(topic, self._on_image, qos.IMAGES)
        self._transport = wanted
        self.health.values["image transport"] = wanted

    def _on_command(self, command: Command) -> None:
        self._motion.add(command.later(self.settings.command_delay))
        del self._motion.commands[:-500]
        self._release()
        self._views.release()

    def _on_predicted(self, message: Any) -> None:
        shape = read_spline(message, self.settings, topics.PREDICTED)
        self.health.solved(topics.PREDICTED)
        if not self.is_earlier(stamp_of(message)):
            self._predictions.add(stamp_of(message), shape)

    def _on_mask(self, message: Any) -> None:
        """It holds until the next one comes."""
        if self._views.cameras:
            raise InputError(
                f"{topics.MASK} is that of one camera; with vision.cameras it is not used"
            )
        self._mask = self._views.mask = read_mask(message)
        self.health.solved(topics.MASK)
        if self._observer is not None:
            self._observer.mask = self._mask

    def _on_camera_info(self, message: Any) -> None:
        info = read_camera_info(message)
        if info != self._info:
            _camera(info, self.settings)  # one that is refused replaces none that is good
        self.health.solved(topics.CAMERA_INFO)
        self.health.hardware_id = str(message.header.frame_id) or "camera"
        if info != self._info or self._observer is None:
            self._info = info
            self._build()
            self._transform.seen_by(info.frame_id)

    def _build(self) -> None:
        if self._info is None or not self.ready:
            return
        self._observer = None
        self._observer = Observer(self.settings, _camera(self._info, self.settings), self._motion)
        self._observer.mask = self._mask

    def _on_image(self, message: Any) -> None:
        if self._views.has_depth:
            self._views.take(message, self._info, self._overlay_publisher)
            return
        if not self.ready:
            self.health.count("images before the node was ready")
            return
        self.check_stamp(stamp_of(message), "image")
        if self.is_earlier(stamp_of(message)):
            return
        self.health.count("images")
        self._frames.arrived(stamp_of(message))
        self.health.values["camera [Hz]"] = self._frames.rate
        self.health.values["dropped images"] = self._frames.dropped
        if not self._motion.commands and self.is_published(topics.COMMAND):
            now = time.monotonic()
            if not self._hold_until:
                self._hold_until = now + PATIENCE
            if now < self._hold_until:
                self._held.append(message)
                return
        self._release()
        self._see(message)

    def _release(self) -> None:
        """Process the images that waited for a command, once it has come or is overdue."""
        if self._motion.commands or time.monotonic() >= self._hold_until:
            while self._held:
                self.guarded("image", self._see)(self._held.popleft())

    def _see(self, message: Any) -> None:
        began = time.perf_counter()
        stamp = stamp_of(message)
        if self._observer is None:
            self._build()  # or say what is wrong with the camera that is known
        if self._observer is None:
            self.health.warn(
                topics.CAMERA_INFO, f"images come, but no usable {topics.CAMERA_INFO} yet"
            )
            return
        if stamp < self._last_stamp - JUMP_BACK * NANOSECONDS:
            self.reset()
        self._last_stamp = stamp
        image = read_image(message)
        try:
            result = self._observer.observe(stamp, image, self._predictions.at(stamp))
        except VisionError as err:
            self.health.warn("image", f"no DLO found: {err}")
            self.health.values["last image"] = str(err)
            self._publish_overlay(stamp, message, image, None, str(err))
            return
        self._publish(result)
        self.health.solved("image")
        self.health.values["processing time [ms]"] = 1000.0 * (time.perf_counter() - began)
        self._frames.worked_off((self.now() - stamp) / NANOSECONDS)
        self.health.values["latency [ms]"] = 1000.0 * self._frames.latency
        self._publish_overlay(stamp, message, image, result)

    def _publish_observation(self, observation: Observation) -> bool:
        """Publish an observed spline and its points; whether both were valid."""
        stamp, frame = observation.stamp, self.settings.frame_id
        try:
            spline = spline_message(ROS_MESSAGES, stamp, frame, observation.control_points)
            points = (
                None
                if observation.points is None
                else points_message(ROS_MESSAGES, stamp, frame, observation.points)
            )
        except InputError as err:
            self.health.warn("image", f"fit not published: {err}")
            return False
        # The points go first, so that who wants both has them when the spline comes.
        if points is not None:
            self._points_publisher.publish(points)
        self._spline_publisher.publish(spline)
        self._markers.spline(stamp, observation.control_points)
        self.health.count("observed splines")
        self.health.running("observing")
        if time.monotonic() >= self._judge_at and observation.points is not None:
            self._judge_at = time.monotonic() + JUDGED_EVERY
            self._judge(observation.points, observation.control_points)
        return True

    def _has_images(self) -> bool:
        """Whether images show the DLO."""
        return time.monotonic() - self._found_at < IMAGES_FRESH

    def _publish(self, result: VisionResult) -> None:
        self._found_at = time.monotonic()
        if not self._publish_observation(result.observation):
            return
        self.health.values.update(
            {
                "seen [%]": 100.0 * result.fraction_seen,
                "residual [px]": float(result.residual_px),
                "residual [mm]": 1000.0 * float(result.residual),
                "length seen [m]": float(result.seen_length),
                "width [px]": float(result.width),
                "tracked": result.tracked,
                "last image": "found",
            }
        )

    def _judge(self, points: CentrelinePoints, control_points: FloatArray) -> None:
        """Report where the published splines have too few control points, and how many would do."""
        length, n = self.settings.rod.length, len(control_points)
        if follows(points, control_points, length):
            self.health.values["control points"] = f"{n} follow the DLO"
            return
        try:
            enough = f"{enough_control_points(points, length)} would do"
        except VisionError as err:
            enough = str(err)
        missed = 1000.0 * misfit(points, control_points, length)
        self.health.values["control points"] = f"{n} miss it by {missed:.2f} mm; {enough}"

    def _publish_overlay(
        self,
        stamp: int,
        message: Any,
        image: Image,
        result: VisionResult | None,
        problem: str = "",
    ) -> None:
        if self._observer is None or not self._overlay_publisher.get_subscription_count():
            return
        predicted = self._predictions.at(stamp)
        length = self.settings.rod.length
        picture = draw_overlay(image, self._observer.camera, length, result, predicted, problem)
        frame = str(message.header.frame_id)
        self._overlay_publisher.publish(image_message(ROS_MESSAGES, stamp, frame, picture))


def _camera(info: CameraInfo, settings: Settings) -> Camera:
    """The camera with these intrinsics, where the parameters say that it is."""
    return Camera.from_info(
        info.k, info.d, info.distortion_model, info.width, info.height, settings.camera
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the node until Ctrl-C; returns the exit status."""
    return run("observer", ObserverNode, arguments)
