# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The live run: three nodes and a player as processes of their own, and a listener."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence

from rich.console import Console

from dlo_ros.demo.network import isolate
from dlo_ros.demo.outcome import in_time
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

DRAINED_WITHIN = 120.0
"""Seconds that the nodes may need to work off what was played, on a machine that is busy."""

PASSES = 3
"""Times that the recording is played at most, until the simulator has the estimate in time."""


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
        words = [str(run.bag), "--rate", str(rate), "--topics", *run.topics]
        players: list[Child] = []
        while True:
            players.append(children.start("play", words))
            with Progress(console, run.duration) as progress:
                _listen(monitor, children, players, progress)
            received: ReceivedData = monitor.received
            if received.passes == PASSES or in_time(received, run.settings.rod.length):
                return received
            console.print(
                "This machine is busy: the simulator did not have the estimate in time. Playing "
                "the recording again",
                soft_wrap=True,
            )
            monitor.begin_again()


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


def _listen(
    monitor: OutputMonitor, children: Children, players: Sequence[Child], progress: Progress
) -> None:
    """Keep listening while the recording plays, and then until all of it has been worked off.

    Args:
        monitor: the listener.
        children: the nodes and the players.
        players: the players so far, of which the last one plays.
        progress: display of the state.
    """

    def spin_while(condition: Callable[[], bool]) -> None:
        while condition():
            children.check(*players)
            monitor.listen(0.05)
            progress.update(monitor.received)

    spin_while(lambda: players[-1].process.poll() is None)
    last, since = monitor.messages, time.monotonic()
    deadline = since + DRAINED_WITHIN

    def busy() -> bool:
        nonlocal last, since
        now = time.monotonic()
        if monitor.messages != last or monitor.received.waiting:
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
