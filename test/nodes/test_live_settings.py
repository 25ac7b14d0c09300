# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes: what each node needs, types that stay, sets that are checked as one."""

import pytest
from rclpy.parameter import Parameter

from dlo_ros.errors import InputError, ParameterError
from dlo_ros.file_parameter import NODES
from dlo_ros.nodes.declared_parameters import LiveSettings
from dlo_ros.parameter_table import PARAMETERS
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

    def has_parameter(self, name):
        return bool(name)

    def add_pre_set_parameters_callback(self, callback):
        self.convert = callback

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


@pytest.mark.parametrize("node", NODES)
def test_a_node_is_content_with_what_it_declares(node):
    """So that what `ros2 param dump` writes loads again."""
    whole = SETTINGS.flat()
    own = {p.name: whole[p.name] for p in PARAMETERS if node in p.nodes}
    settings = Settings.from_mapping(own, node).flat()
    assert {name: settings[name] for name in own} == own
    needed = {p.name for p in PARAMETERS if p.default is None and node in p.nodes}
    assert {"rod.length", "rod.diameter"} <= needed
    for name in needed:
        with pytest.raises(ParameterError, match=f"^{name} is missing; give the .*[^ ]$"):
            Settings.from_mapping({k: v for k, v in own.items() if k != name}, node)


def test_a_tool_may_use_all_and_needs_all():
    own = {p.name: SETTINGS.flat()[p.name] for p in PARAMETERS if "observer" in p.nodes}
    with pytest.raises(ParameterError, match=r"rod\.young_modulus is missing"):
        Settings.from_mapping(own)


def test_what_stands_in_for_unused_values_is_allowed():
    for parameter in PARAMETERS:
        assert (parameter.unused is None) or parameter.check(parameter.unused) == parameter.unused
        everywhere = set(parameter.nodes) == set(NODES)
        assert parameter.default is not None or everywhere or parameter.unused is not None


def test_a_whole_number_becomes_a_double_where_one_is_meant():
    node, changes = Listener(), []
    LiveSettings(node, SETTINGS, changes.append)
    given = {"rod.young_modulus": 2000000, "gravity": [0, 0, -10], "rod.poisson_ratio": "0.4"}
    asked = [Parameter(name, value=value) for name, value in given.items()]
    asked.append(Parameter("use_sim_time", value=True))
    taken = node.convert(asked)
    assert [p.name for p in taken] == [p.name for p in asked]
    double, array = Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY
    assert [p.type_ for p in taken] == [double, array, double, Parameter.Type.BOOL]
    assert [p.value for p in taken][:3] == [2e6, [0.0, 0.0, -10.0], 0.4]
    assert node.check(taken).successful
    node.apply(taken)
    assert changes[0].rod.young_modulus == 2e6 and changes[0].gravity == (0.0, 0.0, -10.0)


@pytest.mark.parametrize("value", ["stiff", 5, None, float("nan")])
def test_what_is_unusable_is_refused_as_it_was_given(value):
    node = Listener()
    LiveSettings(node, SETTINGS, lambda settings: None)
    kind = Parameter.Type.NOT_SET if value is None else None
    asked = [Parameter("rod.young_modulus", kind, value)]
    taken = node.convert(asked)
    assert taken == asked or value != value
    answer = node.check(taken)
    assert not answer.successful and answer.reason.startswith("rod.young_modulus ")


def test_what_the_node_cannot_use_is_refused_and_only_asked_about_where_it_changes():
    node, changes, asked = Listener(), [], []

    def usable(settings):
        asked.append(settings)
        if settings.vision.mask:
            raise InputError(f"vision.mask is '{settings.vision.mask}'; no such file")

    live = LiveSettings(node, SETTINGS, changes.append, usable)
    answer = node.check([Parameter("vision.mask", value="/nofile.png")])
    assert not answer.successful and "/nofile.png" in answer.reason
    assert len(asked) == 1 and live.current == SETTINGS and not changes
    assert node.check([Parameter("vision.mask", value="")]).successful and len(asked) == 1
