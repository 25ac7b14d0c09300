# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The package's nodes: readiness, status, and agreement of their parameters."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from dlo_ros.doctor.finding import Finding, ok, warning, wrong
from dlo_ros.doctor.graph import WATCHED, Graph, NodeState

if TYPE_CHECKING:
    from dlo_ros.parameters import Settings

OK, WARN, ERROR = 0, 1, 2
"""Levels of a diagnostics status; STALE is 3."""


def nodes(graph: Graph, settings: Settings | None = None) -> list[Finding]:
    """Findings about each node, and about those of one namespace together.

    Args:
        graph: the ROS graph as it was seen.
        settings: parameter file that the nodes should go by, None for none.
    """
    if not graph.nodes:
        return [
            warning(
                f"no node of dlo_ros was seen within {graph.seconds:g} s",
                "ros2 launch dlo_ros dlo.launch.py, or dlo_ros observer, simulator, identifier",
            )
        ]
    by_name = sorted(graph.nodes, key=lambda n: n.name)
    found = [_state(node) for node in by_name]
    for _, group in groupby(by_name, key=lambda n: n.namespace):
        found += _disagreement(list(group), settings)
    return found


def _state(node: NodeState) -> Finding:
    said = f"{node.name}: {node.message or 'no word on /diagnostics'}"
    if node.ready is False:
        return warning(f"{node.name} is not ready: {node.message or 'it starts'}", "wait for it")
    if node.level is None:
        if node.ready:
            return warning(f"{said}, though it is ready", "look at what it prints")
        return wrong(said, "it hangs, or was killed a moment ago: look at what it prints")
    if node.level == OK:
        return ok(said)
    if node.level == ERROR:
        return wrong(said, "look at what it prints")
    return warning(said)


def _disagreement(group: Sequence[NodeState], settings: Settings | None) -> list[Finding]:
    """Parameters that differ between the nodes of one DLO, or from the parameter file."""
    found = []
    stated = {} if settings is None else settings.flat()
    for name in WATCHED:
        values = {n.name: n.parameters[name] for n in group if name in n.parameters}
        if len(set(values.values())) > 1:
            who = ", ".join(f"{node}: {value}" for node, value in values.items())
            found.append(
                wrong(f"{name} differs ({who})", "start all nodes with the same parameter file")
            )
        elif values and name in stated and stated[name] not in values.values():
            found.append(
                warning(
                    f"{name} is {next(iter(values.values()))} in {', '.join(values)}, "
                    f"{stated[name]} in the parameter file",
                    "start the nodes with that file, or another namespace is meant",
                )
            )
    return found
