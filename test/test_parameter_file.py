# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Parameter files in all forms that ROS 2 takes: tools read what nodes are given."""

import logging

import pytest

from dlo_ros.errors import ParameterError
from dlo_ros.parameter_file import parameter_values
from dlo_ros.parameters import Settings

ROD = "rod: {length: 0.4, diameter: 0.004, young_modulus: 50000000.0, density: 2500.0}"
WHOLE = f"/**:\n  ros__parameters:\n    {ROD}\n"
FORMS = {
    "a block twice": WHOLE + "/**:\n  ros__parameters:\n    gravity: [0.0, 0.0, -1.0]\n",
    "effects twice": WHOLE
    + "    effects: {point_mass: {mass: 0.01, position: 0.2}}\n"
    + "    effects: {point_mass: {mass: 0.02}, air_drag: {coefficient: 0.02}}\n",
    "a rod in two parts": "/**:\n  ros__parameters:\n    rod: {length: 0.4, diameter: 0.004}\n"
    "    rod: {young_modulus: 50000000.0, density: 2500.0}\n",
    "a value twice": WHOLE + "    gravity: [0.0, 0.0, -1.0]\n    gravity: [0.0, 0.0, -2.0]\n",
    "a nested namespace": WHOLE
    + "left:\n  simulator:\n    ros__parameters:\n      gravity: [0.0, 0.0, -1.0]\n",
    "nested alone": f"left:\n  simulator:\n    ros__parameters:\n      {ROD}\n",
    "a node's own value": WHOLE
    + "/left/simulator:\n  ros__parameters:\n    gravity: [0.0, 0.0, -1.0]\n",
    "another node": WHOLE
    + "/usb_cam:\n  ros__parameters: {frame_id: camera, camera: 3, gravity: true}\n",
    "any namespace": f"/*/simulator:\n  ros__parameters:\n    {ROD}\n",
    "dots": WHOLE
    + "    effects.point_mass.mass: 0.02\n    effects: {point_mass: {position: 0.2}}\n",
}


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "params.yaml"
        path.write_text(text)
        return path

    return write


@pytest.mark.parametrize("form", FORMS)
def test_tools_read_what_a_node_is_given(written, form, monkeypatch, tmp_path):
    rclpy = pytest.importorskip("rclpy")
    node_type = pytest.importorskip("rclpy.node").Node
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    path = written(FORMS[form])
    context = rclpy.context.Context()
    rclpy.init(args=["node", "--ros-args", "--params-file", str(path)], context=context)
    try:
        node = node_type(
            "simulator", namespace="left", context=context, start_parameter_services=False,
            enable_rosout=False, automatically_declare_parameters_from_overrides=True,
        )  # fmt: skip
        given = {name: p.value for name, p in node.get_parameters_by_prefix("").items()}
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    given = {k: v for k, v in given.items() if "." in k or k in ("gravity", "frame_id")}
    read = parameter_values(path)
    assert read == {k: list(v) if isinstance(read[k], list) else v for k, v in given.items()}
    Settings.load(path)


def test_two_dlos_in_one_file_are_told(written, caplog):
    other = ROD.replace("0.4,", "0.7,")
    path = written(
        f"/left/simulator:\n  ros__parameters:\n    {ROD}\n"
        f"/right/simulator:\n  ros__parameters:\n    {other}\n"
    )
    with caplog.at_level(logging.WARNING):
        assert Settings.load(path).rod.length == 0.7
    assert "rod.length is 0.4 for /left/simulator and 0.7 for /right/simulator" in caplog.text
    assert caplog.text.count("the last one is taken") == 1


def test_a_nodes_own_value_beside_that_of_all_is_no_warning(written, caplog):
    with caplog.at_level(logging.WARNING):
        Settings.load(written(FORMS["a node's own value"]))
    assert not caplog.text


def test_a_file_for_nodes_of_other_names_is_read(written):
    path = written(f"/my_rope:\n  ros__parameters:\n    {ROD}\n")
    assert Settings.load(path).rod.length == 0.4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (WHOLE + "/observer:\n  ros__parameters:\n", "'ros__parameters' of /observer holds no"),
        (
            WHOLE + "    effects: [point_mass]\n",
            r"effects is \['point_mass'\]; it must be a block of blocks",
        ),
        (WHOLE + "    effects: none\n", "effects is 'none'; it must be a block of blocks"),
        ("rod: {length: 0.4}\n", "has no block"),
        ("", "has no block"),
    ],
)
def test_what_cannot_be_read_is_told(written, text, words):
    with pytest.raises(ParameterError, match=words):
        Settings.load(written(text))
