# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Times at which a recording shows the DLO, and those of its commands: clocks that differ."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import InputError, RecordingError
from dlo_ros.recordings import topics
from dlo_ros.recordings.bag import Bag, deserialise
from dlo_ros.recordings.messages import stamp_of


class Span(NamedTuple):
    """The first and the last stamp [ns] of a topic or a file that shows the DLO."""

    name: str
    first: int
    last: int


def seen_spans(bag: Bag) -> list[Span]:
    """Spans of the topics of a bag that show the DLO, in every namespace."""
    spans = []
    for topic in (topics.OBSERVED, topics.COMPRESSED, topics.IMAGE, topics.POINTS):
        for name, both in bag.ends(topic).items():
            try:
                first, last = (stamp_of(deserialise(raw)) for raw in both)
            except InputError:  # told by whoever reads it
                continue
            if last:  # likewise
                spans.append(Span(name, first, last))
    return spans


def check_stamped(bag: Bag, topic: str) -> None:
    """Refuse a topic whose messages have no stamp; simulated time may begin at zero.

    Args:
        bag: an open bag.
        topic: its full name.

    Raises:
        RecordingError: all its messages, of several, have none.
    """
    for first, last in bag.ends(topic.lstrip("/")).values():
        try:
            stamped = any(stamp_of(deserialise(raw)) for raw in (first, last))
        except InputError:  # told by whoever reads it
            continue
        if not stamped and first.stamp != last.stamp:
            raise RecordingError(
                f"{bag.path}: messages on {topic} have no stamp (header.stamp is zero); let their "
                "driver stamp them with the instant that they show, by the clock of the commands"
            )


def unseen_motion(commands: Sequence[Command], spans: Iterable[Span]) -> list[str]:
    """A line for each span that lies wholly before or after the commanded motion.

    The clamps rest there, as is right where the DLO is seen at rest, and wrong where the motion is
    seen by a camera whose clock is not the robot's.

    Args:
        commands: commands by growing stamp.
        spans: where the DLO is seen.
    """
    if not commands or _rests(commands):
        return []
    first, last = commands[0].stamp, max(c.end_stamp for c in commands)
    return [
        f"{span.name}, {span.first / NANOSECONDS:.3f} to {span.last / NANOSECONDS:.3f} s, lies "
        f"wholly {'before' if span.last < first else 'after'} the commanded motion, "
        f"{first / NANOSECONDS:.3f} to {last / NANOSECONDS:.3f} s: the clamps are taken to rest "
        "all the time. If it shows the motion, the clocks differ (by "
        f"{(span.first - first) / NANOSECONDS:.3f} s if both began together); correct the stamps "
        "of one, or record both by one clock"
        for span in spans
        if span.last < first or span.first > last
    ]


def _rests(commands: Sequence[Command]) -> bool:
    """Whether commands impose one pose of the same things all the time."""
    places, turns = commands[0].positions[0], commands[0].rotations[0]
    return all(
        c.names == commands[0].names
        and np.allclose(c.positions, places, rtol=0.0, atol=1e-9)
        and np.allclose(c.rotations, turns, rtol=0.0, atol=1e-9)
        for c in commands
    )
