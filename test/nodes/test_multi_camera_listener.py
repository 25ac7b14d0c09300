# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The node's images of several cameras, and of one with depth, without processes."""

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from dlo_ros.command import Motion
from dlo_ros.errors import InputError, VisionError
from dlo_ros.parameters import Settings
from dlo_ros.recordings.image_building import camera_info_message, depth_message, image_message
from dlo_ros.recordings.images import CameraInfo, read_camera_info
from dlo_ros.recordings.message_building import BAG_MESSAGES

ROD = {"rod.length": 0.4, "rod.diameter": 0.004, "rod.young_modulus": 1e6, "rod.density": 1e3}
POSE = {"translation": [0.0, 0.0, 1.2], "rotation": [2**-0.5, 0.0, 0.0, 2**-0.5]}
BOTH = {f"camera_{n}.{k}": v for n in ("left", "right") for k, v in POSE.items()}
INFO = CameraInfo(64, 48, "plumb_bob", (0.0,) * 5, (90.0, 0, 31.5, 0, 90.0, 23.5, 0, 0, 1.0), "eye")
MS = 1_000_000


class FakeNode:
    """What a listener needs of a node; messages are delivered by hand."""

    ready = True

    def __init__(self, **values):
        self.settings = Settings.from_mapping({**ROD, **values})
        self.published, self.topics, self.warnings = {"dlo/command"}, {}, []
        self.counts, self.queues, self.frames = Counter(), {}, []
        self.health = SimpleNamespace(
            values={}, solved=lambda what: None, warn=lambda what, text: self.warnings.append(text),
            count=lambda what: self.counts.update([what]),
        )  # fmt: skip

    def subscribe(self, topic, callback, qos):
        self.topics[topic] = callback
        return topic

    def waiting(self, topic):
        """Messages that the test has put there, as the middleware would keep them."""
        queue = self.queues.get(topic, [])
        while queue:
            yield queue.pop(0)

    def destroy_subscription(self, topic):
        del self.topics[topic]

    def publisher(self, topic, qos):
        sent = []
        return SimpleNamespace(sent=sent, publish=sent.append, get_subscription_count=lambda: 1)

    def is_published(self, topic):
        return topic in self.published

    def is_earlier(self, stamp):
        return False

    def check_stamp(self, stamp, what):
        pass

    def now(self):
        return 0

    def guarded(self, what, callback):
        return callback


class FakeObserver:
    """Takes frames down, and finds nothing."""

    def __init__(self, settings, cameras, motion):
        self.cameras, self.seen, self.masks = cameras, [], []
        self.hints = SimpleNamespace(mask=None)

    def observe(self, frames):
        self.seen.append(frames)
        self.masks.append(self.hints.mask)
        raise VisionError("the views do not show one DLO")

    def reset(self):
        pass


@pytest.fixture
def listener(monkeypatch):
    views = pytest.importorskip("dlo_ros.nodes.multi_camera_listener")
    monkeypatch.setattr(views, "SpaceObserver", FakeObserver)

    def make(**values):
        node = FakeNode(**values)
        motion = Motion()
        motion.commands.append(None)

        def seen_by(*frame_and_name):
            node.frames.append(frame_and_name)

        return node, views.MultiCameraListener(
            node, motion, lambda result: None, lambda stamp: None, seen_by
        )

    return make


def image(stamp):
    return image_message(BAG_MESSAGES, stamp, "eye", np.zeros((48, 64, 3), dtype=np.uint8))


def info(stamp=0):
    return camera_info_message(BAG_MESSAGES, stamp, INFO)


def test_images_of_two_cameras_go_to_the_observer_in_pairs(listener):
    node, views = listener(**{"vision.cameras": ["left", "right"]}, **BOTH)
    node.published |= {"left/image_raw", "right/image_raw/compressed"}
    views.poll()
    assert {"left/image_raw", "right/image_raw/compressed"} <= set(node.topics)
    node.published.add("right/image_raw")
    node.published.discard("right/image_raw/compressed")
    views.poll()
    assert "right/image_raw" in node.topics and "right/image_raw/compressed" not in node.topics
    node.topics["left/image_raw"](image(100 * MS))
    node.topics["right/image_raw"](image(103 * MS))
    assert any("right/camera_info" in text for text in node.warnings)
    for name in ("left", "right"):
        node.topics[f"{name}/camera_info"](info())
    assert node.frames == [("eye", "left"), ("eye", "right")]
    node.topics["left/image_raw"](image(133 * MS))
    node.topics["right/image_raw"](image(136 * MS))
    (frames,) = views._observer.seen
    assert {n: f.stamp for n, f in frames.items()} == {"left": 133 * MS, "right": 136 * MS}
    assert node.health.values["stamps apart [ms]"] == 3.0
    assert node.health.values["last image"] == "the views do not show one DLO"
    assert all(len(views._overlays[name].sent) == 2 - 1 for name in ("left", "right"))


def test_depth_joins_the_images_of_the_one_camera(listener):
    node, views = listener()
    assert not views.has_depth
    depth = depth_message(BAG_MESSAGES, 50 * MS, "eye", np.full((48, 64), 1200, dtype=np.uint16))
    node.topics["depth/image_raw"](depth)
    assert views.has_depth
    overlay = node.publisher("dlo/overlay", None)
    views.take(image(50 * MS), read_camera_info(info()), overlay)
    (frames,) = views._observer.seen
    assert frames[""].depth[0, 0] == pytest.approx(1.2)
    assert len(overlay.sent) == 1
    off, _ = listener(**{"vision.depth": "off"})
    assert not off.topics


def test_images_wait_for_the_command(listener):
    node, views = listener(**{"vision.cameras": ["left", "right"]}, **BOTH)
    views.poll()
    for name in ("left", "right"):
        node.topics[f"{name}/camera_info"](info())
    views._motion.commands.clear()
    for name in ("left", "right"):
        node.topics[f"{name}/image_raw"](image(MS))
    assert views._observer is None
    views._motion.commands.append(None)
    views.release()
    assert len(views._observer.seen) == 1


def test_images_wait_for_the_frames_of_their_instant_but_not_for_a_silent_robot(
    listener, monkeypatch
):
    views_module = pytest.importorskip("dlo_ros.nodes.multi_camera_listener")
    frames = {"command.source": "tf", "command.start_frame": "gripper"}
    node, views = listener(**{"vision.cameras": ["left", "right"]}, **BOTH, **frames)
    clock = [100.0]
    monkeypatch.setattr(views_module.time, "monotonic", lambda: clock[0])
    views.poll()

    def show(stamp):
        for name in ("left", "right"):
            node.topics[f"{name}/image_raw"](image(stamp))

    for name in ("left", "right"):
        node.topics[f"{name}/camera_info"](info())
    views._motion.commands[:] = [SimpleNamespace(end_stamp=50 * MS)]
    show(40 * MS)
    assert len(views._observer.seen) == 1  # told already
    show(60 * MS)
    assert len(views._observer.seen) == 1
    views._motion.commands.append(SimpleNamespace(end_stamp=70 * MS))
    views.release()
    assert len(views._observer.seen) == 2
    show(90 * MS)
    clock[0] += views_module.PATIENCE + 0.01
    views.poll()
    assert len(views._observer.seen) == 3  # the robot is silent
    show(120 * MS)
    assert len(views._observer.seen) == 4  # and keeps no more images waiting


def test_sets_that_were_lost_are_counted(listener):
    node, views = listener(**{"vision.cameras": ["left", "right"]}, **BOTH)
    views.poll()
    lost = {20, 21, 30}
    for k in sorted(set(range(40)) - lost):
        for name in ("left", "right"):
            node.topics[f"{name}/image_raw"](image((1000 + 33 * k) * MS))
    assert node.health.values["dropped images"] == len(lost)
    assert node.health.values["camera [Hz]"] == pytest.approx(1000.0 / 33.0)
    views.reset()
    for name in ("left", "right"):  # time went back: nothing was lost
        node.topics[f"{name}/image_raw"](image(1000 * MS))
    assert node.health.values["dropped images"] == len(lost)


def shown(node, views, first, right_later):
    """Play ten pairs of images; the instants that went to the observer."""
    for k in range(10):
        pair = [("left", first + 33 * k), ("right", first + 33 * k + right_later)]
        for name, stamp in sorted(pair, key=lambda each: each[1]):
            node.topics[f"{name}/image_raw"](image(stamp * MS))
    return [frames["left"].stamp // MS - first for frames in views._observer.seen]


@pytest.mark.parametrize("clock", [True, False])
@pytest.mark.parametrize("right_later", [-5, 0, 5])
def test_a_recording_that_begins_again_is_observed_again(listener, clock, right_later):
    """Whether or not a clock says so; images of the first pass without partner are left over."""
    from dlo_ros.nodes.observer import ObserverNode

    node, views = listener(**{"vision.cameras": ["left", "right"]}, **BOTH)
    views.poll()
    for name in ("left", "right"):
        node.topics[f"{name}/camera_info"](info())
    first = shown(node, views, 100_000, right_later)
    assert len(first) >= 9
    views._observer.seen.clear()
    if clock:
        whole = SimpleNamespace(_held=[], _last_stamp=0, _views=views, reset=views.reset)
        ObserverNode.restart(whole, 90_000 * MS)
    assert shown(node, views, 90_000, right_later) == first


def test_a_mask_holds_for_the_camera_with_depth_and_not_for_several(listener):
    from dlo_ros.nodes.observer import ObserverNode

    node, views = listener()
    whole = SimpleNamespace(_views=views, _observer=None, health=node.health, _mask=None)
    overlay = node.publisher("dlo/overlay", None)
    mask = np.zeros((48, 64), np.uint8)
    mask[:, :20] = 255
    for stamp in (50 * MS, 90 * MS):
        depth = depth_message(BAG_MESSAGES, stamp, "eye", np.full((48, 64), 900, np.uint16))
        node.topics["depth/image_raw"](depth)
        views.take(image(stamp), read_camera_info(info()), overlay)
        ObserverNode._on_mask(whole, image_message(BAG_MESSAGES, stamp, "eye", mask))
    before, after = views._observer.masks
    assert before is None
    np.testing.assert_array_equal(after, mask > 0)
    _, whole._views = listener(**{"vision.cameras": ["left", "right"]}, **BOTH)
    with pytest.raises(InputError, match="image_mask is that of one camera"):
        ObserverNode._on_mask(whole, image_message(BAG_MESSAGES, 1, "eye", mask))


def test_depth_images_of_the_pass_before_are_dropped(listener):
    node, views = listener()
    overlay = node.publisher("dlo/overlay", None)
    for first in (100_000, 90_000):
        for k in range(5):
            stamp = (first + 33 * k) * MS
            far = depth_message(BAG_MESSAGES, stamp, "eye", np.full((48, 64), 900, np.uint16))
            node.topics["depth/image_raw"](far)
            if k < 4:
                views.take(image(stamp), read_camera_info(info()), overlay)
    stamps = [frames[""].stamp // MS for frames in views._observer.seen]
    assert stamps == [f + 33 * k for f in (100_000, 90_000) for k in range(4)]


def test_images_that_came_while_others_were_worked_on_are_all_taken_in_order(listener):
    node, views = listener(**{"vision.cameras": ["left", "right"]}, **BOTH)
    views.poll()
    for name in ("left", "right"):
        node.topics[f"{name}/camera_info"](info())
    stamps = [(1000 + 33 * k) * MS for k in range(12)]
    node.queues["left/image_raw"] = [image(stamp) for stamp in stamps[1:]]
    node.queues["right/image_raw"] = [image(stamp) for stamp in stamps]
    node.topics["left/image_raw"](image(stamps[0]))
    assert [frames["left"].stamp for frames in views._observer.seen] == stamps
    assert not any(node.queues.values()) and node.health.values["dropped images"] == 0


def test_a_damaged_image_costs_its_own_set_only(listener):
    node, views = listener(**{"vision.cameras": ["left", "right"]}, **BOTH)
    views.poll()
    for name in ("left", "right"):
        node.topics[f"{name}/camera_info"](info())

    def guarded(what, callback):
        def call(*arguments):
            try:
                callback(*arguments)
            except InputError as err:
                node.warnings.append(str(err))

        return call

    node.guarded = guarded
    images = [image((1000 + 33 * k) * MS) for k in range(3)]
    images[1].data = images[1].data[:-1]
    node.queues["left/image_raw"] = images[1:]
    node.queues["right/image_raw"] = [image((1000 + 33 * k) * MS) for k in range(3)]
    node.topics["left/image_raw"](images[0])
    assert [frames["left"].stamp // MS for frames in views._observer.seen] == [1000, 1066]
    assert sum("9215 bytes" in text for text in node.warnings) == 1
