# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Opening rosbag2 folders (sqlite3 or mcap, zstd or not) and finding topics in them."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import RecordingError
from dlo_ros.recordings import topics

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)


class RawMessage(NamedTuple):
    """A message as it lies in the bag.

    Args:
        topic: full topic name.
        type: message type such as `geometry_msgs/msg/PoseArray`.
        stamp: time at which the message was recorded [ns].
        data: CDR bytes.
        connection: connection of the reader.
    """

    topic: str
    type: str
    stamp: int
    data: bytes
    connection: Connection


class Bag:
    """An open bag; made by `open_bag`."""

    def __init__(self, path: Path, reader: Reader) -> None:
        self.path = path
        self._reader = reader
        self.connections: list[Connection] = list(reader.connections)

    @property
    def start(self) -> int:
        """Time at which the first message was recorded [ns]."""
        return self._reader.start_time

    @property
    def end(self) -> int:
        """Time at which the last message was recorded [ns]."""
        return self._reader.end_time - 1

    @property
    def message_count(self) -> int:
        """Number of messages according to the bag's index."""
        return self._reader.message_count

    def holds(self, topic: str) -> bool:
        """Whether there are messages of a topic, in whatever namespace."""
        return bool(self._called(topic))

    def find(self, topic: str, near: str = "") -> list[Connection]:
        """The connections of a topic, in whatever namespace; empty where the bag has none.

        Args:
            topic: relative name as in the interface.
            near: full name of a topic whose namespace is preferred (the image's for camera_info).

        Raises:
            RecordingError: several namespaces have it, or it is of another type.
        """
        found = self._called(topic)
        names = sorted({c.topic for c in found})
        sibling = near.removesuffix(topics.relative(near) or "") + topic
        preferred = next((n for n in (sibling, f"/{topic}") if n in names), None)
        if len(names) > 1 and preferred is None:
            raise RecordingError(
                f"{self.path}: several topics are called {topic} ({', '.join(names[:6])}); "
                "split the bag by namespace, one DLO a bag"
            )
        found = [c for c in found if preferred in (None, c.topic)]
        needed = topics.type_of(topic)
        wrong = next((c for c in found if c.msgtype != needed), None)
        if wrong is not None:
            raise RecordingError(
                f"{self.path}: {wrong.topic} is of type {wrong.msgtype}; {needed} is needed"
            )
        return found

    def _called(self, topic: str) -> list[Connection]:
        """The connections with messages of a topic, in all namespaces."""
        found = [c for c in self.connections if topics.is_topic(c.topic, topic) and c.msgcount]
        if topic in (topics.IMAGE, topics.COMPRESSED, topics.CAMERA_INFO):
            # A depth image is no picture, compressed or not, though its topic ends like one's.
            found = [c for c in found if not topics.is_topic(c.topic, f"depth/{topic}")]
        return found

    def ends(self, topic: str) -> dict[str, tuple[RawMessage, RawMessage]]:
        """First and last message of a topic in each namespace, without those between them.

        Raises:
            RecordingError: the file is damaged.
        """
        result = {}
        for name in dict.fromkeys(c.topic for c in self._called(topic)):
            own = [c for c in self.connections if c.topic == name]
            first, back = next(self.messages(own)), NANOSECONDS
            last: deque[RawMessage] = deque(maxlen=1)
            while not last:  # the index leads to a time, but to no last message of a topic
                last.extend(self.messages(own, since=max(self.start, self.end - back)))
                back *= 4
            result[name] = (first, last[0])
        return result

    def messages(
        self, connections: Collection[Connection] | None = None, since: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages in the order of recording.

        Args:
            connections: connections whose messages are read; default: all.
            since: time of recording from which on messages are read [ns]; default: all.

        Raises:
            RecordingError: the file is damaged, or holds fewer messages than its index says.
        """
        wanted = self.connections if connections is None else list(connections)
        if not wanted:
            return
        expected, found = 0 if since else sum(c.msgcount for c in wanted), 0
        iterator = self._reader.messages(wanted, start=since)
        while True:
            # A damaged file surfaces as whatever the parser meets first, so everything is caught;
            # what the consumer raises is not, since the loop is not around the yield.
            try:
                connection, stamp, data = next(iterator)
            except StopIteration:
                break
            except Exception as err:
                raise damaged(self.path, err) from err
            found += 1
            yield RawMessage(connection.topic, connection.msgtype, stamp, bytes(data), connection)
        if found < expected:
            raise RecordingError(
                f"{self.path}: holds {found} of the {expected} messages that its metadata counts; "
                "rebuild it with 'ros2 bag reindex' or record again"
            )


def deserialise(message: RawMessage) -> Any:
    """The message object of a raw message of a standard type.

    Raises:
        RecordingError: the bytes are no such message.
    """
    try:
        return TYPESTORE.deserialize_cdr(message.data, message.type)
    except Exception as err:  # the generated parsers raise many kinds on damaged bytes
        raise RecordingError(
            f"a message on {message.topic} cannot be decoded as {message.type} ({brief(err)})"
        ) from err


@contextmanager
def open_bag(path: Path | str) -> Iterator[Bag]:
    """Open a rosbag2 folder (or a single .mcap or .db3 file).

    Raises:
        RecordingError: there is no bag, it is damaged, or it is of a kind that cannot be read.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingError(f"{path}: no such bag; give the folder of a rosbag2 recording")
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        stored = any(p.suffix in (".mcap", ".db3") for p in path.iterdir())
        raise RecordingError(
            f"{path}: has no metadata.yaml; "
            + (
                "the recording was not finished, mend it with 'ros2 bag reindex'"
                if stored
                else "give the folder of a rosbag2 recording"
            )
        )
    if path.is_file() and path.suffix not in (".mcap", ".db3"):
        raise RecordingError(f"{path}: is no bag; give the folder of a rosbag2 recording")
    try:
        reader = Reader(path)
        reader.open()
    except Exception as err:
        raise damaged(path, err) from err
    try:
        _check_index(path, reader)
        yield Bag(path, reader)
    finally:
        with suppress(Exception):
            reader.close()


def _check_index(path: Path, reader: Reader) -> None:
    """Compare what metadata.yaml lists with what the files hold.

    A damaged name there would otherwise make a topic vanish without a word.

    Raises:
        RecordingError: they differ.
    """
    storages = getattr(reader.storage, "storages", None)
    if not storages:  # a single file, which is its own index
        return
    listed: Counter[str] = Counter()
    held: Counter[str] = Counter()
    for connection in reader.connections:
        listed[f"{connection.topic} ({connection.msgtype})"] += connection.msgcount
    for storage in storages:
        for connection in storage.connections:
            held[f"{connection.topic} ({connection.msgtype})"] += connection.msgcount
    wrong = next((name for name in listed | held if listed[name] != held[name]), None)
    if wrong is not None:
        raise RecordingError(
            f"{path}: holds {held[wrong]} of the {listed[wrong]} messages that its metadata counts "
            f"of {wrong[:120]}; rebuild it with 'ros2 bag reindex' or record again"
        )


def damaged(path: Path, err: Exception) -> RecordingError:
    """The error for a file that could not be parsed, as a message for people."""
    if isinstance(err, PermissionError):
        return RecordingError(f"{path}: cannot be read (permission denied)")
    return RecordingError(
        f"{path}: is damaged or cut short ({brief(err)}); copy or record it again, "
        "or try 'ros2 bag reindex'"
    )


def brief(err: BaseException) -> str:
    """First line of an error's text, bounded."""
    text = " ".join(str(err).split())
    return (text or type(err).__name__)[:200]
