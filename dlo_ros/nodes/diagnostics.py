# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A node's status on /diagnostics, and its warnings, which are limited in rate in the log.

The levels are those that rqt_robot_monitor and diagnostic_aggregator expect: OK, the node does its
work; WARN, it waits for something or works with restrictions; ERROR, something failed that should
not; STALE, it worked, but what it works on has stopped coming.
"""

from __future__ import annotations

import math
import re
import time
from collections import Counter
from collections.abc import Collection
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from dlo_ros.command import NANOSECONDS
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.recordings.message_building import LAST_SECOND, header

LATEST = LAST_SECOND * NANOSECONDS
"""The latest time that a message can carry [ns]; a /clock that makes no sense may say more."""

PERIOD = 1.0
"""Seconds between two messages on /diagnostics, where nothing changes much."""

FRESH = 0.1
"""Seconds at least between two messages where the first is out of date."""

CHANGE = 0.2
"""Relative change of a number that is published before its turn: a standard deviation is hardly
known better than that."""

REMEMBERED = 3.0
"""Seconds for which a problem is shown after it last occurred."""

REPEATED = 5.0
"""Seconds before the same warning, numbers in it aside, is logged again."""

DIFFERENT = 4
"""Warnings of a kind that differ in their words and are logged within that time."""

SILENCE = 3.0
"""Seconds without an event that should go on, after which the status is STALE."""

MISSED = 3.0
"""Times the usual interval between two such events that must have passed, too."""

NUMBER = re.compile(r"\d[\d.]*")
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
STALE = DiagnosticStatus.STALE


class Health:
    """State, problems and rates of a node.

    Args:
        node: the node that is described.
        task: the node's task, the second part of the status' name.
        hardware_id: name of the camera or of the DLO: the namespace where there is one.
        steady: the event, as `count` names it, that goes on while the node works.
    """

    def __init__(
        self, node: Node, task: str, hardware_id: str = "dlo", steady: str | None = None
    ) -> None:
        self.values: dict[str, Any] = {}
        self.state: tuple[bytes, str] = (WARN, "starting")
        self.preparing = ""
        self._node = node
        self._task = task
        self.hardware_id = hardware_id
        self._steady = steady
        self._last_event = 0.0
        self._interval = 0.0
        self._problems: dict[str, tuple[float, bytes, str]] = {}
        self._logged: dict[str, dict[str, float]] = {}
        self._counts: Counter[str] = Counter()
        self._before: Counter[str] = Counter()
        self._since = time.monotonic()
        self._published: dict[str, Any] = {}
        self._published_state = self.state
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # Wall time: diagnostics go on where /clock stands still.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD, self.publish, clock=clock)

    def waiting(self, message: str) -> None:
        """Set the status: what is missing before work can begin."""
        self.state = (WARN, f"waiting for {message}")

    def running(self, message: str) -> None:
        """Set the status: all is well."""
        self.state = (OK, message)

    def warn(self, kind: str, message: str) -> None:
        """Report a problem: logged, but at most every five seconds, and in the diagnostics."""
        self._report(kind, message, WARN)

    def error(self, kind: str, message: str) -> None:
        """Report a failure in the same way."""
        self._report(kind, message, ERROR)

    def solved(self, kind: str) -> None:
        """Clear a problem that is over."""
        self._problems.pop(kind, None)

    def count(self, what: str) -> None:
        """Count an event; its total and its rate are shown."""
        self._counts[what] += 1
        if what == self._steady:
            now = time.monotonic()
            self._interval = now - self._last_event if self._last_event else 0.0
            self._last_event = now

    def refresh(self, keys: Collection[str]) -> None:
        """Publish the status out of turn where it or one of the named values has changed."""
        if time.monotonic() - self._since < FRESH:
            return
        changed = any(differ(self.values.get(key), self._published.get(key)) for key in keys)
        if changed or self.state != self._published_state:
            self.publish()

    def publish(self) -> None:
        """Publish the status; called by a timer."""
        now = time.monotonic()
        problems = [p for p in self._problems.values() if now - p[0] < REMEMBERED]
        level, message = self.state
        silent = now - self._last_event if self._last_event else 0.0
        if level == OK and silent > max(SILENCE, MISSED * self._interval):
            level, message = STALE, f"no {self._steady} for {silent:.0f} s"
        if problems:
            level = ERROR if any(p[1] == ERROR for p in problems) else WARN
            message = max(problems)[2]
        if self.preparing:  # before that is over, nothing else matters
            level, message = WARN, self.preparing
        elapsed = max(now - self._since, 1e-3)
        values = {key: show(value) for key, value in self.values.items()}
        for what, total in sorted(self._counts.items()):
            values[what] = str(total)
            values[f"{what} [Hz]"] = f"{(total - self._before[what]) / elapsed:.1f}"
        self._before, self._since = self._counts.copy(), now
        self._published, self._published_state = dict(self.values), self.state
        status = DiagnosticStatus(
            level=level,
            name=f"{self._node.get_fully_qualified_name().lstrip('/')}: {self._task}",
            message=message,
            hardware_id=self.hardware_id,
            values=[KeyValue(key=k, value=v) for k, v in values.items()],
        )
        array = DiagnosticArray(status=[status])
        now_ros = int(self._node.get_clock().now().nanoseconds)
        array.header.stamp = header(ROS_MESSAGES, min(now_ros, LATEST), "").stamp
        self._publisher.publish(array)

    def _report(self, kind: str, message: str, level: bytes) -> None:
        now = time.monotonic()
        self._problems[kind] = (now, level, message)
        self._counts[f"problems: {kind}"] += 1
        logged = {w: t for w, t in self._logged.get(kind, {}).items() if now - t < REPEATED}
        self._logged[kind] = logged
        words = NUMBER.sub("#", message)
        if words not in logged and len(logged) < DIFFERENT:
            logged[words] = now
            # rclpy refuses one place in the code that logs with two severities.
            if level == ERROR:
                self._node.get_logger().error(message)
            else:
                self._node.get_logger().warning(message)


def differ(value: Any, before: Any) -> bool:
    """Whether a value has changed so much that a message of its own is due."""
    if isinstance(value, float) and isinstance(before, float):
        if not (math.isfinite(value) and math.isfinite(before)):
            return str(value) != str(before)
        return abs(value - before) > CHANGE * max(abs(value), abs(before))
    return bool(value != before)


def show(value: Any) -> str:
    """A value as text for people; numbers that are unknown or unbounded as a dash."""
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "-" if value is None else str(value)
