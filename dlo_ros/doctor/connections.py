# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Topics: who publishes, who listens, with which type and which quality of service."""

from __future__ import annotations

from collections.abc import Iterable

from dlo_ros.doctor.finding import Finding, ok, warning, wrong
from dlo_ros.doctor.graph import Endpoint, Graph
from dlo_ros.recordings import topics

INTERFACE_PREFIX = "dlo/"
"""Topics whose names are the interface's alone; `image_raw` may be any camera's."""

SINGLE_PUBLISHER_TOPICS = (topics.OBSERVED, topics.PREDICTED)
"""Topics with one publisher for each DLO: of two, every other shape is another's."""

OVERLAYS = (topics.OVERLAY, topics.MASK)
"""Images that no camera takes."""

DEPTH = "depth"
"""Part of the names of depth images, which are no help where the picture is wanted."""


def connections(graph: Graph) -> list[Finding]:
    """Findings about all topics that were seen."""
    seen = {name: ends for name, ends in graph.topics.items() if ends}
    if not seen:
        return [
            warning(
                f"no topic of the interface was seen within {graph.seconds:g} s",
                "start the nodes or the camera; if they run: the same ROS_DOMAIN_ID, discovery "
                "range and middleware here and there?",
            )
        ]
    bad = [finding for name in sorted(seen) for finding in _topic(graph, name)]
    return [*_seen(seen), *bad]


def _seen(seen: dict[str, tuple[Endpoint, ...]]) -> list[Finding]:
    """The topics of the interface with their numbers of publishers and subscriptions, in a line."""
    counts = (
        f"{name} {sum(e.publishes for e in ends)}/{sum(not e.publishes for e in ends)}"
        for name, ends in sorted(seen.items())
        if topics.relative(name)
    )
    text = ", ".join(counts)
    return [ok(f"publishers/subscriptions: {text}")] if text else []


def _topic(graph: Graph, name: str) -> list[Finding]:
    ends = graph.topics[name]
    found = _types(name, ends)
    if not found:  # of other types nothing is exchanged anyway
        found = quality(name, ends)
    return [*found, *_alone(graph, name), *_several(graph, name), *_fleeting(name, ends)]


def _types(name: str, ends: Iterable[Endpoint]) -> list[Finding]:
    own = topics.relative(name)
    expected = topics.TYPES.get(own) if own else None
    kinds = {e.kind: e for e in ends}
    if expected is not None:
        judge = wrong if own and own.startswith(INTERFACE_PREFIX) else warning
        return [
            judge(f"{name} of {end.node} is {kind}", f"it must be {expected}")
            for kind, end in sorted(kinds.items())
            if kind != expected
        ]
    if len(kinds) > 1:
        who = ", ".join(f"{end.node}: {kind}" for kind, end in sorted(kinds.items()))
        return [wrong(f"{name} has several types ({who})", "remap one of them to another name")]
    return []


def quality(name: str, ends: Iterable[Endpoint]) -> list[Finding]:
    """Pairs of a publisher and a subscription that never exchange a message.

    Args:
        name: name of the topic.
        ends: the topic's publishers and subscriptions.
    """
    ends = list(ends)
    found = []
    for sender in (e for e in ends if e.publishes):
        for listener in (e for e in ends if not e.publishes):
            pair = f"{name}: {listener.node} receives nothing from {sender.node}"
            parameter = f"qos_overrides.{name}"
            if listener.reliable and not sender.reliable:
                found.append(
                    wrong(
                        f"{pair}: the publisher is best effort, the subscription asks for reliable",
                        f"publish reliably, or {parameter}.subscription.reliability:=best_effort",
                    )
                )
            if listener.latched and not sender.latched:
                found.append(
                    wrong(
                        f"{pair}: the publisher is volatile, the subscription asks for transient "
                        "local",
                        "publish transient local (ros2 topic pub --qos-durability transient_local),"
                        f" or {parameter}.subscription.durability:=volatile",
                    )
                )
    return found


def _alone(graph: Graph, name: str) -> list[Finding]:
    """A subscription of one of the nodes to images that are published under another name."""
    own = topics.relative(name)
    ours = {node.name for node in graph.nodes}
    listeners = [e.node for e in graph.subscriptions(name) if e.node in ours]
    if own not in (topics.IMAGE, topics.COMPRESSED) or not listeners or graph.publishers(name):
        return []
    cameras = (n for n in graph.images if n != name and topics.relative(n) not in OVERLAYS)
    others = sorted(cameras, key=lambda n: (DEPTH in n, n))
    if not others:
        return []
    raw = others[0].removesuffix("/compressed")
    base = name.removesuffix("/compressed")
    return [
        wrong(
            f"{listeners[0]} listens to {name}, which nobody publishes; there is {others[0]}",
            f"--ros-args -r {base}:={raw}, or image:={raw} of dlo.launch.py, and its camera_info",
        )
    ]


def _several(graph: Graph, name: str) -> list[Finding]:
    senders = sorted(e.node for e in graph.publishers(name))
    if topics.relative(name) not in SINGLE_PUBLISHER_TOPICS or len(senders) < 2:
        return []
    return [
        wrong(
            f"{name} has {len(senders)} publishers ({', '.join(senders)})",
            "end all but one; a second DLO has a namespace of its own, a played bag leaves out "
            "what the nodes make",
        )
    ]


def _fleeting(name: str, ends: Iterable[Endpoint]) -> list[Finding]:
    """Commands that a node which starts later does not hear."""
    if not topics.is_topic(name, topics.COMMAND):
        return []
    return [
        warning(
            f"{name} of {e.node} is not latched: a node that starts later never receives it",
            "publish it transient local (ros2 topic pub --qos-durability transient_local)",
        )
        for e in ends
        if e.publishes and not e.latched
    ]
