# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Receiving `dlo/command` with the durability that its publishers offer.

A latched command reaches a late node only through a transient local subscription, which in turn
gets nothing from a publisher that is not latched. So both kinds are held, as publishers ask for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from dlo_ros.command import Command
from dlo_ros.nodes.base import DloNode
from dlo_ros.nodes.messages import message_class
from dlo_ros.recordings import topics
from dlo_ros.recordings.messages import read_command, stamp_of

POLL = 0.2
"""Seconds between two looks at who publishes."""


class CommandSubscription:
    """Well-formed commands of `dlo/command`, each once.

    Args:
        node: which subscribes.
        callback: is given each command; one that is malformed is refused with a warning instead.
    """

    def __init__(self, node: DloNode, callback: Callable[[Command], None]) -> None:
        self._node = node
        self._callback = callback
        self._subscriptions: dict[Any, Any] = {}
        self._seen: deque[tuple[int, int]] = deque(maxlen=64)
        self._early: Any = None
        self._subscribe(DurabilityPolicy.VOLATILE)
        node.every(POLL, self._poll)

    def _poll(self) -> None:
        if self._early is not None and self._node.now():
            message, self._early = self._early, None
            self._take(message)
        endpoints = self._node.get_publishers_info_by_topic(topics.COMMAND)
        wanted = {e.qos_profile.durability for e in endpoints} & {
            DurabilityPolicy.VOLATILE,
            DurabilityPolicy.TRANSIENT_LOCAL,
        } or {DurabilityPolicy.VOLATILE}
        for durability in wanted - set(self._subscriptions):
            self._subscribe(durability)
        for durability in set(self._subscriptions) - wanted:
            self._node.destroy_subscription(self._subscriptions.pop(durability))

    def _subscribe(self, durability: Any) -> None:
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=10,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=durability,
        )
        kind = message_class(topics.TYPES[topics.COMMAND])
        guarded = self._node.guarded(topics.COMMAND, self._receive)

        def receive(message: Any, info: Any) -> None:
            guarded(message, info)

        self._subscriptions[durability] = self._node.create_subscription(
            kind, topics.COMMAND, receive, qos
        )

    def _receive(self, message: Any, info: Any) -> None:
        # The same message through both subscriptions has the same time of sending.
        key = (int(info["source_timestamp"]), stamp_of(message))
        if key in self._seen:
            return
        self._seen.append(key)
        self._take(message)

    def _take(self, message: Any) -> None:
        now = self._node.now()
        if now == 0 and stamp_of(message) == 0:
            # Simulated time has not begun, so the moment of receipt is not known yet.
            self._early = message
            return
        self._callback(read_command(message, self._node.settings, now))
        self._node.health.count("commands")
        self._node.health.solved(topics.COMMAND)
