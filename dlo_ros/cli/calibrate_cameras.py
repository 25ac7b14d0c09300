# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`calibrate --cameras NAME=FILE ...`: several cameras to one another and to the board."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

from dlo_ros.errors import InputError, VisionError
from dlo_ros.files import write_text
from dlo_ros.parameter_cameras import flat_cameras
from dlo_ros.parameter_text import parameter_lines
from dlo_ros.parameters import Vector
from dlo_ros.recordings.calibration_pictures import SUFFIXES, is_bag, read_picture
from dlo_ros.report.elements import measured
from dlo_ros.vision.calibration.camera_file import read_camera_file
from dlo_ros.vision.calibration.camera_network import CalibratedCameras, calibrate_cameras
from dlo_ros.vision.calibration.pattern_search import PatternView, find_pattern
from dlo_ros.vision.calibration.patterns import Pattern

LOG = logging.getLogger(__name__)


def calibrate_together(
    cameras: Sequence[str],
    folders: Sequence[Path],
    board: Path | None,
    pattern: Pattern,
    pattern_at: Vector,
    up: str,
) -> CalibratedCameras:
    """Find the poses of the cameras from folders of pictures taken at the same instants.

    Args:
        cameras: NAME=FILE, the file a camera_info.yaml.
        folders: one folder of pictures for each camera, in the order of the cameras; pictures of
            equal name were taken at one instant.
        board: name of the picture, in every folder, with the pattern lying on the board.
        pattern: the calibration pattern in the pictures.
        pattern_at: position of the pattern's centre in the board frame [m].
        up: the side of the first camera's image that is up on the board.

    Raises:
        DloError: an input is unusable.
    """
    given = [text.partition("=") for text in cameras]
    for name, _, file in given:
        if not name.isidentifier() or not file:
            raise InputError(f"--cameras {name}: give NAME=CAMERA_INFO for each, as left=left.yaml")
    if len({name for name, _, _ in given}) != len(given) or len(given) < 2:
        raise InputError("--cameras needs two cameras or more, with names of their own")
    bag = next((path for path in folders if is_bag(path)), None)
    if bag is not None:
        raise InputError(
            f"{bag}: is a bag; --cameras needs one folder of pictures for each camera, in their "
            "order, with equal names for the pictures of one instant"
        )
    if len(folders) != len(given):
        raise InputError(
            f"--cameras names {len(given)} cameras, and there are {len(folders)} folders; give one "
            "folder of pictures for each camera, in their order"
        )
    missing = next((path for path in folders if not path.is_dir()), None)
    if missing is not None:
        raise InputError(f"{missing}: is no folder; give one of pictures for each camera")
    if board is None:
        raise InputError(
            "--board is missing; name the picture, in every folder, with the pattern on the board"
        )
    intrinsics = {name: read_camera_file(Path(file)) for name, _, file in given}
    names = sorted(set().union(*map(_pictures, folders)))
    folder_of = dict(zip(intrinsics, folders, strict=True))
    first, *others = folder_of
    if not (folder_of[first] / board.name).is_file():
        raise InputError(
            f"--board {board.name}: is not in {folder_of[first]}, the folder of the camera "
            f"'{first}', from which the board's pose comes"
        )
    seen: dict[str, list[str]] = {name: [] for name in intrinsics}
    instants: list[dict[str, PatternView]] = []
    lying = -1
    for picture in names:
        views: dict[str, PatternView] = {}
        for name, folder in folder_of.items():
            path = folder / picture
            if not path.is_file():
                continue
            try:
                views[name] = _view(path, pattern)
                seen[name].append(picture)
            except InputError as err:
                if picture == board.name:
                    raise
                LOG.warning("%s", err)
        if picture == board.name:
            lying = len(instants)
        if len(views) > 1 or picture == board.name:
            instants.append(views)
    for name in others:
        _check_common(first, name, seen, folder_of)
    return calibrate_cameras(instants, lying, intrinsics, pattern, pattern_at, up)


def _view(path: Path, pattern: Pattern) -> PatternView:
    """The pattern in a picture.

    Raises:
        InputError: it is no picture, or does not show the pattern; with its path.
    """
    image = read_picture(path)
    try:
        return find_pattern(image, pattern, str(path))
    except VisionError as err:
        raise InputError(f"{path}: {err}") from err


def _pictures(folder: Path) -> set[str]:
    """Names of the pictures in a folder."""
    return {path.name for path in folder.iterdir() if path.suffix.lower() in SUFFIXES}


def _check_common(
    first: str, name: str, seen: Mapping[str, Sequence[str]], folders: Mapping[str, Path]
) -> None:
    """Refuse a camera that sees the pattern in no picture in which the first one does.

    Args:
        first: name of the first camera.
        name: name of another one.
        seen: names of the pictures in which each camera sees the pattern.
        folders: folder of each camera's pictures.

    Raises:
        InputError: it is so; with what is missing, and in which folder.
    """
    if set(seen[first]) & set(seen[name]):
        return
    blind = next((camera for camera in (first, name) if not seen[camera]), None)
    if blind is not None:
        count = len(_pictures(folders[blind]))
        raise InputError(
            f"{folders[blind]}: none of the {count} pictures of the camera '{blind}' shows the "
            "pattern; is it the one of --pattern, wholly in the picture and sharp?"
        )
    if not _pictures(folders[first]) & _pictures(folders[name]):
        raise InputError(
            f"{folders[name]}: no picture of the camera '{name}' has the name of one of '{first}' "
            f"({folders[first]}); give those of one instant equal names"
        )
    raise InputError(
        f"cameras '{first}' and '{name}' never see the pattern at the same time: '{first}' in "
        f"{', '.join(seen[first][:4])}, '{name}' in {', '.join(seen[name][:4])}; show it where "
        "their views overlap, wholly in both pictures"
    )


def write_cameras(found: CalibratedCameras, path: Path) -> str:
    """Write the parameter file with the cameras' poses; returns a line for a person."""
    head = (
        "# Poses of the frame board in the cameras' optical frames, found by dlo_ros calibrate.\n"
        "# Copy the blocks into the parameter file.\n"
    )
    write_text(path, head + parameter_lines(flat_cameras(found.poses)))
    apart = ", ".join(
        f"{name} {measured(1e3 * distance, 1e3 * std, 'mm')} from {next(iter(found.poses))}"
        for name, (distance, std) in found.distances.items()
    )
    return f"{apart}; corners within {found.rms:.2f} px at {found.instants} instants"
