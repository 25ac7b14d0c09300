# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Commands as a node takes them: in order, of every kind of publisher, of another clock."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest
import recordings_samples as samples

pytest.importorskip("rclpy")

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from dlo_ros.command import Motion
from dlo_ros.nodes.commands import LATE, CommandSubscription
from dlo_ros.nodes.message_factory import ROS_MESSAGES
from dlo_ros.recordings import command_message

MS = 1_000_000


@pytest.fixture
def node():
    made = MagicMock(settings=samples.SETTINGS)
    made.now.return_value = 5
    made.guarded.side_effect = lambda _, callback: callback
    return made


def arrive(node, stamp: int, received: int) -> None:
    """A command with that stamp [ms] comes through the newest subscription."""
    info = {"source_timestamp": stamp, "received_timestamp": received}
    message = command_message(ROS_MESSAGES, replace(samples.command(), stamp=stamp * MS))
    node.create_subscription.call_args.args[2](message, info)


def test_commands_through_two_subscriptions_hold_in_the_order_of_receipt(node):
    """The latched one was handed over first, the last of a storm before it afterwards."""
    motion = Motion()
    CommandSubscription(node, motion.add)
    for stamp, received in ((100, 1000), (200, 1005), (190, 1004), (200, 1006), (195, 1003)):
        arrive(node, stamp, received)
    assert [c.stamp // MS for c in motion.commands] == [100, 190, 200]
    # One that is new replaces what would begin after it; also when the clock was set back.
    arrive(node, 150, 2000)
    arrive(node, 120, 1000 - 2 * LATE)
    assert [c.stamp // MS for c in motion.commands] == [100, 120]


@pytest.mark.parametrize("latched", [False, True])
@pytest.mark.parametrize("reliable", [False, True])
def test_each_kind_of_publisher_is_heard(node, latched, reliable):
    commands = CommandSubscription(node, Motion().add)
    offered = QoSProfile(
        depth=1,
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )
    node.get_publishers_info_by_topic.return_value = [SimpleNamespace(qos_profile=offered)]
    commands._poll()
    held = node.create_subscription.call_args.args[3]
    assert (held.durability, held.reliability) == (offered.durability, offered.reliability)
    assert len(commands._subscriptions) == 1  # and no other


def test_a_command_of_another_clock_is_told(node):
    """It is taken: a motion may be planned."""
    motion = Motion()
    CommandSubscription(node, motion.add)
    arrive(node, 30_000, 1000)
    node.health.warn.assert_not_called()
    arrive(node, 100_000, 2000)
    (_, told) = node.health.warn.call_args.args
    assert "begins 100 s ahead of the clock" in told and "use_sim_time" in told
    assert len(motion.commands) == 2
