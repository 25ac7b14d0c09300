# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Subscription to `dlo/command` with the durability and reliability that its publishers offer.

A latched command reaches a late node only through a transient local subscription, which in turn
gets nothing from a publisher that is not latched; a reliable one gets nothing from a publisher that
is best effort. So each kind that is offered is held. Between two subscriptions the executor keeps
no order; here the order of receipt decides.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import product
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.nodes.live_frame_commands import FrameCommands
from dlo_ros.nodes.message_factory import message_class
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.recordings import topics
from dlo_ros.recordings.messages import read_command, stamp_of

DEPTH = 10
LATE = 1_000_000_000
"""Nanoseconds that a command may wait for the executor; more than that, and a clock was set."""
POLL = 0.2
"""Seconds between two looks at who publishes."""
AHEAD = 60.0
"""Seconds ahead of the clock from which the start of a command is more likely another clock's."""

PLAIN = (DurabilityPolicy.VOLATILE, ReliabilityPolicy.RELIABLE)
KINDS = set(
    product(
        (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL),
        (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT),
    )
)
"""Kinds of subscriptions; the plain one is held until somebody publishes."""


class CommandSubscription:
    """Well-formed commands of `dlo/command`, as if each came once and in the order of receipt.

    With `command.source` tf or pose they are made of the robot's frames instead.

    One that the executor hands over too late is followed by those that it was before, once more.

    Args:
        node: node that subscribes.
        callback: function that is called with each command; a malformed one is refused with a
            warning instead.
    """

    def __init__(self, node: DloNode, callback: Callable[[Command], None]) -> None:
        self._node = node
        self._callback = callback
        self._subscriptions: dict[Any, Any] = {}
        self._seen: deque[tuple[int, int]] = deque(maxlen=64)
        self._taken: list[tuple[int, Command]] = []
        self._early: Any = None
        if node.settings.command.source != "topic":
            self._frames = FrameCommands(node, callback)
            return
        self._subscribe(*PLAIN)
        node.every(POLL, self._poll)

    def _poll(self) -> None:
        if self._early is not None and self._node.now():
            (message, received), self._early = self._early, None
            self._take(message, received)
        endpoints = self._node.get_publishers_info_by_topic(topics.COMMAND)
        offered = {(e.qos_profile.durability, e.qos_profile.reliability) for e in endpoints}
        wanted = offered & KINDS or {PLAIN}
        for kind in wanted - set(self._subscriptions):
            self._subscribe(*kind)
        for kind in set(self._subscriptions) - wanted:
            self._node.destroy_subscription(self._subscriptions.pop(kind))

    def _subscribe(self, durability: DurabilityPolicy, reliability: ReliabilityPolicy) -> None:
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=DEPTH,
            reliability=reliability,
            durability=durability,
        )
        kind = message_class(topics.TYPES[topics.COMMAND])
        guarded = self._node.guarded(topics.COMMAND, self._receive)

        def receive(message: Any, info: Any) -> None:
            guarded(message, info)

        self._subscriptions[durability, reliability] = self._node.create_subscription(
            kind,
            topics.COMMAND,
            receive,
            qos,
            # A publisher that this subscription does not match another one will: no reason to warn.
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=lambda _: None),
        )

    def _receive(self, message: Any, info: Any) -> None:
        # The same message through both subscriptions has the same time of sending.
        key = (int(info["source_timestamp"]), stamp_of(message))
        if key in self._seen:
            return
        self._seen.append(key)
        self._take(message, int(info["received_timestamp"]))

    def _take(self, message: Any, received: int) -> None:
        now = self._node.now()
        if now == 0 and stamp_of(message) == 0:
            # Simulated time has not begun, so the moment of receipt is not known yet.
            self._early = message, received
            return
        command = read_command(message, self._node.settings, now)
        near = [(at, c) for at, c in self._taken if abs(at - received) < LATE]
        newer = [c for at, c in near if at > received]
        for each in (command, *newer):
            self._callback(each)
        self._taken = sorted([*near, (received, command)], key=lambda taken: taken[0])[-2 * DEPTH :]
        self._node.health.count("commands")
        self._node.health.solved(topics.COMMAND)
        ahead = (command.stamp - now) / NANOSECONDS
        if now and ahead > AHEAD:
            self._node.health.warn(
                topics.COMMAND,
                f"{topics.COMMAND} begins {ahead:.0f} s ahead of the clock; until then the command "
                "before it holds, or else its first pose. To begin at once leave its stamp zero; "
                "a robot and the nodes need one clock (use_sim_time)",
            )
