# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters that are changed live are checked as a set."""

from rclpy.parameter import Parameter

from dlo_ros.nodes.parameters import LiveSettings
from dlo_ros.parameters import Settings

SETTINGS = Settings.from_mapping(
    {
        "rod.length": 0.4,
        "rod.diameter": 0.005,
        "rod.young_modulus": 1e7,
        "rod.density": 1200.0,
        "rod.control_points": 10,
    }
)


class Listener:
    """A node as far as its parameters go."""

    def add_on_set_parameters_callback(self, callback):
        self.check = callback

    def add_post_set_parameters_callback(self, callback):
        self.apply = callback


def test_a_parameter_given_twice_is_refused():
    """Whoever publishes the events would pass on the first value unseen."""
    node, changes = Listener(), []
    LiveSettings(node, SETTINGS, changes.append)
    name = "rod.density"
    for values in ([float("nan"), 1300.0], [None, float("nan"), 1300.0]):
        kinds = [Parameter.Type.DOUBLE if v is not None else Parameter.Type.NOT_SET for v in values]
        asked = [Parameter(name, kind, v) for kind, v in zip(kinds, values, strict=True)]
        answer = node.check(asked)
        assert not answer.successful and "rod.density is given more than once" in answer.reason
    once = [Parameter(name, Parameter.Type.DOUBLE, 1300.0)]
    assert node.check(once).successful
    node.apply(once)
    assert changes[0].rod.density == 1300.0


def test_a_parameter_without_a_name_is_refused():
    node = Listener()
    LiveSettings(node, SETTINGS, lambda settings: None)
    answer = node.check([Parameter("", Parameter.Type.DOUBLE, float("nan"))])
    assert not answer.successful and "without a name" in answer.reason
