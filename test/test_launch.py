"""Launch and configuration files, as far as they can be tested without a full ROS 2."""

from __future__ import annotations

import ast
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

from dlo_ros.cli.main import NAMES
from dlo_ros.parameter_table import TABLE
from dlo_ros.parameters import Settings, read_parameter_file

ROOT = Path(__file__).resolve().parent.parent
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch.py"))


def test_the_default_parameter_file_names_every_parameter_with_its_default():
    path = ROOT / "config" / "default.yaml"
    values = read_parameter_file(path)
    assert set(values) == set(TABLE)
    settings = Settings.load(path).flat()
    for parameter in TABLE.values():
        if parameter.default is not None:
            assert settings[parameter.name] == parameter.default, parameter.name


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda p: p.name)
def test_launch_files_name_what_exists(path):
    """Executables, files of the package and launch arguments that a launch file uses."""
    tree = ast.parse(path.read_text())
    assert any(
        isinstance(node, ast.FunctionDef) and node.name == "generate_launch_description"
        for node in tree.body
    )
    imported = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    declared, used = set(), set()
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        assert isinstance(call.func, (ast.Name, ast.Attribute))
        if not isinstance(call.func, ast.Name):
            continue
        assert call.func.id in imported, call.func.id
        first = call.args[0] if call.args else None
        text = first.value if isinstance(first, ast.Constant) else None
        if call.func.id == "DeclareLaunchArgument":
            declared.add(text)
            assert any(k.arg == "description" for k in call.keywords), text
        if call.func.id == "LaunchConfiguration":
            used.add(text)
        if call.func.id == "PathJoinSubstitution" and isinstance(first, ast.List):
            parts = [e.value for e in first.elts if isinstance(e, ast.Constant)]
            assert (ROOT / Path(*parts)).is_file(), parts
        for keyword in call.keywords:
            if keyword.arg == "executable":
                assert keyword.value.value in (*NAMES, "rviz2")
    assert used <= declared


def test_profile_for_large_images_is_well_formed():
    root = ElementTree.parse(ROOT / "config" / "fastdds_large_images.xml").getroot()
    sizes = [e.text for e in root.iter() if e.tag.endswith("segment_size")]
    assert sizes == [str(64 * 1024 * 1024)]


def test_rviz_looks_at_the_topics_of_the_interface():
    view = yaml.safe_load((ROOT / "config" / "dlo.rviz").read_text())["Visualization Manager"]
    shown = {d["Topic"]["Value"] for d in view["Displays"] if "Topic" in d}
    assert shown == {"dlo/markers", "dlo/overlay"}
