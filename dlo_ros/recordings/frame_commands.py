# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The imposed motion from a robot's frames (`command.source`: tf) or poses (pose).

A frame, and the clamp's offset in it, give the clamp's pose in `frame_id` at the instants at which
the robot publishes it; between them it is interpolated as in any command.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import END, NANOSECONDS, START, Command
from dlo_ros.errors import CommandError, InputError
from dlo_ros.parameters import Offset, Settings
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import Bag, deserialise
from dlo_ros.recordings.command_spans import seen_spans
from dlo_ros.recordings.transforms import Transforms, common_instants, transforms_of
from dlo_ros.spline import FloatArray

CLOSEST = NANOSECONDS // 1000
"""Instants closer than this [ns] are one: robots publish each joint by itself."""

LONGEST_SILENCE = NANOSECONDS // 2
"""Time [ns] without frames that is told: robots publish at 10 Hz and more, and interpolation over
longer gaps invents a motion."""

POSES = {START: topics.START_POSE, END: topics.END_POSE}


def clamp_frames(settings: Settings) -> dict[str, tuple[str, Offset]]:
    """Frame of each end that the settings say is held, and the clamp's offset in it.

    A pose is kept as the pose of a frame that is called as its topic.
    """
    own = settings.command
    offsets = {START: own.start_offset, END: own.end_offset}
    if own.source == "pose":
        return {end: (topic, offsets[end]) for end, topic in POSES.items()}
    named = {START: own.start_frame, END: own.end_frame}
    return {end: (frame, offsets[end]) for end, frame in named.items() if frame}


def instants(
    transforms: Transforms,
    frames: dict[str, tuple[str, Offset]],
    fixed: str,
    since: int = 0,
    settled: float = math.inf,
) -> list[int]:
    """Stamps [ns] at which all clamps' poses are known and one of them is updated.

    Empty where nothing moves. A clamp that stays may be told once.

    Args:
        transforms: transforms that join the frames to the board.
        frames: see `clamp_frames`.
        fixed: the board's frame.
        since: stamp [ns] before which none is wanted.
        settled: stamp [ns] from which on what was told once may be told again, where more comes.

    Raises:
        InputError: nothing connects a frame with the board, or they have no time in common.
    """
    series = [s for frame, _ in frames.values() for s in transforms.series(frame, fixed)]
    result: list[int] = []
    for stamp in common_instants(series, since, settled):
        if not result or stamp - result[-1] >= CLOSEST:
            result.append(stamp)
    return result


def command_of(
    transforms: Transforms,
    frames: dict[str, tuple[str, Offset]],
    stamps: list[int],
    settings: Settings,
) -> Command:
    """The command that moves the clamps as the frames move.

    Args:
        transforms: transforms that join the frames to the board.
        frames: see `clamp_frames`, at least one.
        stamps: growing [ns], at least one.
        settings: settings whose `frame_id` is the board.

    Raises:
        InputError: nothing connects a frame with the board.
    """
    places, turns = [], []
    for frame, offset in frames.values():
        rotation, origin = transforms.lookup(frame, settings.frame_id, stamps)
        shift, turn = np.array(offset[:3]), Rotation.from_quat(offset[3:])
        places.append(origin + np.einsum("kij,j->ki", rotation, shift))
        turns.append((Rotation.from_matrix(rotation) * turn).as_quat())
    positions: FloatArray = np.stack(places, axis=1)
    return Command(
        stamp=stamps[0],
        names=tuple(frames),
        times=(np.array(stamps, dtype=np.int64) - stamps[0]) / NANOSECONDS,
        positions=positions,
        rotations=np.stack(turns, axis=1),
        velocities=np.full(positions.shape, np.nan),
        control_points=settings.rod.control_points,
        frame_id=settings.frame_id,
    )


def commands_from_frames(bag: Bag, settings: Settings, skipped: list[str]) -> list[Command]:
    """The commands of a bag with a robot's frames or poses: one, or none.

    Args:
        bag: an open bag.
        settings: settings with `command.source` tf or pose.
        skipped: list to which a line is added for each unusable message.

    Raises:
        CommandError: a frame is not there; what is, and what would mend it.
    """
    transforms, frames = transforms_of(bag), clamp_frames(settings)
    if settings.command.source == "pose":
        for end, topic in POSES.items():
            found = bag.find(topic)
            if not found:
                del frames[end]
            for raw in bag.messages(found):
                try:
                    transforms.add_pose(topic, deserialise(raw))
                except InputError as err:
                    skipped.append(f"{raw.topic} at {raw.stamp / 1e9:.3f} s skipped: {err}")
        usable = {end: f for end, f in frames.items() if f[0] in transforms.parents}
        if not usable:
            wanted = f"command.source is 'pose': {bag.path} has no usable message on"
            last = f" ({skipped[-1]})" if skipped else ""
            raise CommandError(
                f"{wanted} {topics.START_POSE} or {topics.END_POSE}{last}{instead(bag)}"
            )
        frames = usable
    try:
        stamps = instants(transforms, frames, settings.frame_id)
        if len(stamps) > 1:  # a clamp that stays may be told once
            named = ", ".join(frame for frame, _ in frames.values())
            skipped += [*unframed(bag, named, stamps[0], stamps[-1]), *gaps(named, stamps)]
        return [command_of(transforms, frames, stamps or [bag.start], settings)]
    except InputError as err:
        raise CommandError(
            f"{bag.path}: command.source is '{settings.command.source}': {err}{instead(bag)}"
        ) from err


def instead(bag: Bag) -> str:
    """Another mend, of a bag that has its motion as a command, such as one made by `import`."""
    if not bag.holds(topics.COMMAND):
        return ""
    return f"; the bag has its motion on {topics.COMMAND}: for that set command.source to topic"


def gaps(named: str, stamps: list[int]) -> list[str]:
    """A line for each gap between growing stamps [ns] that is longer than `LONGEST_SILENCE`."""
    return [
        f"{named}: no frames for {(after - before) / NANOSECONDS:.1f} s from "
        f"{before / NANOSECONDS:.3f} s on; the motion there is interpolated, record it whole"
        for before, after in pairwise(stamps)
        if after - before > LONGEST_SILENCE
    ]


def unframed(bag: Bag, named: str, first: int, last: int) -> list[str]:
    """A line for each topic that shows the DLO before the first frame, or after the last one.

    Args:
        bag: an open bag.
        named: the frames, for people.
        first: stamp of the first frame [ns].
        last: stamp of the last frame [ns].

    Raises:
        InputError: the DLO is seen at other times alone, as where clocks differ.
    """
    lines = []
    for name, begin, end in seen_spans(bag):
        early, late = first - begin, end - last
        if end < first - LONGEST_SILENCE or begin > last + LONGEST_SILENCE:
            raise InputError(
                f"{name}, {begin / NANOSECONDS:.3f} to {end / NANOSECONDS:.3f} s, lies outside "
                f"the time of {named}, {first / NANOSECONDS:.3f} to {last / NANOSECONDS:.3f} "
                "s; record both together, with clocks that agree"
            )
        for apart, where in ((early, "before the first"), (late, "after the last")):
            if apart > LONGEST_SILENCE:
                lines.append(
                    f"{name}: seen up to {apart / NANOSECONDS:.1f} s {where} frame of {named}; "
                    "the clamps are taken to rest there; record both together"
                )
    return lines
