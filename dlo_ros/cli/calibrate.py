# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`calibrate --pattern PATTERN --output DIR [--board IMAGE] INPUT ...`: camera and board."""

from __future__ import annotations

import argparse
import logging
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

from dlo_ros.cli.calibrate_cameras import calibrate_together, write_cameras
from dlo_ros.cli.calibration_output import summary, write_results
from dlo_ros.cli.progress import progress_bar
from dlo_ros.cli.results import check_results_folder, written
from dlo_ros.errors import DloError, InputError
from dlo_ros.parameters import Vector
from dlo_ros.recordings.calibration_pictures import count_pictures, pictures, read_picture
from dlo_ros.vision.calibration.board_pose import UP, board_pose
from dlo_ros.vision.calibration.camera_calibration import Calibration, calibrate, check_camera
from dlo_ros.vision.calibration.camera_file import read_camera_file
from dlo_ros.vision.calibration.camera_fit import Intrinsics
from dlo_ros.vision.calibration.pattern_search import find_pattern
from dlo_ros.vision.calibration.patterns import SYNTAX, Pattern, parse_pattern
from dlo_ros.vision.calibration.print_pattern import print_pattern
from dlo_ros.vision.calibration.view_collection import Skipped, ViewCollector
from dlo_ros.vision.calibration.view_coverage import LEAST_VIEWS

LOG = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument(
        "inputs",
        nargs="*",
        type=Path,
        metavar="INPUT",
        help="pictures of the pattern: image files, folders of them, or a bag with images",
    )
    parser.add_argument(
        "--pattern",
        required=True,
        metavar="PATTERN",
        help=f"{SYNTAX}. COLS and ROWS count inner corners (where four squares meet), SQUARE and "
        "MARKER are sides in m, DICT is an ArUco dictionary of OpenCV; ':old' at the end is for "
        "boards made by OpenCV before 4.6 with an even number of rows of squares",
    )
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder for the results")
    parser.add_argument(
        "--board",
        type=Path,
        metavar="IMAGE",
        help="picture with the pattern lying on the board, from the camera in its final place; "
        "gives the board's pose",
    )
    parser.add_argument(
        "--pattern-at",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=("X", "Y", "Z"),
        help="where the pattern's centre lies in the frame 'board' [m]; default: it is the origin. "
        "Y is how far the pattern lies behind the DLO's axis, usually half the DLO's diameter",
    )
    parser.add_argument(
        "--up",
        choices=tuple(UP),
        default="top",
        help="the side of the image that is up on the board (default top)",
    )
    parser.add_argument(
        "--camera-info",
        type=Path,
        metavar="FILE",
        help="camera_info.yaml or ost.yaml of ROS: keep that camera, check it against the INPUTs, "
        "and find the board with it",
    )
    parser.add_argument(
        "--camera-name",
        default="camera",
        metavar="NAME",
        help="camera_name in camera_info.yaml; of a bag with several cameras, NAME/image_raw",
    )
    parser.add_argument(
        "--cameras",
        nargs="+",
        metavar="NAME=FILE",
        help="several cameras, each calibrated before, with its camera_info.yaml: find their poses "
        "to one another and to the board. INPUTs are then folders, one for each; pictures of equal "
        "name were taken at the same instant, and that named by --board shows the board",
    )
    parser.add_argument(
        "--print-pattern",
        type=Path,
        metavar="FILE",
        help="write the pattern to FILE (.pdf, .svg or .png) to print at 100 %%, and stop",
    )


def run(arguments: argparse.Namespace) -> int:
    """Calibrate; returns the exit status.

    Raises:
        DloError: an input or the output is unusable.
    """
    pattern = parse_pattern(arguments.pattern)
    if arguments.print_pattern is not None:
        paper = print_pattern(pattern, arguments.print_pattern)
        width, height = (1e3 * side for side in pattern.size)
        print(
            f"{arguments.print_pattern}: {pattern.kind}, {width:g} x {height:g} mm, on {paper}; "
            "print it at 100 %, measure a square and glue the sheet to something flat"
        )
        return 0
    _check(arguments)
    output: Path = arguments.output
    _make_folder(output)
    if arguments.cameras:
        poses = calibrate_together(
            arguments.cameras, arguments.inputs, arguments.board, pattern,
            tuple(arguments.pattern_at), arguments.up,
        )  # fmt: skip
        with written(output):
            text = write_cameras(poses, output / "cameras.yaml")
        print(f"{text}\nwritten to {output}: cameras.yaml")
        return 0
    given = None if arguments.camera_info is None else read_camera_file(arguments.camera_info)
    picture = None if arguments.board is None else read_picture(arguments.board)
    found, skipped = _calibration(arguments.inputs, pattern, given, arguments.camera_name)
    board = None
    if picture is not None:
        try:
            view = find_pattern(picture, pattern, str(arguments.board))
        except DloError as err:
            raise InputError(f"{arguments.board}: {err}") from err
        at: Vector = tuple(arguments.pattern_at)
        board = board_pose(view, pattern, found.intrinsics, at, arguments.up)
    with written(output):
        names = write_results(
            output, arguments.camera_name, pattern, found, skipped, board, picture
        )
    print(summary(found, skipped, board))
    print(f"written to {output}: {', '.join(names)}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    """Refuse arguments that contradict each other."""
    if arguments.output is None:
        raise InputError("--output is missing; name the folder for the results")
    if not arguments.inputs and arguments.camera_info is None:
        raise InputError(
            "no INPUT; give pictures of the pattern (image files, folders, a bag), or the "
            "calibrated camera with --camera-info"
        )
    if not arguments.inputs and arguments.board is None:
        raise InputError(
            "nothing to do with --camera-info alone; give --board IMAGE to find the board's pose, "
            "or INPUTs to check the camera"
        )
    if not all(math.isfinite(v) and abs(v) < 1e3 for v in arguments.pattern_at):
        raise InputError("--pattern-at needs three lengths in metres")


def _make_folder(output: Path) -> None:
    """Make the output folder, and see that files can be written, before any work is done."""
    check_results_folder(output)
    with written(output):
        output.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=output):
            pass


def _calibration(
    inputs: Sequence[Path], pattern: Pattern, given: Intrinsics | None, camera: str
) -> tuple[Calibration, list[Skipped]]:
    """First all pictures, then the optimisation; nothing of the first reaches into the second."""
    if not inputs and given is not None:
        return Calibration(given, None, (), (), None, ()), []
    collector = ViewCollector(pattern)
    total = sum(count_pictures(path, camera) for path in inputs)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TextColumn("{task.fields[hint]}"),
    )
    with progress_bar(*columns) as bar:
        task = bar.add_task("Finding the pattern", total=total, hint="")
        for path in inputs:
            for picture in pictures(path, camera, LOG.warning, lambda: bar.advance(task)):
                if collector.offer(picture.name, picture.image, picture.moving):
                    bar.update(task, hint=_still_missing(collector))
        views = collector.views(LEAST_VIEWS if given is None else 1)

        def progress(text: str, share: float) -> None:
            bar.update(
                task,
                description=text.capitalize(),
                completed=share * 100.0,
                total=100.0,
                hint="",
            )

        if given is not None:
            return check_camera(views, pattern, given), collector.skipped
        return calibrate(views, pattern, progress=progress), collector.skipped


def _still_missing(collector: ViewCollector) -> str:
    missing = collector.coverage.missing()
    count = f"{collector.coverage.count} views"
    return f"{count}; missing: {'; '.join(missing)}" if missing else f"{count}, all kinds are there"
