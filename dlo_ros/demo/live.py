# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The live run: three nodes and a player as processes of their own, and a listener."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from rich.console import Console

from dlo_ros.demo.network import isolate
from dlo_ros.demo.plan import LiveRun
from dlo_ros.demo.processes import Child, Children, ProcessError
from dlo_ros.demo.terminal_progress import Progress
from dlo_ros.file_parameter import NODES
from dlo_ros.nodes.output_monitor import OutputMonitor, monitoring
from dlo_ros.nodes.received_data import ReceivedData

READY_WITHIN = 60.0
"""Seconds that the nodes may take to start and to find each other."""

RATE = 0.5
"""Half speed: an eye can follow, and four processes keep up on two slow cores."""

RATE_IN_SPACE = 0.125
"""Two pictures at a time, and an estimator in space, take two slow cores that much longer."""

QUIET = 1.5
"""Seconds without a message after which everything that was played has been worked off."""

DRAINED_WITHIN = 20.0


def run_live(run: LiveRun, console: Console) -> ReceivedData:
    """Start the nodes, play the recording, listen, end the nodes.

    Raises:
        ProcessError: a node or the player died, or the nodes did not find each other.
    """
    domain = isolate(run.logs)
    arguments = ["--ros-args", "--params-file", str(run.params), "-p", "use_sim_time:=true"]
    with Children(run.logs, os.environ) as children, monitoring(run.settings) as monitor:
        console.print(f"Starting {', '.join(NODES)} (ROS domain {domain}, this machine only)")
        for name in NODES:
            children.start(name, arguments)
        _wait_until_ready(monitor, children)
        rate = RATE_IN_SPACE if run.settings.cameras else RATE
        console.print(
            f"Playing {run.bag}: {run.duration:.1f} s in {run.duration / rate:.1f} s",
            soft_wrap=True,
        )
        player = children.start(
            "play", [str(run.bag), "--rate", str(rate), "--topics", *run.topics]
        )
        with Progress(console, run.duration) as progress:
            _listen(monitor, children, player, progress)
        return monitor.received


def _wait_until_ready(monitor: OutputMonitor, children: Children) -> None:
    deadline = time.monotonic() + READY_WITHIN
    while missing := monitor.missing():
        children.check()
        if time.monotonic() > deadline:
            raise ProcessError(
                f"{' and '.join(missing)} did not appear within {READY_WITHIN:.0f} s; "
                "see the log files beside the output"
            )
        monitor.listen(0.05)


def _listen(monitor: OutputMonitor, children: Children, player: Child, progress: Progress) -> None:
    """Keep listening while the recording plays, and then until nothing more comes."""

    def spin_while(condition: Callable[[], bool]) -> None:
        while condition():
            children.check(player)
            monitor.listen(0.05)
            progress.update(monitor.received)

    spin_while(lambda: player.process.poll() is None)
    last, since = monitor.messages, time.monotonic()
    deadline = since + DRAINED_WITHIN

    def busy() -> bool:
        nonlocal last, since
        now = time.monotonic()
        if monitor.messages != last:
            last, since = monitor.messages, now
        return now < min(since + QUIET, deadline)

    spin_while(busy)
    if not monitor.received.observed:
        raise ProcessError(
            f"nothing was observed while the recording played; observer: "
            f"{monitor.state('observer')}"
        )
    if not monitor.received.err:
        raise ProcessError(
            f"no observed shape could be compared with a simulated one; simulator: "
            f"{monitor.state('simulator')}; identifier: {monitor.state('identifier')}"
        )
