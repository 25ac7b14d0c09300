# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Input of the spatial observer: images of several cameras, or of one camera with depth."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from itertools import islice
from typing import Any

from dlo_ros.command import NANOSECONDS, Motion
from dlo_ros.errors import VisionError
from dlo_ros.nodes import qos
from dlo_ros.nodes.image_statistics import ImageStatistics
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.node_base import JUMP_BACK, DloNode
from dlo_ros.recordings import topics
from dlo_ros.recordings.camera_bags import DEPTH
from dlo_ros.recordings.image_building import image_message
from dlo_ros.recordings.images import CameraInfo, Image, read_camera_info, read_depth, read_image
from dlo_ros.recordings.messages import stamp_of
from dlo_ros.recordings.synchronisation import ApproximateTime
from dlo_ros.spline import FloatArray
from dlo_ros.vision.overlay import draw_overlay
from dlo_ros.vision.planar_result import VisionResult
from dlo_ros.vision.space import SpaceObserver
from dlo_ros.vision.space.spatial_observer import Frame
from dlo_ros.vision.space.view import cameras_of

PATIENCE = 0.5
"""Seconds that the first images wait for the command, where somebody publishes it, and any images
for the robot's frames of their instant."""

HELD = 15
"""Sets of images that may wait so, or while others are worked on: as many as come at 30 Hz within
that time. The oldest are dropped."""

AHEAD = 2
"""Sets that wait and are decoded at the same time: the one that is worked on next, and another
one meanwhile."""

DEPTH_FRESH = 1.0
"""Seconds for which a depth image keeps the camera's images waiting for the next one."""

Images = dict[str, tuple[int, Any]]


class ImageSet:
    """Images of one instant, decoded side by side before they are needed.

    Args:
        images: stamps [ns] and messages by the cameras' names, and those of depth.
    """

    def __init__(self, images: Images) -> None:
        self.images = images
        self._decoding: dict[str, Future[Image]] = {}

    @property
    def stamps(self) -> list[int]:
        """Stamps of the images [ns]."""
        return [stamp for stamp, _ in self.images.values()]

    def decode(self, pool: ThreadPoolExecutor) -> None:
        """Have the images decoded, where that is not done yet."""
        if not self._decoding:
            self._decoding = {
                name: pool.submit(read_image, message)
                for name, (_, message) in self.images.items()
                if name != DEPTH
            }

    def frames(self) -> dict[str, Frame]:
        """The decoded images by the cameras' names, once they are.

        Raises:
            InputError: an image is unusable.
        """
        depth = read_depth(self.images[DEPTH][1]) if DEPTH in self.images else None
        return {
            name: Frame(self.images[name][0], picture.result(), depth)
            for name, picture in self._decoding.items()
        }


def transport_of(node: DloNode, camera: str, chosen: str) -> tuple[str, str]:
    """Whether images of a camera come raw or compressed, and their topic; compressed if both.

    Args:
        node: node that subscribes; its settings may name the transport.
        camera: name of the camera; empty: the one camera.
        chosen: transport used so far, which is kept where neither is published; empty: none.
    """
    compressed = topics.of_camera(camera, topics.COMPRESSED)
    raw = topics.of_camera(camera, topics.IMAGE)
    wanted = node.settings.image_transport
    if wanted == "auto":
        if node.is_published(compressed):
            wanted = "compressed"
        elif node.is_published(raw) or not chosen:
            wanted = "raw"
        else:
            wanted = chosen
    return wanted, compressed if wanted == "compressed" else raw


class MultiCameraListener:
    """Observes the DLO in the images of each instant.

    Args:
        node: node that subscribes.
        motion: the imposed motion, as it is known so far.
        publish: function that is called with the observation of each instant.
        predicted: function that returns the predicted control points near a stamp [ns], or None.
        seen_by: function that is called with the frame and the name of a camera of several.
    """

    def __init__(
        self,
        node: DloNode,
        motion: Motion,
        publish: Callable[[VisionResult], None],
        predicted: Callable[[int], FloatArray | None],
        seen_by: Callable[[str, str], None],
    ) -> None:
        self._node, self._motion = node, motion
        self._publish, self._predicted, self._seen_by = publish, predicted, seen_by
        self.cameras = tuple(node.settings.cameras)
        self.mask: Image | None = None  # of the one camera that comes with depth
        self._infos: dict[str, CameraInfo] = {}
        self._observer: SpaceObserver | None = None
        self._together: ApproximateTime[Any] = ApproximateTime(self.cameras or ("", DEPTH))
        self._held: deque[ImageSet] = deque(maxlen=HELD)
        self._hold_until = 0.0
        self._front = 0.0  # when the first of those that wait came to the front
        self._silent_since = -1  # last stamp of the robot's frames [ns]
        self._last_stamps: dict[str, int] = {}  # [ns] by the cameras' names, and that of depth
        self._last_depth = -DEPTH_FRESH
        self._transports: dict[str, tuple[str, Any]] = {}
        self._overlays: dict[str, Any] = {}
        self._sets = ImageStatistics()  # of all images of an instant together
        self._decoders = ThreadPoolExecutor(max(1, len(self.cameras)), thread_name_prefix="decoder")
        for name in self.cameras:
            topic = topics.of_camera(name, topics.CAMERA_INFO)
            node.subscribe(topic, partial(self._on_info, name), qos.SENSOR)
            overlay = topics.of_camera(name, topics.OVERLAY)
            self._overlays[name] = node.publisher(overlay, qos.RELIABLE)
        if not self.cameras and node.settings.vision.depth == "auto":
            node.subscribe(topics.DEPTH, self._on_depth, qos.IMAGES)

    def reset(self) -> None:
        """Forget the last shape and the images that wait."""
        self._together.clear()
        self._held.clear()
        self._last_stamps.clear()
        self._sets.reset()
        if self._observer is not None:
            self._observer.reset()

    @property
    def last_stamp(self) -> int:
        """The latest stamp of an image that was taken [ns]; 0 before the first."""
        return max(self._last_stamps.values(), default=0)

    def build(self) -> None:
        """Apply changed settings from the next images on."""
        self._observer = None

    def poll(self) -> None:
        """Choose transports as they are published; process images that waited long enough."""
        for name in self.cameras:
            self._choose_transport(name)
        self.release()

    @property
    def has_depth(self) -> bool:
        """Whether depth images of the one camera come."""
        return time.monotonic() - self._last_depth < DEPTH_FRESH

    def take(self, message: Any, info: CameraInfo | None, overlay: Any) -> None:
        """An image of the one camera, which comes with depth."""
        self._overlays[""] = overlay
        if info is not None and self._infos.get("") != info:
            self._infos[""] = info
            self.build()
        self._on_image("", message)

    def _choose_transport(self, name: str) -> None:
        """Subscribe to raw or compressed images of a camera; compressed if both are published."""
        node = self._node
        chosen, subscription = self._transports.get(name, ("", None))
        wanted, topic = transport_of(node, name, chosen)
        if wanted == chosen:
            return
        if subscription is not None:
            node.destroy_subscription(subscription)
        made = node.subscribe(topic, partial(self._on_image, name), qos.IMAGES)
        self._transports[name] = wanted, made

    def _on_info(self, name: str, message: Any) -> None:
        info = read_camera_info(message)
        self._node.health.solved(topics.of_camera(name, topics.CAMERA_INFO))
        if self._infos.get(name) != info:
            self._infos[name] = info
            self.build()
            self._seen_by(info.frame_id, name)

    def _on_depth(self, message: Any) -> None:
        if self._node.ready and not self._node.is_earlier(stamp_of(message)):
            self._last_depth = time.monotonic()
            self._add(DEPTH, message)
            self.release()

    def _on_image(self, name: str, message: Any) -> None:
        self._take(name, message)
        # All that has come meanwhile is taken at once: the middleware keeps a few images only, and
        # what waits here is decoded while another set is worked on.
        for other, (_, subscription) in self._transports.items():
            take = self._node.guarded("image", partial(self._take, other))
            for waiting in self._node.waiting(subscription):
                take(waiting)
        self.release()

    def _take(self, name: str, message: Any) -> None:
        node = self._node
        if not node.ready:
            node.health.count("images before the node was ready")
            return
        if not node.is_earlier(stamp_of(message)):
            node.health.count("images")
            self._add(name, message)

    def _add(self, name: str, message: Any) -> None:
        stamp = stamp_of(message)
        self._node.check_stamp(stamp, "image")
        if stamp < self._last_stamps.get(name, stamp) - JUMP_BACK * NANOSECONDS:
            self.reset()  # a recording begins again; what waits of the pass before has no partner
        self._last_stamps[name] = stamp
        values = self._node.health.values
        for images in self._together.add(name, stamp, message):
            self._held.append(ImageSet(images))
            self._sets.arrived(min(s for s, _ in images.values()))
            values["camera [Hz]"] = self._sets.rate
            values["dropped images"] = self._sets.dropped
        values["images without partner"] = self._together.unmatched

    def release(self) -> None:
        """Process the images that wait, once the command has come or is overdue."""
        if self._held and not self._motion.commands and self._node.is_published(topics.COMMAND):
            now = time.monotonic()
            if not self._hold_until:
                self._hold_until = now + PATIENCE
            if now < self._hold_until:
                return
        while self._held and not self._early(max(self._held[0].stamps)):
            self._front = 0.0
            for images in islice(self._held, AHEAD):
                images.decode(self._decoders)
            self._node.guarded("image", self._see)(self._held.popleft())

    def _early(self, stamp: int) -> bool:
        """Whether a robot's frames may still bring the clamps' poses at a stamp [ns].

        A robot that is silent delays images only once.
        """
        commands = self._motion.commands
        if self._node.settings.command.source == "topic" or not commands:
            return False
        end = commands[-1].end_stamp
        if end >= stamp or end == self._silent_since:
            return False
        now = time.monotonic()
        self._front = self._front or now
        if now < self._front + PATIENCE:
            return True
        self._silent_since = end
        return False

    def _build(self) -> SpaceObserver | None:
        poses = self._node.settings.camera_poses
        missing = [name for name in poses if name not in self._infos]
        if missing:
            for name in missing:
                topic = topics.of_camera(name, topics.CAMERA_INFO)
                self._node.health.warn(topic, f"images come, but no usable {topic} yet")
            return None
        cameras = cameras_of(self._infos, poses)
        return SpaceObserver(self._node.settings, cameras, self._motion)

    def _see(self, images: ImageSet) -> None:
        began = time.perf_counter()
        node = self._node
        if self._observer is None:
            self._observer = self._build()
        observer = self._observer
        if observer is None:
            return
        observer.hints.mask = self.mask
        frames, stamps = images.frames(), images.stamps
        node.health.values["stamps apart [ms]"] = 1e3 * (max(stamps) - min(stamps)) / NANOSECONDS
        found: Mapping[str, VisionResult] = {}
        problem = ""
        try:
            result = observer.observe(frames)
            found = result.views
        except VisionError as err:
            problem = str(err)
            node.health.warn("image", f"no DLO found: {err}")
            node.health.values["last image"] = problem
        else:
            self._publish(next(iter(found.values())))
            node.health.solved("image")
            node.health.values["seen by several [%]"] = 100.0 * result.seen_by_several
            node.health.values["processing time [ms]"] = 1e3 * (time.perf_counter() - began)
            self._sets.worked_off((node.now() - min(stamps)) / NANOSECONDS)
            node.health.values["latency [ms]"] = 1e3 * self._sets.latency
        self._draw(observer, images.images, frames, found, problem)

    def _draw(
        self,
        observer: SpaceObserver,
        images: Images,
        frames: Mapping[str, Frame],
        found: Mapping[str, VisionResult],
        problem: str,
    ) -> None:
        for name, frame in frames.items():
            publisher = self._overlays[name]
            if not publisher.get_subscription_count():
                continue
            length = self._node.settings.rod.length
            picture = draw_overlay(
                frame.image, observer.cameras[name], length, found.get(name),
                self._predicted(frame.stamp), problem,
            )  # fmt: skip
            frame_id = str(images[name][1].header.frame_id)
            publisher.publish(image_message(ROS_MESSAGES, frame.stamp, frame_id, picture))
