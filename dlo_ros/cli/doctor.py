# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`doctor`: checks of the installation, the ROS graph and parameters, in one page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from dlo_ros import __version__
from dlo_ros.doctor import environment, installation
from dlo_ros.doctor.finding import Finding, Level, page, warning, worst, wrong
from dlo_ros.errors import EXIT_DONE, EXIT_FAILED, InputError, KernelError

if TYPE_CHECKING:
    from dlo_ros.doctor.graph import Graph
    from dlo_ros.parameters import Settings

SECONDS = 5.0
"""Seconds of looking at the graph: discovery may take three, diagnostics come once a second."""

MOST_SECONDS = 600.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the tool's arguments."""
    parser.add_argument(
        "--params", type=Path, metavar="FILE", help="parameter file that is judged, too"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=SECONDS,
        metavar="S",
        help=f"how long to listen to what runs (default {SECONDS:g}); 0: not at all",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the page.

    Returns:
        The exit status: 0, or 1 where something is wrong.

    Raises:
        InputError: an argument is unusable.
    """
    if not 0.0 <= arguments.seconds <= MOST_SECONDS:
        raise InputError(
            f"--seconds is {arguments.seconds:g}; give seconds from 0 to {MOST_SECONDS:g}"
        )
    sections = examine(arguments.params, arguments.seconds)
    print(page(f"dlo_ros {__version__} doctor", sections))
    level = worst(finding for section in sections.values() for finding in section)
    return EXIT_FAILED if level == Level.WRONG else EXIT_DONE


def examine(params: Path | None, seconds: float) -> dict[str, list[Finding]]:
    """All findings by the section that they stand in.

    Args:
        params: parameter file, None for none.
        seconds: time for which the graph is watched [s]; 0: not at all.
    """
    sections = {
        "Installed": installation.installed(__version__),
        "Compiled kernels": installation.kernels(),
        "Network": [*environment.network(), *environment.shared_memory()],
    }
    settings = None
    if params is not None:
        from dlo_ros.doctor.parameter_check import judge_file

        sections["Parameters"], settings = judge_file(params)
    if seconds > 0.0:
        sections |= _listen(seconds, settings)
    return sections


def _listen(seconds: float, settings: Settings | None) -> dict[str, list[Finding]]:
    """Findings about the ROS graph; a single one where it cannot be observed."""
    try:
        from dlo_ros.nodes.graph_watch import watch

        return judge(watch(seconds), settings)
    except ModuleNotFoundError as err:
        return {"ROS graph": [warning(f"the ROS graph cannot be observed without {err.name}")]}
    except KernelError as err:
        return {"ROS graph": [warning(f"the ROS graph cannot be observed: {err}")]}
    except Exception as err:  # the middleware fails in many ways, with exceptions of its own
        if isinstance(err, (InputError, OSError)):
            raise
        return {
            "ROS graph": [
                wrong(
                    f"ROS does not start: {' '.join(str(err).split())}",
                    "see the remedies above, under Network",
                )
            ]
        }


def judge(graph: Graph, settings: Settings | None) -> dict[str, list[Finding]]:
    """Findings about what was seen of the graph, by section.

    Args:
        graph: the ROS graph as it was seen.
        settings: parameter file that the nodes should go by, None for none.
    """
    from dlo_ros.doctor.connections import connections
    from dlo_ros.doctor.node_states import nodes
    from dlo_ros.doctor.times_and_frames import clocks, frames

    return {
        "Nodes": nodes(graph, settings),
        "Topics": connections(graph),
        "Clock and frames": [*clocks(graph), *frames(graph, settings)],
    }
