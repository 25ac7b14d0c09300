# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Inputs of `predict` and `identify`: parameter file, bags, and splines observed on the way."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from dlo_ros.cli.clock_check import tell_delay, tell_delay_of_images
from dlo_ros.cli.control_points import with_control_points
from dlo_ros.cli.early_twist import tell_early_twist
from dlo_ros.cli.observe import observe_recording, uncommanded_shapes
from dlo_ros.cli.observe_points import ObservedPoints, observe_points, observes_points
from dlo_ros.cli.observe_space import ObservedFrame
from dlo_ros.cli.refusals import Refusals
from dlo_ros.command import NANOSECONDS, Motion
from dlo_ros.compilation import compile_first
from dlo_ros.errors import InputError, RecordingError
from dlo_ros.inference.first_motion import apparent_start
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.lost_pictures import lost_pictures, with_lost_time
from dlo_ros.inference.lost_time import Gap
from dlo_ros.inference.observation_operator import operator_of
from dlo_ros.observation import Observation
from dlo_ros.parameter_file import parameter_values
from dlo_ros.parameter_table import TABLE
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.camera_bags import count_images
from dlo_ros.recordings.read import BagContents, read_recording
from dlo_ros.rod.boundary.shape_orientation import all_along, runs_backwards
from dlo_ros.spline import FloatArray

LOG = logging.getLogger(__name__)

START = "simulation.start"
GAPS_TOLD = 3
"""Places of lost pictures that are named."""


def add_model_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that name the model: `--params` and `--start`."""
    parser.add_argument(
        "--params", type=Path, required=True, metavar="FILE", help="parameter file of the DLO"
    )
    parser.add_argument(
        "--start",
        choices=TABLE["simulation.start"].choices,
        help="how the simulation starts from the observed shapes; default: as the file says",
    )


def load_settings(arguments: argparse.Namespace, bags: Sequence[Path] = ()) -> Settings:
    """The parameter file, with what the command line overrides.

    Args:
        arguments: parsed arguments of the command line.
        bags: bags whose images determine the number of control points where the file does not.

    Raises:
        ParameterError: the file is unusable.
    """
    settings = Settings.load(arguments.params)
    settings = with_control_points(settings, arguments.params, bags, observe_recording)
    if arguments.start is None:
        return settings
    return replace(settings, simulation=replace(settings.simulation, start=arguments.start))


def load_all(
    arguments: argparse.Namespace, bags: Sequence[Path], others: Sequence[Path],
    settings: Settings,
) -> tuple[list[Manipulation], list[Manipulation]]:  # fmt: skip
    """Bags to learn from and others, each recording with a name of its own.

    Raises:
        InputError: one is given twice.
        RecordingError: see `load_manipulation`.
    """
    names = distinct_names([*bags, *others])
    found, more = (load_recordings(arguments, some, settings) for some in (bags, others))
    named = [replace(m, name=name) for m, name in zip([*found, *more], names, strict=True)]
    return named[: len(found)], named[len(found) :]


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """The ends of paths, each as long as it takes to tell it from the others.

    Raises:
        InputError: one is given twice.
    """
    whole = [path.resolve().parts for path in paths]
    names = []
    for path, parts in zip(paths, whole, strict=True):
        if whole.count(parts) > 1:
            raise InputError(f"{path} is given twice; give each recording once")
        ends = (k for k in range(1, len(parts) + 1))
        enough = next(k for k in ends if sum(p[-k:] == parts[-k:] for p in whole) == 1)
        names.append(str(Path(*parts[-enough:])))
    return names


def load_recordings(
    arguments: argparse.Namespace, bags: Sequence[Path], settings: Settings
) -> list[Manipulation]:
    """Bags, each with its own start where neither the command line nor the file says how.

    Raises:
        RecordingError: see `load_manipulation`.
    """
    found = [load_manipulation(bag, settings) for bag in bags]
    if arguments.start or settings.simulation.start != "equilibrium":
        return found
    stated = not unstated(arguments)
    return [_as_it_begins(m, settings.rod.length, stated=stated) for m in found]


def unstated(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Names of parameters that results must not state, since nothing given to a tool does.

    Without `simulation.start` each recording begins as it shows.
    """
    stated = arguments.start or START in parameter_values(arguments.params)
    return () if stated else (START,)


def _as_it_begins(manipulation: Manipulation, length: float, *, stated: bool) -> Manipulation:
    """A manipulation with its own start where it begins in motion.

    Args:
        stated: whether the parameter file says that it begins in equilibrium, which holds.
    """
    start = apparent_start(manipulation, length)
    if start is None:
        return manipulation
    LOG.warning(
        "%s: at first the DLO moves much farther than its command, so that it was in no "
        "equilibrium; %s",
        manipulation.name,
        f"yet simulation.start says so: try --start {start}"
        if stated
        else f"it is simulated with --start {start} (--start equilibrium keeps it at rest)",
    )
    return manipulation if stated else replace(manipulation, start=start)


def load_information(path: Path) -> FloatArray:
    """Information of recordings on the logarithms of the material, shape (4, 4).

    Args:
        path: estimate.json of `identify`.

    Raises:
        InputError: the file is no estimate.json that holds it.
    """
    try:
        tree = json.loads(path.read_text())
        information = np.array(tree["information"]["matrix"], dtype=float)
    except OSError as err:
        raise InputError(f"{path}: cannot be read ({err.strerror})") from err
    except (ValueError, KeyError, TypeError, OverflowError) as err:
        raise InputError(
            f"{path}: holds no information on parameters; give an estimate.json of identify"
        ) from err
    if information.shape != (4, 4) or not np.all(np.isfinite(information)):
        raise InputError(f"{path}: information.matrix is no 4 by 4 matrix")
    return information


def prepare() -> None:
    """Compile the model where that has not been done; progress of a long wait is printed on
    stderr.
    """
    compile_first(("rod",), lambda text: print(text, file=sys.stderr))


def load_manipulation(path: Path, settings: Settings) -> Manipulation:
    """A bag's commands and observed shapes; where it has images or points only, the observer
    runs first.

    Raises:
        RecordingError: the bag is unusable, or no image shows a credible DLO.
    """
    recording = read_recording(path, settings)
    observations = recording.observations
    if not observations:
        observe = _observe_points if observes_points(path) else _observe
        observations = tuple(observe(path, settings))
        if observe is _observe:
            _doubt_commands(recording, settings, observations)
    motion = Motion(list(recording.commands))
    swapped = sum(runs_backwards(o, motion) for o in observations)
    if swapped:
        LOG.warning(
            "%s: %d of %d observed shapes run from the commanded end to the commanded start and "
            "are turned round; they were probably observed before the command was known",
            path,
            swapped,
            len(observations),
        )
    LOG.info(
        "%s: %d commands, %d observed shapes", path, len(recording.commands), len(observations)
    )
    length = settings.rod.length
    usable = all_along(motion, observations, length)
    unfit = sum(o.points is not None and operator_of(o, length) is None for o in usable)
    if unfit:
        LOG.warning(
            "%s: %s of %d of %d observed shapes do not lie on their splines, or are too few; the "
            "splines are compared instead",
            path, topics.OBSERVED_POINTS, unfit, len(usable),
        )  # fmt: skip
    result = Manipulation(recording.name, recording.commands, usable, recording.wrenches)
    gaps = lost_pictures(result)
    if gaps:
        _tell_gaps(result, gaps)
        result = with_lost_time(result, gaps)
    tell_delay(result, settings)
    tell_early_twist(result)
    return result


def _tell_gaps(manipulation: Manipulation, gaps: Sequence[Gap]) -> None:
    """Warn of lost pictures whose time is put back."""
    first = manipulation.observations[0].stamp
    places = [
        f"{g.lost} after {(g.before - first) / NANOSECONDS:.2f} s" for g in gaps[:GAPS_TOLD]
    ] + [f"and at {len(gaps) - GAPS_TOLD} more places"] * (len(gaps) > GAPS_TOLD)
    lost = sum(g.lost for g in gaps)
    LOG.warning(
        "%s: %d %s lost that the stamps do not count (%s): all of the DLO and what holds it jump "
        "there as far as in so many pictures; the %.2f s are put back",
        manipulation.name, lost, "picture was" if lost == 1 else "pictures were",
        ", ".join(places), sum(g.missing for g in gaps) / NANOSECONDS,
    )  # fmt: skip


def _doubt_commands(
    recording: BagContents, settings: Settings, found: tuple[Observation, ...]
) -> None:
    """Warn where the images show another motion than the commanded one."""
    path = recording.path
    total = count_images(path, next(iter(settings.cameras), ""))
    tell_delay_of_images(
        Manipulation(recording.name, recording.commands, found), settings, total - len(found),
        lambda: uncommanded_shapes(path, settings),
    )  # fmt: skip


def _observe_points(path: Path, settings: Settings) -> list[Observation]:
    return _usable(observe_points(path, settings), f"{path}: no list of points", "")


def _observe(path: Path, settings: Settings) -> list[Observation]:
    console = Console(stderr=True)
    frames = observe_recording(path, settings)
    shown = track(frames, f"Observing {path.name}", console=console, transient=True)
    return _usable(shown, f"{path}: no image", "it has no images")


def _usable(
    observed: Iterable[ObservedFrame | ObservedPoints], none: str, reason: str
) -> list[Observation]:
    """The observations among all results of the observer, by growing stamp, each stamp once.

    Args:
        none: beginning of the message where there is none.
        reason: the reason why there is no observation, where nothing was observed at all.

    Raises:
        RecordingError: there is none.
    """
    found: dict[int, Observation] = {}
    refusals, doubled = Refusals(), 0
    for each in observed:
        if each.result is None:
            refusals.add(each.reason)
        elif each.result.observation.stamp in found:
            doubled += 1
        else:
            found[each.result.observation.stamp] = each.result.observation
    if doubled:
        LOG.warning("%s counts beside another of its stamp: %d are left out", none, doubled)
    if not found:
        raise RecordingError(f"{none} shows a credible DLO ({refusals.main(reason)})")
    return [found[stamp] for stamp in sorted(found)]
