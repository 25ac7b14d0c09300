# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Bags that are read: every storage, several cameras and DLOs, damaged and unusable ones."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import recordings_samples as samples
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from dlo_ros.errors import RecordingError
from dlo_ros.parameters import Settings
from dlo_ros.recordings import (
    BAG_MESSAGES,
    float_message,
    iterate_images,
    read_recording,
    spline_message,
)

ZSTD = CompressionFormat.ZSTD


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return samples.write_plain(tmp_path_factory.mktemp("bags") / "whole", samples.messages())


def without(*topics: str) -> list:
    return [item for item in samples.messages() if item[0] not in topics]


@pytest.mark.parametrize(
    ("plugin", "compression"),
    [
        (StoragePlugin.SQLITE3, None),
        (StoragePlugin.SQLITE3, (CompressionMode.FILE, ZSTD)),
        (StoragePlugin.SQLITE3, (CompressionMode.MESSAGE, ZSTD)),
        (StoragePlugin.MCAP, None),
        (StoragePlugin.MCAP, (CompressionMode.STORAGE, ZSTD)),
        (StoragePlugin.MCAP, (CompressionMode.FILE, ZSTD)),
    ],
)
def test_round_trip_of_every_storage(tmp_path, plugin, compression):
    path = samples.write_plain(tmp_path / "bag", samples.messages(), plugin, compression)
    recording = read_recording(path, samples.SETTINGS)
    assert recording.name == "bag" and recording.has_images and recording.skipped == ()
    (command,) = recording.commands
    expected = samples.command()
    assert command.names == expected.names and command.stamp == expected.stamp
    for field in ("times", "positions", "rotations", "velocities"):
        np.testing.assert_allclose(getattr(command, field), getattr(expected, field), atol=1e-9)
    assert [o.stamp for o in recording.observations] == [
        samples.START + i * samples.STEP for i in range(4)
    ]
    for i, observation in enumerate(recording.observations):
        # The twist passes pi along u and grows in time: both unwrapped.
        np.testing.assert_allclose(
            observation.control_points, samples.control_points(i), atol=1e-12
        )
        assert (observation.points is not None) == (i % 2 == 0)
    points, truth = recording.observations[2].points, samples.centreline(2)
    np.testing.assert_allclose(points.positions, truth.positions, atol=1e-7)
    np.testing.assert_allclose(points.u, truth.u, atol=1e-7)
    np.testing.assert_allclose(points.std, truth.std, rtol=1e-6)
    images = list(iterate_images(path))
    assert len(images) == 4
    for i, (stamp, picture, info) in enumerate(images):
        assert stamp == samples.START + i * samples.STEP and info == samples.INFO
        np.testing.assert_array_equal(picture, samples.picture(i))


def test_bag_in_a_namespace(tmp_path):
    items = [(f"/left{topic}", message, t) for topic, message, t in samples.messages()]
    recording = read_recording(samples.write_plain(tmp_path / "bag", items), samples.SETTINGS)
    assert len(recording.commands) == 1 and len(recording.observations) == 4


def test_two_dlos_in_one_bag_are_named(tmp_path):
    items = [
        (f"/{side}{topic}", message, t)
        for topic, message, t in samples.messages()
        for side in ("left", "right")
    ]
    path = samples.write_plain(tmp_path / "bag", items)
    with pytest.raises(RecordingError, match=r"/left/dlo/command, /right/dlo/command"):
        read_recording(path, samples.SETTINGS)


def test_several_cameras_do_not_matter_to_who_wants_splines(tmp_path):
    items = without("/image_raw", "/camera_info")
    for name in ("/a", "/b"):
        image = samples.image_message(BAG_MESSAGES, samples.START, "c", samples.picture())
        items.append((f"{name}/image_raw", image, samples.START))
    path = samples.write_plain(tmp_path / "bag", items)
    recording = read_recording(path, samples.SETTINGS)
    assert recording.has_images and len(recording.observations) == 4
    with pytest.raises(RecordingError, match=r"/a/image_raw, /b/image_raw"):
        list(iterate_images(path))


def test_command_without_a_stamp_starts_when_it_was_recorded(tmp_path):
    items = without("/dlo/command")
    message = samples.command_message(BAG_MESSAGES, replace(samples.command(), stamp=0))
    path = samples.write_plain(
        tmp_path / "bag", [("/dlo/command", message, samples.START + 7), *items]
    )
    (command,) = read_recording(path, samples.SETTINGS).commands
    assert command.stamp == samples.START + 7


@pytest.mark.parametrize("later", [0, 3_000_000_000])
def test_commands_that_another_replaces_whole_are_none(tmp_path, caplog, later):
    """A plan for later, and another one from now on: export, forces and checks of clocks see it."""
    planned = replace(samples.command(), stamp=samples.command().stamp + later)
    items = [
        ("/dlo/command", samples.command_message(BAG_MESSAGES, c), samples.START + k)
        for k, c in enumerate((planned, samples.command()))
    ]
    path = samples.write_plain(tmp_path / "bag", [*items, *without("/dlo/command")])
    (command,) = read_recording(path, samples.SETTINGS).commands
    assert command.stamp == samples.command().stamp
    assert "lies wholly" not in caplog.text


def test_splines_are_sorted_and_unusable_ones_skipped_with_a_reason(tmp_path):
    def spline(i: int, n: int = samples.N):
        stamp = samples.START + i * samples.STEP
        return spline_message(BAG_MESSAGES, stamp, "board", samples.control_points(i)[:n])

    bad = spline(3)
    bad.poses[2].position.x = float("nan")
    items = [
        ("/dlo/command", samples.messages()[0][1], samples.START),
        ("/dlo/observed", spline(2), samples.START + 1),
        ("/dlo/observed", spline(0), samples.START + 2),
        ("/dlo/observed", spline(1, n=6), samples.START + 3),
        ("/dlo/observed", bad, samples.START + 4),
        ("/dlo/observed", spline(0), samples.START + 5),
    ]
    recording = read_recording(samples.write_plain(tmp_path / "bag", items), samples.SETTINGS)
    stamps = [o.stamp for o in recording.observations]
    assert stamps == [samples.START, samples.START + 2 * samples.STEP]
    assert len(recording.skipped) == 3
    assert "6 poses" in recording.skipped[0] and "not finite" in recording.skipped[1]
    assert "second spline" in recording.skipped[2]


def test_missing_topics_are_named(tmp_path):
    path = samples.write_plain(tmp_path / "a", without("/dlo/command"))
    with pytest.raises(RecordingError, match=r"has no dlo/command \(it has /camera_info"):
        read_recording(path, samples.SETTINGS)
    assert len(read_recording(path, samples.SETTINGS, require_command=False).observations) == 4
    path = samples.write_plain(tmp_path / "b", without("/dlo/observed", "/image_raw"))
    with pytest.raises(RecordingError, match="has no dlo/observed"):
        read_recording(path, samples.SETTINGS)
    with pytest.raises(RecordingError, match="has no images"):
        list(iterate_images(path))
    path = samples.write_plain(tmp_path / "c", without("/dlo/observed", "/camera_info"))
    assert read_recording(path, samples.SETTINGS).observations == ()
    with pytest.raises(RecordingError, match="has no camera_info"):
        list(iterate_images(path))


def test_nothing_usable_on_a_topic_gives_the_reason(bag):
    other = Settings.from_mapping({**samples.SETTINGS.flat(), "frame_id": "table"})
    with pytest.raises(RecordingError, match=r"no message on dlo/command is usable .*'board'"):
        read_recording(bag, other)


def test_wrong_type(tmp_path):
    items = [*without("/dlo/command"), ("/dlo/command", float_message(BAG_MESSAGES, 1.0), 5)]
    path = samples.write_plain(tmp_path / "bag", items)
    with pytest.raises(RecordingError, match=r"std_msgs/msg/Float64; trajectory_msgs"):
        read_recording(path, samples.SETTINGS)


def test_what_is_no_bag(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file.txt").write_text("hello")
    (tmp_path / "yaml").mkdir()
    (tmp_path / "yaml" / "metadata.yaml").write_text("a: [1, 2")
    for name in ("nothing", "folder", "file.txt", "yaml"):
        with pytest.raises(RecordingError) as caught:
            read_recording(tmp_path / name, samples.SETTINGS)
        assert str(tmp_path / name) in str(caught.value) and "\n" not in str(caught.value)


def test_unfinished_recording_says_how_to_mend_it(bag, tmp_path):
    copy = Path(shutil.copytree(bag, tmp_path / "bag"))
    (copy / "metadata.yaml").unlink()
    with pytest.raises(RecordingError, match="ros2 bag reindex"):
        read_recording(copy, samples.SETTINGS)


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("part", [0.0, 0.2, 0.5, 0.9, 0.999])
def test_truncated_bag(tmp_path, plugin, part):
    path = samples.write_plain(tmp_path / "bag", samples.messages(), plugin)
    (stored,) = [p for p in path.iterdir() if p.suffix != ".yaml"]
    stored.write_bytes(stored.read_bytes()[: int(part * stored.stat().st_size)])
    with pytest.raises(RecordingError) as caught:
        read_recording(path, samples.SETTINGS)
        list(iterate_images(path))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_flipped_bytes_never_end_in_another_error(bag, tmp_path):
    copy = Path(shutil.copytree(bag, tmp_path / "bag"))
    rng = np.random.default_rng(3)
    for name in ("metadata.yaml", "whole.mcap"):
        whole = (copy / name).read_bytes()
        for _ in range(60):
            broken = bytearray(whole)
            broken[rng.integers(len(whole))] ^= 1 << int(rng.integers(8))
            (copy / name).write_bytes(bytes(broken))
            try:
                recording = read_recording(copy, samples.SETTINGS)
                for observation in recording.observations:
                    assert np.all(np.isfinite(observation.control_points))
            except RecordingError as err:
                assert "\n" not in str(err)
        (copy / name).write_bytes(whole)


def test_index_that_promises_more_than_the_file_holds(tmp_path):
    path = samples.write_plain(tmp_path / "bag", samples.messages())
    text = (path / "metadata.yaml").read_text()
    assert "message_count: 4" in text
    (path / "metadata.yaml").write_text(text.replace("message_count: 4", "message_count: 9"))
    with pytest.raises(RecordingError, match="holds 4 of the 9 messages"):
        read_recording(path, samples.SETTINGS)


def test_unusable_images_are_skipped_and_told(tmp_path):
    items = without("/image_raw")
    strange = samples.image_message(BAG_MESSAGES, samples.START, "c", samples.picture())
    strange.encoding = "yuv999"
    small = samples.image_message(BAG_MESSAGES, samples.START, "c", samples.picture()[:20])
    good = samples.image_message(BAG_MESSAGES, samples.START + 9, "c", samples.picture())
    for i, message in enumerate((strange, small, good)):
        items.append(("/image_raw", message, samples.START + i))
    told: list[str] = []
    path = samples.write_plain(tmp_path / "bag", items)
    assert [stamp for stamp, *_ in iterate_images(path, told.append)] == [samples.START + 9]
    assert len(told) == 2 and "'yuv999'" in told[0] and "64 x 20" in told[1]
    items = [i for i in items if i[1] is not good]
    with pytest.raises(RecordingError, match="no image is usable"):
        list(iterate_images(samples.write_plain(tmp_path / "none", items), told.append))


def test_compressed_images_come_with_the_camera_info_of_their_namespace(tmp_path):
    items: list = []
    for i in range(3):
        stamp = samples.START + i * samples.STEP
        items.append(("/cam/image_raw/compressed", samples.compressed(i), stamp))
    other = replace(samples.INFO, width=10)
    for name, info in (("/cam/camera_info", samples.INFO), ("/b/camera_info", other)):
        items.append((name, samples.camera_info_message(BAG_MESSAGES, 5, info), samples.START))
    path = samples.write_plain(tmp_path / "bag", items)
    images = list(iterate_images(path))
    assert len(images) == 3
    assert np.mean(np.abs(images[1][1].astype(int) - samples.picture(1))) < 2.0
