# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A player that publishes a recording's messages, with /clock."""

from __future__ import annotations

import math
import queue
import re
import threading
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import InputError
from dlo_ros.nodes import qos
from dlo_ros.nodes.listeners import Listeners
from dlo_ros.nodes.message_factory import message_class
from dlo_ros.nodes.runtime import Stop, ros
from dlo_ros.recordings import topics
from dlo_ros.recordings.playback import Playlist, ScheduledMessage

CLOCK_PERIOD = 0.01
"""Seconds of wall time between two /clock messages."""

READ_AHEAD = 24
"""Messages that are read before they are due, so that unpacking delays none."""

APPEAR = 30.0
"""Seconds to wait at most for the first subscriber: on a busy machine a node is there after ten."""

DISCOVERY = 5.0
"""Seconds in which discovery ends: DDS repeats a lost announcement after three."""

COMPLETE = 4.0
"""Seconds to wait at most, after the first subscriber, for those of the other topics."""

SETTLED = 3.2
"""Seconds without a new subscriber after which the graph counts as complete.

Discovery that loses one message goes on three seconds later. Who is found only then would miss the
beginning, and a simulation that begins late begins in the wrong state.
"""

REMINDER_INTERVAL = 10.0
"""Seconds before it is said again what is waited for, where that has not changed."""

STATE_INTERVAL = 2.0
"""Seconds at least between two such lines, however often the state changes; numbers in it aside."""

LISTEN_PERIOD = 0.02
"""Seconds between two looks at who is there, and two /clock messages meanwhile."""

RUN_OUT = 0.25
"""Seconds of the recording that /clock goes on for, so that the last message is worked off."""


class Player:
    """Plays a playlist on live topics.

    Args:
        node: node that publishes.
        playlist: messages and their speed.
        clock: whether /clock is published, too.
    """

    def __init__(self, node: Node, playlist: Playlist, *, clock: bool = True) -> None:
        self._node = node
        self._playlist = playlist
        self._publishers: dict[str, Any] = {}
        for topic, kind in playlist.topics:
            # Reliable offers match every subscription; what was latched reaches late ones, too.
            profile = qos.LATCHED if topic in playlist.latched else qos.RELIABLE
            profile = qos.FIXED_TRANSFORMS if topic == topics.TRANSFORMS else profile
            self._publishers[topic] = node.create_publisher(message_class(kind), topic, profile)
        self._clock = node.create_publisher(Clock, "/clock", qos.CLOCK) if clock else None
        self._ticked = -math.inf
        self.latest = 0.0
        self.published = 0

    def wait_for_listeners(self, stop: Stop, patience: float, awaited: Collection[str]) -> None:
        """Wait until nodes listen and those of this package are ready to take data.

        Nodes of others, which say nothing of being ready, are given the time of DDS's discovery:
        until each topic has a subscriber or no new ones come.

        Args:
            stop: ends the waiting.
            patience: longest time to wait [s]; 0 does not wait.
            awaited: names of nodes that must be ready, relative to the player's namespace.

        Raises:
            InputError: nobody listens, or a node is not ready in time.
        """
        names = [p.topic_name for p in self._publishers.values()]
        listeners = Listeners(self._node, names, awaited)
        try:
            self._wait_for(listeners, stop, patience)
        finally:
            listeners.close()
        if self._clock is not None and self._node.count_publishers(self._clock.topic_name) > 1:
            self._node.get_logger().warning(
                f"another process publishes {self._clock.topic_name}, too, so that time jumps: "
                "give --no-clock, or each a clock of its own (--ros-args -r /clock:=/left/clock)"
            )
        unheard = [n for n, count in self._matched().items() if not count]
        if unheard and not stop.requested:
            self._node.get_logger().warning(f"nobody listens to {', '.join(unheard)} yet")

    def _wait_for(self, listeners: Listeners, stop: Stop, patience: float) -> None:
        began = time.monotonic()
        report = Report(self._node)
        idle = changed = began  # since when nobody is waited for; last change of who listens
        first: float | None = None  # when the first subscriber was found
        before: dict[str, int] = {}
        while not stop.requested and patience > 0.0:
            # Nodes on simulated time need a time before the first message.
            self._tick(0.0)
            listeners.update(LISTEN_PERIOD)
            now, matched = time.monotonic(), self._matched()
            if matched != before:
                before, changed = matched, now
            first = None if not any(matched.values()) else now if first is None else first
            if pending := listeners.pending():
                idle = now
                if now - began > patience:
                    raise InputError(
                        f"waited {patience:g} s in vain for {states_text(pending)}; "
                        "--wait SECONDS gives more time"
                    )
                report.say(pending)
            elif first is None:
                if now - idle > min(APPEAR, patience):
                    raise InputError(no_subscriber_message(matched, patience))
                report.say({"a node": "nobody listens yet"})
            else:
                settled = now - changed > SETTLED or now - first > COMPLETE + DISCOVERY
                if settled and (all(matched.values()) or now - first > COMPLETE):
                    return

    def _matched(self) -> dict[str, int]:
        """Number of subscribers of each topic, by its full name."""
        return {p.topic_name: p.get_subscription_count() for p in self._publishers.values()}

    def play(self, stop: Stop) -> None:
        """Publish all messages once, each when it is due.

        Raises:
            RecordingError: the bag is damaged.
        """
        began = time.monotonic()
        self._tick(0.0)
        with _ReadAhead(self._playlist) as messages:
            for due in messages:
                self._wait(began, due.after, stop)
                if stop.requested:
                    return
                self._publishers[due.message.topic].publish(due.message.data)
                self.published += 1
                self.latest = max(self.latest, time.monotonic() - began - due.after)
        self._wait(began, self._playlist.duration, stop)
        self._ticked = -math.inf  # the next pass begins with a tick, however short this one was

    def run_out(self, stop: Stop) -> None:
        """Let /clock run on a little and wait until reliable subscribers have everything."""
        began, length = time.monotonic(), self._playlist.duration
        self._wait(began - length, length + RUN_OUT / self._playlist.rate, stop)
        for publisher in self._publishers.values():
            if not stop.requested:
                publisher.wait_for_all_acked(Duration(seconds=1))

    def _wait(self, began: float, after: float, stop: Stop) -> None:
        """Wait until `after` seconds after the beginning, keeping the clock going."""
        while not stop.requested:
            elapsed = time.monotonic() - began
            if elapsed >= after:
                self._tick(after)
                return
            self._tick(elapsed)
            time.sleep(min(after - elapsed, CLOCK_PERIOD))

    def _tick(self, after: float) -> None:
        now = time.monotonic()
        if self._clock is not None and now - self._ticked >= 0.9 * CLOCK_PERIOD:
            self._ticked = now
            seconds, nanoseconds = divmod(self._playlist.time_at(after), NANOSECONDS)
            self._clock.publish(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))


NUMBER = re.compile(r"(, about )?\d+( [%s])?")
"""What changes all the time in the state of a node that compiles."""


class Report:
    """Logs what the player waits for, on every change and now and then between."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._last = ""
        self._at = -math.inf

    def say(self, pending: Mapping[str, str]) -> None:
        """Log it at INFO, unless that was just done."""
        text, now = f"waiting for {states_text(pending)}", time.monotonic()
        kind = NUMBER.sub("", text)
        if now - self._at > (STATE_INTERVAL if kind != self._last else REMINDER_INTERVAL):
            self._last, self._at = kind, now
            self._node.get_logger().info(text)


def no_subscriber_message(topics: Collection[str], patience: float) -> str:
    """The message where no topic has a subscriber after `patience` [s], of which `APPEAR` count."""
    more = ", or give more time with --wait SECONDS" if patience < APPEAR else ""
    return (
        f"nobody listens to {', '.join(topics)}; start the nodes, with use_sim_time:=true, "
        f"in the same domain and namespace{more}"
    )


def states_text(pending: Mapping[str, str]) -> str:
    """Nodes and their states as text, such as `observer (compiling, 40 %)`."""
    return ", ".join(f"{name.lstrip('/')} ({state})" for name, state in pending.items())


def play(
    playlist: Playlist,
    *,
    loop: bool = False,
    clock: bool = True,
    patience: float = APPEAR,
    awaited: Collection[str] = (),
    arguments: Sequence[str] = (),
) -> int:
    """Play until the end, or again and again until Ctrl-C.

    Args:
        playlist: the messages and the rate at which they are played.
        loop: whether to begin again at the end.
        clock: whether /clock is published, too.
        patience: seconds to wait at most for nodes that listen and are ready; 0 does not wait.
        awaited: names of nodes that must be ready, relative to the player's namespace.
        arguments: ROS arguments.

    Returns:
        Exit status 0.

    Raises:
        RecordingError: the bag is damaged.
        InputError: nobody listens, or a node is not ready in time.
    """
    with ros(arguments, interrupts=False) as stop:
        # Nobody would answer those services: the player only publishes.
        node = Node("player", start_parameter_services=False)
        try:
            player = Player(node, playlist, clock=clock)
            stop.building = False
            player.wait_for_listeners(stop, patience, awaited)
            player.play(stop)
            while loop and not stop.requested:
                player.play(stop)
            player.run_out(stop)
            node.get_logger().info(
                f"{player.published} messages, at worst {1000.0 * player.latest:.1f} ms late"
            )
        finally:
            node.destroy_node()
    return 0


class _ReadAhead:
    """Iterates over a playlist's messages, read by a thread some messages ahead."""

    def __init__(self, playlist: Playlist) -> None:
        self._playlist = playlist
        self._queue: queue.Queue[ScheduledMessage | Exception | None] = queue.Queue(READ_AHEAD)
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._read, name="reader", daemon=True)

    def __enter__(self) -> Iterator[ScheduledMessage]:
        self._thread.start()
        return self._messages()

    def __exit__(self, *error: object) -> None:
        self._left.set()
        self._thread.join(timeout=5.0)

    def _messages(self) -> Iterator[ScheduledMessage]:
        while (item := self._queue.get()) is not None:
            if isinstance(item, Exception):
                raise item
            yield item

    def _read(self) -> None:
        try:
            for due in self._playlist.messages():
                if not self._put(due):
                    return
            self._put(None)
        except Exception as err:  # raised again in the thread that plays
            self._put(err)

    def _put(self, item: ScheduledMessage | Exception | None) -> bool:
        while not self._left.is_set():
            try:
                self._queue.put(item, timeout=0.1)
            except queue.Full:
                continue
            return True
        return False
