# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One direction of dependence, as the README draws it, and ROS in one place only."""

import ast

import pytest
from conftest import ROOT

PACKAGE = ROOT / "dlo_ros"
ROS = ("rclpy", "std_srvs", "rcl_interfaces", "builtin_interfaces", "ament_index_python")

# From the bottom: a part knows itself and what stands on a line before its own.
LAYERS = (
    ("errors",),
    ("kernel_parts",),
    ("kernel_cache",),
    ("dependencies", "logs"),
    ("kernel_linking",),
    ("compilation",),
    ("__init__", "spline", "parameter_table", "interpolation", "share", "files"),
    ("command", "observation", "parameter_cameras"),
    ("effects",),
    ("parameter_text", "parameter_file"),
    ("parameters",),
    ("rod", "recordings", "report"),
    ("vision",),
    ("inference",),
    ("identification", "synthesis"),
    ("diagnosis", "export", "doctor"),
    ("nodes",),
    ("demo", "compile"),
    ("cli",),
    ("__main__",),
)
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}
MODULES = sorted(PACKAGE.rglob("*.py"))


def part(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path):
    """Full names of all modules that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_every_part_has_its_layer():
    assert {part(path) for path in MODULES} == set(LEVEL)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_knows_only_what_is_below(path):
    own = part(path)
    for name in imported(path):
        root, _, rest = name.partition(".")
        if root == "dlo_ros":
            other = rest.partition(".")[0]
            other = other if other in LEVEL else "__init__"
            assert other == own or LEVEL[other] < LEVEL[own], f"{own} imports {name}"
        elif own != "nodes":
            assert root not in ROS and not root.endswith("_msgs"), f"{own} imports {name}"
