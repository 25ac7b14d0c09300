# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The base of the three nodes: settings, health, guarded callbacks, reset, time jumps."""

from __future__ import annotations

import math
import os
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from typing import Any

from rclpy.clock import Clock, ClockChange, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import DloError, InputError, KernelError, ParameterError
from dlo_ros.nodes import qos as profiles
from dlo_ros.nodes.declared_parameters import LiveSettings, declare
from dlo_ros.nodes.diagnostics import Health
from dlo_ros.nodes.kernel_preparation import Preparation
from dlo_ros.nodes.message_factory import installed, message_class
from dlo_ros.nodes.playback_passes import PlaybackPasses
from dlo_ros.parameters import Settings
from dlo_ros.recordings import topics

PROGRESS = 0.2
"""Seconds between two looks at whether the kernels are compiled and loaded."""

JUMP_BACK = 0.5
"""Seconds that time must go back to count as a restart; less is messages out of order."""


def latest(now: int) -> float:
    """Stamp [ns] beyond which a message is of another clock; `now` is zero where none has begun."""
    return now + topics.FUTURE * NANOSECONDS if now else math.inf


class DloNode(Node, ABC):
    """Base of the nodes.

    Args:
        name: observer, simulator or identifier.
        task: the node's task, for the diagnostics.
        steady: name of the work that the node repeats and counts, for the diagnostics.

    Raises:
        ParameterError: a parameter is missing or unusable.
    """

    failure: DloError | None = None
    """Why the node cannot go on."""

    def __init__(self, name: str, task: str, steady: str, **options: Any) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **options)
        settings = declare(self, name)
        self.health = Health(self, task, self.get_namespace().strip("/") or "dlo", steady)
        self._live = LiveSettings(self, settings, self._settings_changed, self.check_settings)
        self._preparation: Preparation | None = None
        self._passes = PlaybackPasses()
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_service(Trigger, "~/reset", self._on_reset)
        threshold = JumpThreshold(
            min_forward=None, min_backward=Duration(seconds=-JUMP_BACK), on_clock_change=True
        )
        self._jumps = self.get_clock().create_jump_callback(
            threshold, post_callback=self.guarded("time", self._on_jump)
        )

    @property
    def settings(self) -> Settings:
        """The parameters as they are now."""
        return self._live.current

    @property
    def ready(self) -> bool:
        """Whether the node takes data."""
        return self._preparation is not None and self._preparation.done

    def prepare(self, stages: Sequence[str], load: Callable[[], object]) -> None:
        """Compile and load kernels while the node answers; then call `begin`.

        Args:
            stages: names in `dlo_ros.compilation.STAGES`.
            load: function that returns when the compiled kernels are loaded.

        Raises:
            KernelError: see `Preparation`.
        """
        preparation = self._preparation = Preparation(self, stages, load)
        self.health.preparing = preparation.state

        def proceed() -> None:
            if preparation.proceed():
                self.health.preparing = ""
                self.destroy_timer(timer)
                self.begin()
                preparation.announce(self.health.state[1])
                self.health.publish()
                return
            self.health.preparing = preparation.state
            if preparation.error:
                self.failure = KernelError(preparation.error)

        timer = self.every(PROGRESS, proceed)

    @abstractmethod
    def begin(self) -> None:
        """Start the work; the kernels are loaded."""

    def destroy_node(self) -> None:
        """Leave the graph."""
        if self._preparation is not None:
            self._preparation.stop()
        super().destroy_node()

    @abstractmethod
    def reset(self) -> None:
        """Forget what was received and start afresh."""

    @abstractmethod
    def restart(self, now: int) -> None:
        """Time went back to `now` [ns]: forget everything later."""

    @abstractmethod
    def apply(self, settings: Settings) -> None:
        """Take changed parameters over."""

    def check_settings(self, settings: Settings) -> None:
        """Refuse changed parameters that cannot be used, beyond what their ranges say.

        Raises:
            DloError: which one, and what it must be; nothing is changed then.
        """

    def now(self) -> int:
        """ROS time [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def check_stamp(self, stamp: int, what: str) -> None:
        """Refuse what claims to come from the future, since it would make all else look old.

        Raises:
            InputError: the stamp [ns] lies too far ahead of the clock, or is none.
        """
        now = self.now()
        ahead = (stamp - now) / NANOSECONDS
        if not stamp and -ahead > topics.FUTURE:  # simulated time may begin at zero
            raise InputError(
                f"{what} has no stamp (header.stamp is zero); let its driver stamp it with the "
                "instant that it shows, by the clock of the commands"
            )
        if stamp > latest(now):
            raise InputError(
                f"{what} is stamped {ahead:.1f} s ahead of the clock; "
                "with a recording set use_sim_time and play it with /clock"
            )

    def is_earlier(self, stamp: int) -> bool:
        """Whether a message [ns] was sent before the clock went back; such a one is counted."""
        earlier = self._passes.is_earlier(stamp, self.now())
        if earlier:
            self.health.count("messages of the pass before dropped")
        return earlier

    def is_published(self, topic: str) -> bool:
        """Whether anybody publishes a topic, remappings included."""
        return int(self.count_publishers(self.resolve_topic_name(topic))) > 0

    def publisher(self, topic: str, qos: QoSProfile, kind: str = "") -> Any:
        """A publisher, its QoS open to overrides; the interface says the type of its own topics."""
        message = message_class(kind or topics.type_of(topic))
        with self._overriding(topic):
            # A copy, since rclpy writes the overrides into the profile that it is given.
            return self.create_publisher(
                message, topic, copy(qos), qos_overriding_options=profiles.OVERRIDES
            )

    def optional_publisher(self, topic: str, qos: QoSProfile, kind: str = "") -> Any | None:
        """A publisher as of `publisher`; None, with a log line, where the package of its messages
        is missing.
        """
        wanted = kind or topics.type_of(topic)
        if installed(wanted):
            return self.publisher(topic, qos, kind)
        package = wanted.partition("/")[0]
        self.get_logger().info(f"{topic} is not published, since {package} is not installed")
        return None

    def subscribe(
        self,
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile,
        kind: str = "",
        *,
        drain: bool = False,
    ) -> Any:
        """A guarded subscription, its QoS open to overrides.

        Args:
            topic: name of the topic, of the interface or not.
            callback: function that is called with each message.
            qos: profile.
            kind: type of its messages; the interface says that of its own topics.
            drain: whether all messages that wait are taken at once. An executor takes one of each
                topic between two images, and a robot publishes its poses more often.
        """
        message = message_class(kind or topics.type_of(topic))
        guarded = self.guarded(topic, callback)

        subscription: Any = None

        def receive(received: Any) -> None:
            guarded(received)
            if drain and subscription is not None:
                for waiting in self.waiting(subscription):
                    guarded(waiting)

        with self._overriding(topic):
            subscription = self.create_subscription(
                message, topic, receive, copy(qos), qos_overriding_options=profiles.OVERRIDES
            )
        return subscription

    def waiting(self, subscription: Any) -> Iterator[Any]:
        """The messages of a subscription that have come, taken past the executor."""
        while True:
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, False)
            if taken is None:
                return
            yield taken[0]

    @contextmanager
    def _overriding(self, topic: str) -> Iterator[None]:
        """Report an override that ROS refuses by names that a person understands."""
        try:
            yield
        except (RuntimeError, AttributeError, AssertionError) as err:
            name = self.resolve_topic_name(topic)
            raise ParameterError(f"qos_overrides.{name}: {err}") from err

    def every(self, period: float, callback: Callable[[], None]) -> Any:
        """A guarded timer of wall time; period in seconds."""
        guarded = self.guarded("timer", callback)

        def tick() -> None:
            guarded()

        return self.create_timer(period, tick, clock=self._steady)

    def guarded(self, what: str, callback: Callable[..., None]) -> Callable[..., None]:
        """The callback, so that whatever arrives is at worst a warning and the node lives on."""

        def call(*arguments: Any) -> None:
            try:
                callback(*arguments)
            except DloError as err:
                self.health.warn(what, str(err))
            except Exception as err:
                if os.environ.get("DLO_ROS_DEBUG"):
                    traceback.print_exc()
                self.health.error(what, f"{what}: {type(err).__name__}: {err}")

        return call

    def _settings_changed(self, settings: Settings) -> None:
        self.guarded("parameters", self.apply)(settings)

    def _on_reset(self, _: Any, response: Any) -> Any:
        try:
            self.reset()
        except Exception as err:
            response.success, response.message = False, f"{type(err).__name__}: {err}"
            return response
        self.get_logger().info("reset")
        response.success, response.message = True, "reset"
        return response

    def _on_jump(self, jump: TimeJump) -> None:
        now, delta = self.now(), int(jump.delta.nanoseconds)
        if now and delta < 0 and jump.clock_change == ClockChange.ROS_TIME_NO_CHANGE:
            self._passes.went_back(now - delta)
        self.get_logger().info(f"time jumped to {now / 1e9:.3f} s, starting afresh")
        self.restart(now)
