# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Publication of the loads on the DLO and its grips, and the alarm beyond their limits."""

from __future__ import annotations

from dlo_ros.errors import InputError
from dlo_ros.nodes import qos
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.nodes.node_base import DloNode
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import load_messages
from dlo_ros.rod.loads.grip_reactions import Loading
from dlo_ros.rod.loads.load_limits import load_warnings


class LoadPublisher:
    """Publishes forces, tension and bend radius of predictions, and raises the alarm.

    Args:
        node: node that publishes.
    """

    def __init__(self, node: DloNode) -> None:
        self._node = node
        self._publishers = {t: node.publisher(t, qos.RELIABLE) for t in topics.LOADS}

    def publish(self, stamp: int, loading: Loading) -> None:
        """Publish what belongs to a prediction at a stamp [ns]; nothing for an end that is free.

        Where a number is not finite nothing is published, and that is said.
        """
        try:
            self._publish(stamp, loading)
        except InputError as err:
            self._node.health.warn("forces", f"forces are not published: {err}")

    def _publish(self, stamp: int, loading: Loading) -> None:
        messages = load_messages(
            ROS_MESSAGES, stamp, self._node.settings.frame_id, tension=loading.tension,
            bend_radius=loading.bend_radius, wrenches=loading.wrenches,
        )  # fmt: skip
        for topic, message in messages.items():
            self._publishers[topic].publish(message)
        health = self._node.health
        health.values["tension [N]"] = loading.tension
        health.values["bend radius [m]"] = loading.bend_radius
        # An alarm is shown for a while, even if it was one instant: so none is taken back here.
        for strain in load_warnings(loading, self._node.settings.limits):
            if strain.passed:
                health.error(strain.name, strain.text)
            else:
                health.warn(f"near {strain.name}", strain.text)
