# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Schedule of a bag's messages on live topics (no ROS here)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rosbags.interfaces import Connection

from dlo_ros.errors import RecordingError
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import Bag, RawMessage, open_bag


@dataclass(frozen=True)
class ScheduledMessage:
    """A message and the time of its publication.

    Args:
        after: seconds of wall time after the start of the playback.
        message: the message as it stands in the bag.
    """

    after: float
    message: RawMessage


@dataclass(frozen=True)
class Playlist:
    """The messages of a bag that are played, and their speed.

    Args:
        path: the bag.
        topics: full name and message type of each topic that is played.
        latched: topics whose last message holds until the next, such as a command.
        start, end: times of recording between which it is played [ns].
        rate: seconds of the recording per second of wall time.
    """

    path: Path
    topics: tuple[tuple[str, str], ...]
    latched: frozenset[str]
    start: int
    end: int
    rate: float

    @property
    def duration(self) -> float:
        """Wall time that one pass takes [s]."""
        return (self.end - self.start) / 1e9 / self.rate

    def time_at(self, after: float) -> int:
        """Time of the recording [ns] `after` seconds of wall time."""
        return self.start + round(after * self.rate * 1e9)

    def messages(self) -> Iterator[ScheduledMessage]:
        """The messages in the order of recording.

        What was recorded before `start` on a latched topic (a command that still holds) is due at
        once: the last message of each such topic, and all transforms that hold for good.

        Raises:
            RecordingError: the bag is damaged.
        """
        names = {name for name, _ in self.topics}
        with open_bag(self.path) as bag:
            chosen = [c for c in bag.connections if c.topic in names]
            held: dict[str, list[RawMessage]] = {}
            for message in bag.messages(chosen):
                if message.stamp < self.start:
                    if message.topic in self.latched:
                        if message.topic != topics.TRANSFORMS:
                            held.pop(message.topic, None)
                        # One publisher's fixed transforms replace no other's.
                        held.setdefault(message.topic, []).append(message)
                    continue
                yield from _at_once(held)
                held.clear()
                yield ScheduledMessage((message.stamp - self.start) / 1e9 / self.rate, message)
            yield from _at_once(held)


def _at_once(held: Mapping[str, Sequence[RawMessage]]) -> Iterator[ScheduledMessage]:
    """Messages by topic, due at the start of the playback."""
    for messages in held.values():
        yield from (ScheduledMessage(0.0, message) for message in messages)


def plan(
    path: Path | str,
    *,
    rate: float = 1.0,
    start_offset: float = 0.0,
    selection: Collection[str] = (),
    images: bool = True,
    playable: Callable[[str], bool] = lambda kind: True,
) -> Playlist:
    """Choose what of a bag is played.

    Args:
        rate: speed, 1 is that of the recording.
        start_offset: seconds of the recording that are left out at its start.
        selection: topics to play, with or without namespace; none given: all.
        images: whether images and camera_info are played, too.
        playable: whether a message type can be published here.

    Raises:
        RecordingError: no bag, nothing to play, or a number out of range.
    """
    if not 0.0 < rate <= 1000.0:
        raise RecordingError(f"--rate is {rate:g}; give a number above 0, up to 1000")
    with open_bag(path) as bag:
        chosen = _choose(bag, selection)
        if selection:
            unknown = [c for c in chosen if not playable(c[1])]
            if unknown:
                raise RecordingError(
                    f"{path}: {unknown[0][0]} is of type {unknown[0][1]}, which is not installed"
                )
        chosen = [
            c for c in chosen if playable(c[1]) and (images or c[1] not in topics.CAMERA_TYPES)
        ]
        if not chosen:
            raise RecordingError(f"{path}: holds nothing that can be played here")
        start, end = bag.start, bag.end
        length = (end - start) / 1e9
        if not 0.0 <= start_offset <= length:
            raise RecordingError(
                f"--start-offset is {start_offset:g} s; the bag is {length:.3f} s long"
            )
        return Playlist(
            path=Path(path),
            topics=tuple(chosen),
            latched=frozenset(c.topic for c in bag.connections if _is_latched(c)),
            start=start + round(start_offset * 1e9),
            end=end,
            rate=rate,
        )


def _choose(bag: Bag, selection: Collection[str]) -> list[tuple[str, str]]:
    held = sorted({(c.topic, c.msgtype) for c in bag.connections if c.msgcount})
    doubled = next((a for a, b in itertools.pairwise(held) if a[0] == b[0]), None)
    if doubled:
        raise RecordingError(f"{bag.path}: {doubled[0]} has messages of two types")
    if not selection:
        return [pair for pair in held if not pair[0].endswith(topics.STATE)]
    for wanted in selection:
        if not any(topics.is_topic(name, wanted.lstrip("/")) for name, _ in held):
            names = ", ".join(name for name, _ in held[:12])
            raise RecordingError(f"{bag.path}: has no topic {wanted[:80]}; it has {names}")
    return [
        pair
        for pair in held
        if any(topics.is_topic(pair[0], wanted.lstrip("/")) for wanted in selection)
    ]


def _is_latched(connection: Connection) -> bool:
    if topics.is_latched(connection.topic):
        return True
    profiles = getattr(connection.ext, "offered_qos_profiles", [])
    return any(profile.durability.name == "TRANSIENT_LOCAL" for profile in profiles)
