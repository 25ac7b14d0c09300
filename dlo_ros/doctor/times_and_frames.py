# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Agreement of clocks, stamps and frames between nodes, messages and the parameter file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dlo_ros.doctor.finding import Finding, ok, warning, wrong
from dlo_ros.doctor.graph import Graph
from dlo_ros.recordings import topics

if TYPE_CHECKING:
    from dlo_ros.parameters import Settings

PAST = 10.0
"""Seconds behind the clock from which a stamp is another clock's; no camera is that slow."""

CLOCK = "/clock"
LASTING = (topics.COMMAND, topics.REHEARSAL, topics.REHEARSAL_COMMAND)
"""Topics whose stamps may be old, or to come."""

SHAPES = (topics.OBSERVED, topics.PREDICTED)
TRANSFORMED = (topics.OBSERVED, topics.PREDICTED, topics.OBSERVED_POINTS, topics.COMMAND)
"""Topics whose messages are in `frame_id`."""


def clocks(graph: Graph) -> list[Finding]:
    """Findings about /clock and who follows it, and about stamps."""
    followers = [n.name for n in graph.nodes if n.parameters.get("use_sim_time") is True]
    others = [n.name for n in graph.nodes if n.parameters.get("use_sim_time") is False]
    found = []
    for topic, (first, last) in sorted(graph.clock.items()):
        players = sorted({e.node for e in graph.publishers(topic)})
        if len(players) > 1:
            found.append(
                wrong(
                    f"{topic} has {len(players)} publishers ({', '.join(players)}): time jumps",
                    "start all but one with --no-clock, or give each a clock and a namespace",
                )
            )
        elif last <= first:
            found.append(warning(f"{topic} stands still at {last:.3f} s", "is the player paused?"))
        else:
            found.append(ok(f"{topic} runs, {(last - first) / graph.seconds:.2g} times real time"))
    if followers and not graph.clock:
        found.append(
            wrong(
                f"{', '.join(followers)} with use_sim_time, but no clock is received: time stands "
                "still there",
                "play the recording with /clock (dlo_ros play, ros2 bag play --clock 100), or "
                "use_sim_time:=false with a camera",
            )
        )
    if CLOCK in graph.clock and others:
        found.append(
            wrong(
                f"{', '.join(others)} without use_sim_time, though {CLOCK} is published",
                "start with -p use_sim_time:=true where a recording is played",
            )
        )
    if not followers and not graph.clock:
        found.append(ok("system time, no /clock"))
    return [*found, *_stamps(graph)]


def _stamps(graph: Graph) -> list[Finding]:
    found = []
    for name, header in sorted(graph.headers.items()):
        late = header.clock - header.stamp
        if any(topics.is_topic(name, topic) for topic in LASTING) or not header.clock:
            continue
        if late < -topics.FUTURE:
            found.append(
                wrong(
                    f"{name} is stamped {-late:.1f} s ahead of the clock; nodes refuse it",
                    "with a recording: use_sim_time and /clock; with several computers: chrony",
                )
            )
        elif late > PAST:
            found.append(
                warning(
                    f"{name} is stamped {late:.1f} s behind the clock",
                    "with a recording: use_sim_time and /clock; with a camera: does its driver "
                    "stamp by the system's time?",
                )
            )
    return found


def frames(graph: Graph, settings: Settings | None = None) -> list[Finding]:
    """Findings about frames, and about the bases of shapes.

    Args:
        graph: the ROS graph as it was seen.
        settings: the parameter file, where there is one; otherwise the nodes' own parameters are
            taken.
    """
    fixed = _setting(graph, settings, "frame_id")
    count = _setting(graph, settings, "rod.control_points")
    found = []
    for name, header in sorted(graph.headers.items()):
        own = topics.relative(name)
        if own in TRANSFORMED and fixed and header.frame not in ("", fixed):
            found.append(
                wrong(
                    f"{name} is in the frame '{header.frame}', frame_id is '{fixed}'",
                    "publish it in that frame, or change frame_id; shapes are not transformed",
                )
            )
        if own in SHAPES and count and header.poses not in (None, count):
            found.append(
                wrong(
                    f"{name} has {header.poses} control points, rod.control_points is {count}",
                    "give its publisher and all nodes the same parameter file",
                )
            )
    if not found and graph.headers and fixed:
        found.append(ok(f"shapes and commands are in '{fixed}'"))
    if graph.frames and fixed and fixed not in graph.frames:
        found.append(
            warning(
                f"frame_id '{fixed}' is in no transform of /tf and /tf_static, which have "
                f"{', '.join(sorted(graph.frames)[:5])}",
                "the observer publishes it (publish_tf) once it receives camera_info; or name "
                "another frame",
            )
        )
    return found


def _setting(graph: Graph, settings: Settings | None, name: str) -> str | int | None:
    """A parameter of the file, or of all nodes where they agree."""
    if settings is not None:
        value = settings.flat()[name]
    else:
        values = {n.parameters[name] for n in graph.nodes if n.parameters.get(name) is not None}
        value = values.pop() if len(values) == 1 else None  # type: ignore[assignment]
    return value if isinstance(value, (str, int)) else None
