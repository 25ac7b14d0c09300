# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measured forces and torques of the grips, from and to bags."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np

from dlo_ros.command import END, START, Command, Motion
from dlo_ros.errors import InputError
from dlo_ros.observation import Wrenches
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import Bag, deserialise
from dlo_ros.recordings.message_building import BAG_MESSAGES, wrench_message
from dlo_ros.recordings.messages import array, stamp_of
from dlo_ros.recordings.transforms import Transforms, same_frame, transforms_of
from dlo_ros.recordings.write import BagWriter
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

LARGEST = 1e6
"""Largest force [N] and torque [N m] that is taken: a sensor whose numbers are beyond is broken."""

TOPICS = {START: topics.WRENCH_START, END: topics.WRENCH_END}


def write_wrenches(writer: BagWriter, frame: str, measured: Wrenches) -> None:
    """Write what was measured at one end in the fixed frame."""
    for topic, message in wrench_messages(frame, measured):
        writer.write(topic, message, stamp_of(message))


def wrench_messages(frame_id: str, measured: Wrenches) -> list[tuple[str, Any]]:
    """Messages of a bag, with their topics, of forces measured at one end, in the fixed frame."""
    topic = TOPICS[measured.end]
    rows = zip(measured.stamps, measured.force, measured.torque, strict=True)
    return [(topic, wrench_message(BAG_MESSAGES, int(s), frame_id, f, t)) for s, f, t in rows]


def read_wrenches(bag: Bag, settings: Settings, commands: Sequence[Command]) -> list[Wrenches]:
    """Measured wrenches of the ends at which there are any.

    Those of the frame `frame_id` are about the end of the DLO; those of another frame, such as a
    sensor's, are about its origin and are moved to that end.

    Raises:
        InputError: their frame's pose is not known.
    """
    result, transforms = [], None
    for end, topic in TOPICS.items():
        rows: dict[int, FloatArray] = {}
        frames: set[str] = set()
        wrong = 0
        for raw in bag.messages(bag.find(topic)):
            try:
                message = deserialise(raw)
                stamp, values = stamp_of(message), wrench_of(message, topic)
            except InputError:
                wrong += 1
                continue
            if stamp in rows:
                wrong += 1
                continue
            rows[stamp] = values
            frames.add(str(message.header.frame_id))
        if wrong:
            LOG.warning(
                "%s: %d of %d messages on %s are left out: not finite, no forces, or a stamp that "
                "was there", bag.path, wrong, wrong + len(rows), topic,
            )  # fmt: skip
        if not rows:
            continue
        if len(frames) > 1:
            raise InputError(f"{bag.path}: {topic} is in several frames: {', '.join(frames)}")
        if transforms is None:
            transforms = transforms_of(bag)
        stamps = np.array(sorted(rows), dtype=np.int64)
        table = np.array([rows[int(s)] for s in stamps])
        try:
            result.append(
                in_fixed_frame(end, stamps, table, frames.pop(), settings, commands, transforms)
            )
        except InputError as err:
            raise InputError(f"{bag.path}: {topic}: {err}") from err
    return result


def wrench_of(message: Any, topic: str) -> FloatArray:
    """Force and torque of a geometry_msgs/WrenchStamped, shape (6,).

    Raises:
        InputError: names the topic; a number is not finite, or that of no force at a grip.
    """
    f, t = message.wrench.force, message.wrench.torque
    values = array([f.x, f.y, f.z, t.x, t.y, t.z], topic)
    if np.abs(values).max() > LARGEST:
        raise InputError(f"{topic} holds more than {LARGEST:g}; forces are in N, torques in N m")
    return values


def in_fixed_frame(
    end: str, stamps: np.ndarray, table: FloatArray, frame: str, settings: Settings,
    commands: Sequence[Command], transforms: Transforms,
) -> Wrenches:  # fmt: skip
    """Measured wrenches along the axes of `frame_id`, about the end of the DLO.

    Args:
        stamps: [ns], growing, shape (k,).
        table: forces and torques in a frame, shape (k, 6).
        frame: name of that frame.

    Raises:
        InputError: the frame's pose is not known.
    """
    force, torque = table[:, :3], table[:, 3:]
    axes = np.broadcast_to(np.eye(3), (len(stamps), 3, 3))
    if not same_frame(frame, settings.frame_id):
        at = [int(s) for s in stamps]
        axes, origins = transforms.lookup(frame, settings.frame_id, at)
        force, torque = (np.einsum("kij,kj->ki", axes, v) for v in (force, torque))
        lever = origins - held_at(end, at, settings, commands)
        torque = torque + np.cross(lever, force)
    return Wrenches(end, stamps, np.ascontiguousarray(force), np.ascontiguousarray(torque), axes)


def held_at(
    end: str, stamps: Sequence[int], settings: Settings, commands: Sequence[Command]
) -> FloatArray:
    """Commanded position of an end at stamps [ns], shape (k, 3) [m].

    Raises:
        InputError: no command holds it.
    """
    motion, places = Motion(list(commands)), []
    for stamp in stamps:
        command = motion.at(stamp)
        k = None if command is None else command.held(end, settings.rod.control_points)
        if command is None or k is None:
            raise InputError(f"no command holds the {end} of the DLO, where forces are measured")
        places.append(command.sample(stamp)[0][k])
    return np.array(places)
