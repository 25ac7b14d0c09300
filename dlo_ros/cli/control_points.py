# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The number of control points of splines where a parameter file does not state it.

A bag with observed splines has one already. For images, cross-validation chooses it. Where a
command names control points beyond the outer two of either end, their number is part of the names
and stays that of interface.md.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from dlo_ros.cli.observe_space import ObservedFrame
from dlo_ros.command import CONTROL_POINT
from dlo_ros.errors import DloError, VisionError
from dlo_ros.parameter_file import parameter_values
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import deserialise, open_bag
from dlo_ros.vision.fit.control_point_count import (
    choose_control_points,
    enough_control_points,
    follows,
)
from dlo_ros.vision.planar_result import VisionResult

NAME = "rod.control_points"
MOST_CONTROL_POINTS = 60  # with which shapes are looked at before their number is chosen
CHOSEN_BY, CHOSEN_EVERY = 20, 3  # images that choose it, and every how many one is taken

Observe = Callable[[Path, Settings], Iterable[ObservedFrame]]


def with_control_points(
    settings: Settings, params: Path, bags: Sequence[Path], observe: Observe, *, anew: bool = False
) -> Settings:
    """The settings, with a number of control points that suits the bags where the file has none.

    Args:
        settings: the settings of the parameter file.
        params: the parameter file.
        bags: the first that has a number decides.
        observe: runs the observer on a bag's images.
        anew: whether the bags are observed again, so that splines in them do not count.
    """
    if not bags or NAME in parameter_values(params):
        return settings
    for path in bags:
        with suppress(DloError):  # a defect of a bag is reported where it is read
            number = _of_bag(path, settings, observe, anew=anew)
            if number is not None:
                return replace(settings, rod=replace(settings.rod, control_points=number))
    return settings


def _of_bag(path: Path, settings: Settings, observe: Observe, *, anew: bool) -> int | None:
    with open_bag(path) as bag:
        for raw in bag.messages([] if anew else bag.find(topics.OBSERVED)):
            poses = len(getattr(deserialise(raw), "poses", ()))
            if poses:
                return poses
        images = bag.holds(topics.IMAGE) or bag.holds(topics.COMPRESSED)
    if not images or counted_name(path):
        return None
    number = chosen(path, settings, observe)
    if number is not None:
        print(f"{path}: {number} control points by cross-validation, since {NAME} is not given")
    return number


def counted_name(path: Path) -> str:
    """A name in a bag's commands whose place depends on the number of control points; else none."""
    counted = re.compile(rf"{CONTROL_POINT}(\d+)")
    with open_bag(path) as bag:
        for raw in bag.messages(bag.find(topics.COMMAND)):
            for name in getattr(deserialise(raw), "joint_names", ()):
                found = counted.fullmatch(str(name))
                if found and int(found[1]) > 2:
                    return str(name)
    return ""


def chosen(path: Path, settings: Settings, observe: Observe) -> int | None:
    """The number that cross-validation chooses by a bag's images; None where none shows the DLO.

    Args:
        path: the bag.
        settings: the observer's settings.
        observe: runs it.

    Raises:
        DloError: the bag is unusable.
    """
    many = replace(settings, rod=replace(settings.rod, control_points=MOST_CONTROL_POINTS))
    needed: list[int] = []
    for number, frame in enumerate(observe(path, many)):
        points = None if frame.result is None else frame.result.observation.points
        if points is not None and number % CHOSEN_EVERY == 0:
            with suppress(VisionError):
                needed.append(choose_control_points(points, settings.rod.length))
        if number >= CHOSEN_EVERY * CHOSEN_BY:
            break
    # Shapes still to come may be a little more bent than those looked at.
    return max(needed) + 1 if needed else None


def advice(found: Sequence[VisionResult], settings: Settings, path: Path) -> str:
    """Words where the splines have too few control points to follow the DLO; else none.

    Args:
        found: what the bag's images showed.
        settings: the observer's settings.
        path: the bag.
    """
    length = settings.rod.length
    behind = [
        points
        for result in found
        if (points := result.observation.points) is not None
        and not follows(points, result.observation.control_points, length)
    ]
    if not behind:
        return ""
    some = behind[:: max(1, -(-len(behind) // CHOSEN_BY))]
    enough = []
    for points in some:
        with suppress(VisionError):
            enough.append(enough_control_points(points, length))
    number = f"{max(enough)} would do" if enough else "no number would do"
    where = "rod.control_points, or --control-points auto"
    name = counted_name(path)
    if name:
        where = f"not with these commands, which name {name}; start and end are free of it"
    return (
        f"in {len(behind)} a spline of {settings.rod.control_points} control points cannot follow "
        f"the DLO: {number} ({where})"
    )
