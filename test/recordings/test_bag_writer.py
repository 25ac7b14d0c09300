# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Bags that are written: nothing half written, copies, replaced bags, types of others."""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
import recordings_samples as samples
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dlo_ros.errors import RecordingError
from dlo_ros.recordings import (
    BagWriter,
    copy_topics,
    open_bag,
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return samples.write_plain(tmp_path_factory.mktemp("bags") / "whole", samples.messages())


def test_writer_leaves_nothing_half_written(tmp_path):
    target = tmp_path / "out" / "bag"
    spline = samples.messages()[2]
    with pytest.raises(ValueError), BagWriter(target) as writer:
        writer.write("dlo/observed", samples.messages()[0][1], spline[2])
        raise ValueError
    assert list((tmp_path / "out").iterdir()) == []
    with pytest.raises(RecordingError, match="no message"), BagWriter(target):
        pass
    assert list((tmp_path / "out").iterdir()) == []
    with BagWriter(target) as writer:
        writer.write("dlo/command", samples.messages()[0][1], spline[2])
        writer.write_text("truth.yaml", "a: 1\n")
        assert not target.exists()
    assert sorted(p.name for p in target.iterdir()) == ["bag.mcap", "metadata.yaml", "truth.yaml"]
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["bag"]
    with open_bag(target) as bag:
        (connection,) = bag.connections
        assert connection.topic == "/dlo/command"
        # ros2 bag play offers what is noted here, so a late node still gets the command.
        (qos,) = connection.ext.offered_qos_profiles
        assert qos.durability.name == "TRANSIENT_LOCAL" and qos.reliability.name == "RELIABLE"


def test_writer_replaces_bags_only_and_only_when_forced(tmp_path):
    message = samples.messages()[0][1]

    def write(path: Path, stamp: int, force: bool) -> None:
        with BagWriter(path, force) as writer:
            writer.write("dlo/command", message, stamp)

    write(tmp_path / "bag", 1, force=False)
    with pytest.raises(RecordingError, match="--force"):
        write(tmp_path / "bag", 2, force=False)
    write(tmp_path / "bag", 3, force=True)
    with open_bag(tmp_path / "bag") as bag:
        assert (bag.start, bag.message_count) == (3, 1)
    (tmp_path / "bag" / "thesis.tex").write_text("years of work")
    other = tmp_path / "home"
    other.mkdir()
    for path in (tmp_path / "bag", other):
        with pytest.raises(RecordingError, match="is no bag"):
            write(path, 4, force=True)
    assert (tmp_path / "bag" / "thesis.tex").read_text() == "years of work"
    with pytest.raises(RecordingError, match="cannot be written"):
        write(tmp_path / "bag" / "thesis.tex" / "x", 5, force=False)


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_copy_keeps_bytes_and_times_and_leaves_out_what_is_excluded(tmp_path, plugin):
    source = samples.write_plain(tmp_path / "a", samples.messages(), plugin)
    with BagWriter(tmp_path / "b") as writer:
        lost = copy_topics(source, writer, exclude=["dlo/observed", "dlo/observed_points"])
        writer.write("dlo/observed", samples.messages()[2][1], samples.START)
    assert lost == ()
    with open_bag(source) as bag:
        kept = [m for m in bag.messages() if not m.topic.startswith("/dlo/observed")]
    with open_bag(tmp_path / "b") as bag:
        copied = [m for m in bag.messages() if not m.topic.startswith("/dlo/observed")]
        names = {c.topic for c in bag.connections}
    assert [m[:4] for m in copied] == [m[:4] for m in kept]
    assert names == {"/dlo/command", "/camera_info", "/image_raw", "/dlo/observed"}


def test_what_cannot_be_in_a_bag_is_refused(tmp_path):
    message = samples.messages()[0][1]
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RecordingError, match="is a link"), BagWriter(tmp_path / "link", True):
        pass
    with BagWriter(tmp_path / "bag") as writer:
        with pytest.raises(RecordingError, match="before the epoch"):
            writer.write("dlo/command", message, -1)
        for name in ("metadata.yaml", "../truth.yaml", "truth.txt"):
            with pytest.raises(RecordingError, match="only a YAML file can stand beside"):
                writer.write_text(name, "a: 1\n")
        writer.write("dlo/command", message, 1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bag", "elsewhere", "link"]


def test_an_old_bag_comes_back_where_the_new_one_cannot_take_its_place(tmp_path, monkeypatch):
    message, rename = samples.messages()[0][1], Path.rename

    def refused(path, target):
        if target == tmp_path / "bag" and path.name == "bag":
            raise OSError(5, "Input/output error")
        return rename(path, target)

    with BagWriter(tmp_path / "bag") as writer:
        writer.write("dlo/command", message, 1)
    with pytest.raises(RecordingError, match="cannot be written"), monkeypatch.context() as patch:
        patch.setattr(Path, "rename", refused)
        with BagWriter(tmp_path / "bag", force=True) as writer:
            writer.write("dlo/command", message, 2)
    with open_bag(tmp_path / "bag") as bag:
        assert bag.start == 1
    assert [p.name for p in tmp_path.iterdir()] == ["bag"]


GAUGE = "float64 force\nstring name\n"
DEFINITIONS = {
    "msg": ("ros2msg", GAUGE),
    "idl": (
        "ros2idl",
        "module lab { module msg { struct Gauge { double force; string name; }; }; };\n",
    ),
    "nonsense": ("ros2msg", "float64[ force\n"),
    "none": None,
}


@pytest.mark.parametrize("kind", DEFINITIONS)
def test_types_of_others_are_copied_where_an_old_bag_defines_them(kind, tmp_path, caplog):
    """Older recorders note no hash of a type; it is computed from the definition then."""
    store, name = get_typestore(Stores.EMPTY), "lab/msg/Gauge"
    store.register(get_types_from_msg(GAUGE, name))
    data = bytes(store.serialize_cdr(store.types[name](force=1.5, name="left"), name))
    with Writer(tmp_path / "a", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        gauge = writer.add_connection("/gauge", name, typestore=store)
        writer.write(gauge, 2, data)
    (hash_line,) = re.findall(r"\s+RIHS01_\w+", (tmp_path / "a" / "metadata.yaml").read_text())
    metadata = (tmp_path / "a" / "metadata.yaml").read_text().replace(hash_line, " ''")
    (tmp_path / "a" / "metadata.yaml").write_text(metadata)
    with closing(sqlite3.connect(tmp_path / "a" / "a.db3")) as database, database:
        database.execute("UPDATE topics SET type_description_hash = ''")
        if DEFINITIONS[kind] is None:
            database.execute("DELETE FROM message_definitions")
        else:
            change = "UPDATE message_definitions SET encoding = ?, encoded_message_definition = ?"
            database.execute(change, DEFINITIONS[kind])
    with BagWriter(tmp_path / "b") as writer:
        lost = copy_topics(tmp_path / "a", writer)
        writer.write("dlo/command", samples.messages()[0][1], 3)
    with open_bag(tmp_path / "b") as bag:
        copies = [m for m in bag.messages() if m.topic == "/gauge"]
        kept = {c.topic: c.digest for c in bag.connections}
    if kind in ("msg", "idl"):
        assert lost == () and [bytes(m.data) for m in copies] == [data]
        assert kept["/gauge"] == hash_line.strip()
    else:
        assert lost == ("/gauge",) and "/gauge is not copied" in caplog.text
        assert list(kept) == ["/dlo/command"]
