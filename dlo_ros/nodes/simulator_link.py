# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The link that passes estimates to the simulator, by requests as `ros2 param set` makes them."""

from __future__ import annotations

import math
import time
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParametersAtomically

from dlo_ros.identification.estimate import Estimate
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.recordings import topics

TIMEOUT = 2.0
"""Seconds after which a call counts as lost and is repeated."""

POLL = 0.25
"""Seconds between two looks at whether the simulator is there."""


EASED = 2.0
"""Factor between the standard deviations of values that are kept and of those that replace them.

The same recording, played again, reaches it well before its end; with each pass that does not, it
applies once more, so that another DLO's values are not kept for long.
"""


class CertaintyThreshold:
    """The largest std of E/mu with which values replace those of an earlier pass of a recording."""

    def __init__(self) -> None:
        self.held = False
        self._std = self._highest = math.inf

    def begin_again(self) -> None:
        """Reset after time went back: the new estimate is less certain at first."""
        self._std *= EASED
        self._highest, self.held = self._std, False

    def passes(self, std: float) -> bool:
        """Whether a relative standard deviation is small enough; later ones then are."""
        self.held = not std <= self._highest
        if not self.held:
            self._std, self._highest = std, math.inf
        return not self.held


class SimulatorLink:
    """Sets E and mu of the simulator node, without waiting for it.

    A simulator that was started again gets the last values again.

    Args:
        node: the identifier.
        simulator: the simulator's name, in the identifier's namespace where it is relative.
    """

    def __init__(self, node: DloNode, simulator: str) -> None:
        self._node = node
        self._name = simulator
        self._client = node.create_client(
            SetParametersAtomically, f"{simulator}/set_parameters_atomically"
        )
        self._wanted: tuple[float, float] | None = None
        self._sent: tuple[float, float] | None = None
        self._pending: tuple[float, Any] | None = None
        self._simulators: set[bytes] = set()
        self._threshold = CertaintyThreshold()
        node.every(POLL, self._poll)

    def pass_on(self, estimate: Estimate) -> None:
        """Request E and mu of an estimate; the newest request replaces older ones.

        Values that change nothing are left out, and after `begin_again` those that are less certain
        than before.
        """
        if not (estimate.significant or self._threshold.held):
            return
        std = estimate.specific_modulus_std
        if self._threshold.passes(math.inf if std is None else std / estimate.specific_modulus):
            self._wanted = (estimate.young_modulus, estimate.density)
            self._send()

    def begin_again(self) -> None:
        """Begin again with a recording that starts again; the last request holds."""
        self._threshold.begin_again()

    def forget(self) -> None:
        """Drop the last request."""
        self._wanted = self._sent = None
        self._threshold = CertaintyThreshold()

    def _poll(self) -> None:
        if self._pending is not None and time.monotonic() - self._pending[0] > TIMEOUT:
            self._client.remove_pending_request(self._pending[1])
            self._pending = self._sent = None
        simulators = {
            bytes(e.endpoint_gid) for e in self._node.get_publishers_info_by_topic(topics.PREDICTED)
        }
        if simulators - self._simulators:
            # One that was started again; of one that was killed DDS hears nothing for 20 seconds,
            # so that its service seems to have been there all the time.
            self._sent = None
        self._simulators = simulators
        if not self._client.service_is_ready():
            self._sent = None
            if self._wanted is not None:
                self._node.health.warn("simulator", f"the node {self._name} is not there")
        self._send()

    def _send(self) -> None:
        busy = self._pending is not None or self._wanted in (None, self._sent)
        if busy or not self._client.service_is_ready():
            return
        assert self._wanted is not None
        values = self._wanted
        request = SetParametersAtomically.Request(
            parameters=[
                _double("rod.young_modulus", values[0]),
                _double("rod.density", values[1]),
            ]
        )
        future = self._client.call_async(request)
        self._pending = (time.monotonic(), future)
        # A value that is refused is not repeated.
        self._sent = values
        future.add_done_callback(self._node.guarded("simulator", self._done))

    def _done(self, future: Any) -> None:
        if self._pending is None or future is not self._pending[1]:
            return
        self._pending = None
        result = future.result().result
        if result.successful:
            self._node.health.solved("simulator")
            self._node.health.count("parameter changes of the simulator")
        else:
            self._node.health.warn(
                "simulator", f"{self._name} refuses the estimate: {result.reason}"
            )
        self._send()


def _double(name: str, value: float) -> Any:
    return Parameter(
        name=name,
        value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=float(value)),
    )
