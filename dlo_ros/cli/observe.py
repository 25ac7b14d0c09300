# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`observe [--params FILE] --output OUT INPUT ...`: finds DLOs in a bag or in image files."""

from __future__ import annotations

import argparse
import logging
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path

import cv2
import numpy as np

from dlo_ros.cli.clock_check import many_missed, tell_delay_of_images
from dlo_ros.cli.control_points import advice, chosen, counted_name, with_control_points
from dlo_ros.cli.observe_points import observe_points_bag, observes_points
from dlo_ros.cli.observe_space import ObservedFrame, observe_together, watches_space
from dlo_ros.cli.progress import progress_bar
from dlo_ros.cli.refusals import Refusals
from dlo_ros.cli.results import check_results_folder
from dlo_ros.command import Motion
from dlo_ros.compilation import compile_first
from dlo_ros.errors import DloError, InputError, RecordingError, VisionError
from dlo_ros.files import write_bytes, write_text
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.observation import Observation
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.calibration_pictures import SUFFIXES, is_bag
from dlo_ros.recordings.camera_bags import count_images
from dlo_ros.recordings.images import Image
from dlo_ros.recordings.message_building import observation_messages
from dlo_ros.recordings.read import (
    HeldMasks,
    iterate_images,
    iterate_predictions,
    read_recording,
)
from dlo_ros.recordings.write import BagWriter, copy_topics
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.overlay import PALETTE, draw_curve, draw_overlay, write_message
from dlo_ros.vision.photograph import FoundDlo, find_dlos
from dlo_ros.vision.planar_observer import Observer
from dlo_ros.vision.planar_result import VisionResult
from dlo_ros.vision.predictions import Predictions
from dlo_ros.vision.segmentation.user_hints import Hints

LOG = logging.getLogger(__name__)

BAG_SUFFIXES = (".mcap", ".db3")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument("inputs", nargs="+", type=Path, metavar="INPUT", help="a bag, or images")
    parser.add_argument(
        "--params",
        type=Path,
        metavar="FILE",
        help="parameter file; needed for a bag, with image files for its block vision",
    )
    parser.add_argument(
        "--output",
        type=Path,
        required=True,
        metavar="OUT",
        help="bag to write, or folder for the centrelines and overlays of image files",
    )
    parser.add_argument(
        "--overlays", type=Path, metavar="FOLDER", help="bag only: write each image's overlay there"
    )
    parser.add_argument(
        "--control-points",
        metavar="N",
        help="bag only: control points of the splines instead of rod.control_points; "
        "'auto' chooses them by cross-validation, as is done where the file does not say",
    )
    parser.add_argument(
        "--points",
        action="store_true",
        help=f"bag only: observe {topics.POINTS} of another tracker where there are images, too",
    )
    parser.add_argument("--force", action="store_true", help="replace an existing bag")


def run(arguments: argparse.Namespace) -> int:
    """Observe; returns the exit status.

    Raises:
        DloError: an input or the output is unusable.
    """
    inputs: list[Path] = arguments.inputs
    bags = [p for p in inputs if p.is_dir() or p.suffix in BAG_SUFFIXES]
    pictures = next((p for p in bags if p.is_dir() and not is_bag(p) and _holds_pictures(p)), None)
    if pictures is not None:
        raise InputError(
            f"{pictures}: is a folder of pictures, no bag; give the pictures themselves, "
            f"{pictures / '*'}"
        )
    if not bags:
        if arguments.points:
            raise InputError(f"{inputs[0]}: is no bag; --points is for bags with {topics.POINTS}")
        if arguments.overlays is not None or arguments.control_points is not None:
            raise InputError(
                f"{inputs[0]}: is no bag; --overlays and --control-points are for bags (the "
                "overlays of image files are in --output)"
            )
        return _observe_files(inputs, arguments.output, arguments.params)
    if len(inputs) > 1:
        raise InputError(f"{bags[0]}: is a bag; give one bag, or image files only")
    if arguments.params is None:
        raise InputError(f"{bags[0]}: is a bag; give its parameter file with --params")
    settings = Settings.load(arguments.params)
    if observes_points(bags[0], wanted=arguments.points):
        if arguments.control_points is not None or arguments.overlays is not None:
            raise InputError(
                f"{bags[0]}: its {topics.POINTS} are observed, and no images; --overlays and "
                "--control-points are for images"
            )
        return observe_points_bag(bags[0], settings, arguments.output, force=arguments.force)
    if arguments.control_points is None:
        settings = with_control_points(
            settings, arguments.params, bags, observe_recording, anew=True
        )
    else:
        settings = _with_control_points(bags[0], settings, arguments.control_points)
    return _observe_bag(
        bags[0], settings, arguments.output, arguments.overlays, force=arguments.force
    )


def _holds_pictures(folder: Path) -> bool:
    return any(path.suffix.lower() in SUFFIXES for path in folder.iterdir())


def _with_control_points(path: Path, settings: Settings, wanted: str) -> Settings:
    """The settings with another number of control points, given or chosen.

    Raises:
        InputError: it is no number, no image shows the DLO, or the commands count them.
    """
    if wanted != "auto":
        flat = {**settings.flat(), "rod.control_points": wanted}
        return Settings.from_mapping(flat)
    name = counted_name(path)
    if name:
        raise InputError(
            f"{path}: {topics.COMMAND} names {name}, which is another place with another number of "
            "control points; leave --control-points auto away, or command start and end"
        )
    number = chosen(path, settings, observe_recording)
    if number is None:
        raise InputError(f"{path}: no image shows a credible DLO to choose control points by")
    print(f"{number} control points by cross-validation; set rod.control_points to {number}")
    return replace(settings, rod=replace(settings.rod, control_points=number))


def uncommanded_shapes(path: Path, settings: Settings) -> Iterator[Observation]:
    """The shapes in a recording's images, observed as if nothing had been commanded."""
    for frame in observe_recording(path, settings, LOG.debug, commanded=False):
        if frame.result is not None:
            yield frame.result.observation


def observe_recording(
    path: Path | str,
    settings: Settings,
    on_skip: Callable[[str], None] = LOG.warning,
    *,
    commanded: bool = True,
) -> Iterator[ObservedFrame]:
    """Run the observer on a recording's images, one after the other.

    Args:
        path: rosbag2 folder with images, camera_info and, where motion was imposed, commands.
        settings: parameter file of the recording.
        on_skip: function that is called with one line for each unusable image.
        commanded: whether the commands say where the DLO is held.

    Yields:
        Every image that could be decoded, with what was found.

    Raises:
        DloError: the bag or its camera_info is unusable.
    """
    recording = read_recording(path, settings, require_command=False)
    motion = Motion()
    for command in recording.commands if commanded else ():
        motion.add(command.later(settings.command_delay))
    if watches_space(Path(path), settings):
        _prepare()
        yield from observe_together(Path(path), settings, motion, on_skip)
        return
    observer: Observer | None = None
    known = None
    masks = HeldMasks(path, on_skip)
    predictions = Predictions()
    # In the order of their stamps: one that is far ahead of the images must not hold up others.
    published = deque(sorted(iterate_predictions(path, settings, on_skip), key=itemgetter(0)))
    latest = 0
    for stamp, image, info in iterate_images(path, on_skip):
        if observer is None:
            _prepare()
        if observer is None or info != known:
            camera = Camera.from_info(
                info.k, info.d, info.distortion_model, info.width, info.height, settings.camera
            )
            observer, known = Observer(settings, camera, motion), info
        observer.mask = masks.at(stamp)
        while published and latest < stamp:  # up to the first one after the image
            latest = published[0][0]
            predictions.add(*published.popleft())
        try:
            result, reason = observer.observe(stamp, image, predictions.at(stamp)), ""
        except VisionError as err:
            LOG.info("%s: image %d ns: %s", path, stamp, err)
            result, reason = None, str(err)
        yield ObservedFrame(stamp, {"": (image, camera, result)}, reason)


def _observe_bag(
    path: Path, settings: Settings, output: Path, overlays: Path | None, force: bool
) -> int:
    total = count_images(path, next(iter(settings.cameras), ""))
    if overlays is not None:
        overlays.mkdir(parents=True, exist_ok=True)
    if output.exists() and path.exists() and output.resolve() == path.resolve():
        raise RecordingError(f"{output}: is the input; give the output another name")
    frame_id = settings.frame_id
    refusals = Refusals()
    found: list[VisionResult] = []
    offsets: list[float] = []
    with (
        BagWriter(output, force=force) as writer,
        progress_bar() as progress,
    ):
        task = progress.add_task("Observing", total=total)
        for frame in observe_recording(path, settings):
            progress.advance(task)
            offsets.append(frame.offset)
            for name, (image, camera, result) in frame.views.items() if overlays else ():
                picture = draw_overlay(
                    image, camera, settings.rod.length, result, message=frame.reason
                )
                end = f"_{name}" if name else ""
                assert overlays is not None
                _write_image(overlays / f"{path.name}_{frame.stamp}{end}.png", picture)
            if frame.result is None:
                refusals.add(frame.reason)
                continue
            for topic, message in observation_messages(frame_id, frame.result.observation):
                writer.write(topic, message, frame.stamp)
            found.append(frame.result)
        if not found:
            _doubt_commands(path, settings, found, refusals.total)
            raise InputError(f"{path}: no image shows a credible DLO ({refusals.main()})")
        copy_topics(path, writer, exclude=(topics.OBSERVED, topics.OBSERVED_POINTS))
    seen = 100.0 * float(np.mean([r.fraction_seen for r in found]))
    residual = 1000.0 * float(np.median([r.residual for r in found]))
    length = float(np.median([r.seen_length for r in found]))
    print(
        f"{output}: {len(found)} of {len(found) + refusals.total} images show the DLO, "
        f"{seen:.0f} % of it seen, {length:.4g} m long (rod.length {settings.rod.length:.4g} m), "
        f"spline within {residual:.2f} mm (median)"
    )
    if settings.cameras:
        print(
            f"  stamps of the cameras' images {1000 * np.median(offsets):.1f} ms apart (median; "
            f"largest {1000 * max(offsets):.1f} ms)"
        )
    for reason, count in refusals.commonest(5):
        print(f"  {count} without: {reason}")
    _doubt_commands(path, settings, found, refusals.total)
    words = advice(found, settings, path)
    if words:
        print(f"  {words}")
    return 0


def _doubt_commands(
    path: Path, settings: Settings, found: Sequence[VisionResult], missed: int
) -> None:
    """Warn where the images show another motion than the commanded one."""
    if not many_missed(missed, len(found)):
        return  # before the bag is read again
    recording = read_recording(path, settings, require_command=False)
    shapes = tuple(result.observation for result in found)
    manipulation = Manipulation(recording.name, recording.commands, shapes)
    tell_delay_of_images(manipulation, settings, missed, lambda: uncommanded_shapes(path, settings))


def _prepare() -> None:
    """Compile the vision stage; progress of a long wait is printed on stderr."""
    compile_first(("vision",), lambda text: print(text, file=sys.stderr))


def _observe_files(inputs: list[Path], output: Path, params: Path | None) -> int:
    names: dict[str, Path] = {}
    for path in inputs:
        if path.stem in names:
            raise InputError(
                f"{path}: has the same name as {names[path.stem]}; give them one at a time, with "
                "outputs of their own"
            )
        names[path.stem] = path
        target = output / f"{path.stem}.png"
        if target.exists() and path.exists() and target.samefile(path):
            raise InputError(f"{path}: would be overwritten; give another --output")
    check_results_folder(output)
    hints = None if params is None else Hints(Settings.load(params).vision)
    images = {path: _read_image(path) for path in inputs[:1]}
    output.mkdir(parents=True, exist_ok=True)
    _prepare()
    for path in inputs:
        image = images[path] if path in images else _read_image(path)
        try:
            dlos = find_dlos(image, hints)
        except DloError as err:
            raise InputError(f"{path}: {err}") from err
        _write_table(output / f"{path.stem}.csv", dlos)
        _write_image(output / f"{path.stem}.png", _marked(image, dlos))
        lengths = ", ".join(f"{dlo.length:.0f}" for dlo in dlos)
        what = f"{len(dlos)} found, {lengths} px long" if dlos else "no credible DLO found"
        print(f"{path}: {what}")
    return 0


def _read_image(path: Path) -> Image:
    """An image file as BGR, turned as its EXIF tag says."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a bag or image files")
    data = np.fromfile(path, dtype=np.uint8)
    image = None
    if data.size:
        try:
            image = cv2.imdecode(data, cv2.IMREAD_COLOR)
        except cv2.error:
            image = None
    if image is None:
        raise InputError(f"{path}: is no image that can be read; JPEG, PNG, TIFF, BMP or WebP can")
    return np.asarray(image, dtype=np.uint8)


def _marked(image: Image, dlos: list[FoundDlo]) -> Image:
    canvas = image.copy()
    for number, dlo in enumerate(dlos):
        draw_curve(canvas, dlo.pixels, PALETTE[number % len(PALETTE)], dlo.seen)
    if not dlos:
        write_message(canvas, "no credible DLO found")
    return canvas


def _write_table(path: Path, dlos: list[FoundDlo]) -> None:
    lines = ["dlo,u,x_px,y_px"]
    for number, dlo in enumerate(dlos):
        lines += [
            f"{number},{u:.6f},{x:.3f},{y:.3f}" for u, (x, y) in zip(dlo.u, dlo.pixels, strict=True)
        ]
    write_text(path, "\n".join(lines) + "\n")


def _write_image(path: Path, image: Image) -> None:
    good, data = cv2.imencode(".png", image)
    if not good:
        raise InputError(f"{path}: the overlay cannot be encoded")
    write_bytes(path, data.tobytes())
