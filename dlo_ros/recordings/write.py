# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Writing a rosbag2 folder (mcap) that appears whole or not at all."""

from __future__ import annotations

import logging
import shutil
import sys
import tempfile
from collections.abc import Collection
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.interfaces import (
    Connection,
    MessageDefinitionFormat,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from dlo_ros.errors import RecordingError
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import TYPESTORE, brief, open_bag

if sys.version_info >= (3, 14):  # as rosbags does, which brings it
    from compression import zstd
else:
    from backports import zstd

LOG = logging.getLogger(__name__)

STORED_SUFFIXES = (".mcap", ".db3", ".db3-shm", ".db3-wal", ".zstd", ".yaml")
"""What a bag's folder consists of; a folder with anything else is never replaced."""


class BagWriter:
    """Writes a bag; a context manager.

    It is written under a temporary name beside the target and renamed at the end. Where the
    block is left by an exception nothing remains, and an older bag stays as it was.

    Args:
        path: folder of the bag.
        force: whether an existing bag is replaced.

    Raises:
        RecordingError: the target exists, is no bag, or cannot be written.
    """

    def __init__(self, path: Path | str, force: bool = False) -> None:
        self.path = Path(path)
        self._force = force
        self._connections: dict[tuple[str, str], Connection] = {}
        self._folder: Path | None = None
        self._writer: Writer | None = None

    def __enter__(self) -> BagWriter:
        self._check_target()
        parent = self.path.absolute().parent
        try:
            parent.mkdir(parents=True, exist_ok=True)
            # The file inside is named after its folder, so the folder has its final name already.
            self._folder = Path(tempfile.mkdtemp(prefix=f".{self.path.name}.", dir=parent))
            self._writer = Writer(
                self._folder / self.path.name, version=9, storage_plugin=StoragePlugin.MCAP
            )
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
            _add_checksums(self._writer)
        except OSError as err:
            self._discard()
            raise RecordingError(f"{self.path}: cannot be written ({err.strerror})") from err
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._writer is not None
        try:
            if kind is None:
                if not any(self._writer.counts.values()):
                    raise RecordingError(f"{self.path}: is not written, it would hold no message")
                self._writer.close()
                self._publish()
            else:
                self._writer.abort()
        except OSError as err:
            raise RecordingError(f"{self.path}: cannot be written ({err.strerror})") from err
        finally:
            self._discard()

    def write(self, topic: str, message: Any, stamp: int) -> None:
        """Write a message made by `BAG_MESSAGES`.

        Args:
            topic: relative name as in the interface, or a full name.
            stamp: time at which the message was recorded [ns].
        """
        kind = str(message.__msgtype__)
        name = topic if topic.startswith("/") else f"/{topic}"
        connection = self._connections.get((name, kind))
        if connection is None:
            assert self._writer is not None
            connection = self._writer.add_connection(
                name, kind, typestore=TYPESTORE, offered_qos_profiles=[offered(name)]
            )
            self._connections[name, kind] = connection
        self._write(connection, stamp, TYPESTORE.serialize_cdr(message, kind))

    def write_text(self, name: str, text: str) -> None:
        """Put a YAML file beside the data, such as `truth.yaml`."""
        assert self._writer is not None
        if Path(name).name != name or not name.endswith(".yaml") or name == "metadata.yaml":
            raise RecordingError(f"{name}: only a YAML file can stand beside a bag's data")
        try:
            (self._writer.path / name).write_text(text)
        except OSError as err:
            raise RecordingError(f"{self.path}: cannot be written ({err.strerror})") from err

    def _write(self, connection: Connection, stamp: int, data: bytes | memoryview) -> None:
        assert self._writer is not None
        if stamp < 0:
            raise RecordingError(f"{self.path}: a message before the epoch cannot be written")
        try:
            self._writer.write(connection, stamp, data)
        except OSError as err:
            raise RecordingError(f"{self.path}: cannot be written ({err.strerror})") from err

    def _copy_connection(self, source: Connection) -> Connection | None:
        """A connection with the definition of the source's, None where its type is unknown."""
        key = (source.topic, source.msgtype)
        if key not in self._connections:
            definition = _definition(source)
            if definition is None:
                return None
            text, digest = definition
            qos = getattr(source.ext, "offered_qos_profiles", ())
            assert self._writer is not None
            self._connections[key] = self._writer.add_connection(
                source.topic,
                source.msgtype,
                msgdef=text,
                rihs01=digest,
                offered_qos_profiles=list(qos),
            )
        return self._connections[key]

    def _check_target(self) -> None:
        if self.path.is_symlink() or not self.path.exists():
            if self.path.is_symlink():
                raise RecordingError(f"{self.path}: is a link; give another name")
            return
        if not self._force:
            raise RecordingError(f"{self.path}: exists already; give another name or --force")
        if not is_bag_folder(self.path):
            raise RecordingError(
                f"{self.path}: is no bag, so it is not replaced; give another name"
            )

    def _publish(self) -> None:
        """Rename the finished bag to its place; an older one is moved aside first."""
        assert self._folder is not None
        self._check_target()
        old = self._folder / "old"
        if self.path.exists():
            self.path.rename(old)
        try:
            (self._folder / self.path.name).rename(self.path)
        except OSError:
            if old.exists():
                old.rename(self.path)
            raise

    def _discard(self) -> None:
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)


def copy_topics(
    source: Path | str, writer: BagWriter, exclude: Collection[str] = ()
) -> tuple[str, ...]:
    """Copy the messages of a bag as they are, bytes and times kept.

    Args:
        source: folder of the bag.
        writer: an open writer.
        exclude: relative names as in the interface, left out in every namespace.

    Returns:
        Names of topics that could not be copied since their type is unknown here.

    Raises:
        RecordingError: the source is damaged or the target cannot be written.
    """
    with open_bag(source) as bag:
        copies: dict[int, Connection] = {}
        lost: list[str] = []
        for connection in bag.connections:
            if any(topics.is_topic(connection.topic, topic) for topic in exclude):
                continue
            copy = writer._copy_connection(connection)
            if copy is None:
                LOG.warning(
                    "%s: %s is not copied, the bag does not define %s",
                    bag.path, connection.topic, connection.msgtype,
                )  # fmt: skip
                lost.append(connection.topic)
            else:
                copies[connection.id] = copy
        kept = [c for c in bag.connections if c.id in copies]
        for raw in bag.messages(kept):
            writer._write(copies[raw.connection.id], raw.stamp, raw.data)
    return tuple(lost)


def _add_checksums(writer: Writer) -> None:
    """Have each compressed chunk carry a checksum, so that a flipped bit is noticed.

    rosbags writes neither MCAP's own nor zstd's; every reader of zstd checks the latter.
    """
    storage = writer.storage
    flag = {int(zstd.CompressionParameter.checksum_flag): 1}
    assert storage is not None and hasattr(storage, "compressor")
    storage.compressor = partial(zstd.compress, options=flag)


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is a rosbag2 recording and holds nothing that is not part of one."""
    if not path.is_dir() or not (path / "metadata.yaml").is_file():
        return False
    with (path / "metadata.yaml").open("rb") as file:
        if b"rosbag2_bagfile_information" not in file.read(4096):
            return False
    return all(p.is_file() and p.name.endswith(STORED_SUFFIXES) for p in path.iterdir())


def offered(topic: str) -> Qos:
    """QoS that is noted for a topic, so that `ros2 bag play` offers it."""
    latched = topics.is_latched(topic)
    kept = topics.FIXED_TRANSFORMS if topic == topics.TRANSFORMS else 1
    zero = QosTime(0, 0)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=kept if latched else 10,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=zero,
        lifespan=zero,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=zero,
        avoid_ros_namespace_conventions=False,
    )


def _definition(connection: Connection) -> tuple[str, str] | None:
    """Text and hash of a message type, from the bag itself or from the Jazzy standard types."""
    text, kind = connection.msgdef.data, connection.msgtype
    known = text and connection.msgdef.format is not MessageDefinitionFormat.NONE
    if known and connection.digest:
        return text, connection.digest
    if kind in TYPESTORE.types:
        return TYPESTORE.generate_msgdef(kind, ros_version=2)[0], TYPESTORE.hash_rihs01(kind)
    if not known:
        return None
    try:
        store = get_typestore(Stores.EMPTY)
        if connection.msgdef.format is MessageDefinitionFormat.MSG:
            store.register(get_types_from_msg(text, kind))
        else:
            store.register(get_types_from_idl(text))
        return text, store.hash_rihs01(kind)
    except Exception as err:  # definitions that the parser does not know
        LOG.warning("definition of %s cannot be read (%s)", kind, brief(err))
        return None
