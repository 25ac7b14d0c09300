# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""One direction of dependence, as the README draws it, and ROS in one place only."""

import ast

import pytest
from conftest import ROOT
from parsed_sources import parsed

PACKAGE = ROOT / "dlo_ros"
ROS = ("rclpy", "std_srvs", "rcl_interfaces", "builtin_interfaces", "ament_index_python")

# From the bottom: a part knows itself and what stands on a line before its own.
LAYERS = (
    ("errors",),
    ("kernel_parts", "own_process"),
    ("kernel_cache",),
    ("dependencies", "logs"),
    ("kernel_arguments",),
    ("kernel_linking",),
    ("compilation",),
    ("__init__", "spline", "file_parameter", "interpolation", "share", "files", "plugins"),
    ("command", "observation", "parameter_table", "spline_table"),
    ("parameter_cameras", "smooth_command"),
    ("effects",),
    ("rod_settings",),
    ("rod",),
    ("parameter_text", "parameter_file"),
    ("parameters",),
    ("recordings", "report"),
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

# The same inside the parts that have sub-packages: from the bottom, sub-packages and the modules
# beside them. `__init__` stands above all, since it gives the names that others use.
INSIDE = {
    "rod": (
        ("simd", "parameter_names"),
        ("elements",),
        ("lanes",),
        ("discretisation",),
        ("boundary", "model"),
        ("solve",),
        ("sensitivity",),
        ("adaptive_integration", "state"),
        ("planar_model", "motion_validation"),
        ("packing", "held_tables"),
        ("sensitivity_parameters",),
        ("compiled_rod",),
        ("integration", "measured_shapes", "statics"),
        ("first_guess", "stretch_relaxation"),
        ("batch", "loads", "resolution"),
        ("dynamics", "prediction"),
        ("observed_start", "protocol"),
        ("initial_state",),
        ("simulation_batch", "difference_quotients"),
        ("simulation",),
        ("model_registry", "compile_rod"),
        ("motion_rehearsal",),
        ("live_simulation",),
        ("__init__",),
    ),
    "vision": (
        ("camera",),
        ("segmentation",),
        ("calibration", "tracing"),
        ("fit",),
        ("photograph", "planar_result", "predictions"),
        ("ends_beside_clamps", "expected_shape"),
        ("overlay", "planar_observer"),
        ("contact_sheet", "space"),
        ("compile_vision", "points"),
        ("__init__",),
    ),
    "identification": (
        ("cooperative_tasks", "estimate", "information", "residual_noise"),
        (
            "batched_forecast",
            "gradual_simulation",
            "identifiability",
            "material_model",
        ),
        ("force_scale",),
        ("offline", "online", "design"),
        ("__init__",),
    ),
    "diagnosis": (
        ("residuals", "proposals", "contact"),
        ("explain",),
        ("findings", "monitor"),
        ("pipeline",),
        ("__init__",),
    ),
}
INSIDE_LEVEL = {
    part: {name: level for level, names in enumerate(layers) for name in names}
    for part, layers in INSIDE.items()
}
TWINS = {"__init__", "__main__"}
"""Names that Python itself gives, which every part may have."""
MODULES = sorted(PACKAGE.rglob("*.py"))
LONGEST = 400
"""Lines of a module, beyond which it has a seam at which it is better two."""


def part(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def unit(path):
    """The sub-package of a part that has some, or the module beside them."""
    return path.relative_to(PACKAGE).parts[1].removesuffix(".py")


def imported(path):
    """Full names of all modules that a file imports, wherever in it."""
    for node in ast.walk(parsed(path)):
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


def test_every_sub_package_has_its_layer():
    for name, level in INSIDE_LEVEL.items():
        assert {unit(path) for path in (PACKAGE / name).rglob("*.py")} == set(level)


@pytest.mark.parametrize(
    "path", [p for p in MODULES if part(p) in INSIDE], ids=lambda p: str(p.relative_to(PACKAGE))
)
def test_knows_only_sub_packages_below(path):
    own, level = unit(path), INSIDE_LEVEL[part(path)]
    for name in imported(path):
        root, _, rest = name.partition(f"dlo_ros.{part(path)}.")
        if not root and rest:
            other = rest.partition(".")[0]
            other = other if other in level else "__init__"
            assert other == own or level[other] < level[own], f"{own} imports {name}"


def test_a_module_has_a_name_of_its_own():
    seen = {}
    for path in MODULES:  # a command of the terminal bears the name of what it does
        if part(path) != "cli" and path.stem not in TWINS:
            assert path.stem not in seen, f"{path} and {seen[path.stem]}"
            assert path.stem != path.parent.name or part(path) == path.stem, (
                f"{path}: says it twice"
            )
            seen[path.stem] = path


@pytest.mark.parametrize("folder", ("dlo_ros", "test"))
def test_no_module_is_too_long_to_be_read_at_once(folder):
    lengths = {p: len(p.read_text().splitlines()) for p in (ROOT / folder).rglob("*.py")}
    long = [f"{p.relative_to(ROOT)}: {n}" for p, n in lengths.items() if n > LONGEST]
    assert not long, f"more than {LONGEST} lines: {', '.join(long)}"


def drawn():
    """The map of CONTRIBUTING.md: folders of the package, and those that each imports."""
    section = (ROOT / "CONTRIBUTING.md").read_text().split("## The map\n")[1].split("\n## ")[0]
    found, parent, folder = {}, None, None
    for line in section.splitlines():
        if line.startswith("    ") and line.strip().startswith("-> "):
            found[folder] = set(line.strip()[3:].split(", "))
        elif line.startswith("    "):
            name = line.split()[0]
            parent = parent if line.startswith("      ") else name
            folder = PACKAGE / parent / ("" if name == parent else name)
            found[folder] = set()
    return found


def test_the_map_has_every_folder():
    assert set(drawn()) == {path.parent for path in MODULES} - {PACKAGE}


@pytest.mark.parametrize("folder", drawn(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_the_map_draws_the_imports(folder):
    beside = {path.name for path in folder.parent.iterdir() if (path / "__init__.py").is_file()}
    start = ".".join(("dlo_ros", *folder.relative_to(PACKAGE).parts[:-1], ""))
    names = [name for path in folder.rglob("*.py") for name in imported(path)]
    others = {name[len(start) :].partition(".")[0] for name in names if name.startswith(start)}
    assert drawn()[folder] == (others & beside) - {folder.name}
