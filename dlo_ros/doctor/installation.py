# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The installation: Python, libraries, ROS, and the folder of compiled kernels."""

from __future__ import annotations

import importlib
import platform
import re
import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Any

from dlo_ros.dependencies import DEPENDENCIES, ROS_REMEDY, Dependency
from dlo_ros.doctor.finding import Finding, ok, warning, wrong
from dlo_ros.errors import DloError
from dlo_ros.kernel_parts import STAGES

PYTHONS = ((3, 10), (3, 13))
"""Oldest and newest Python that the tests run on."""

TESTED_MACHINES = ("x86_64",)
"""Processors that the tests run on."""

COMPILE = "python -m dlo_ros.compile"


def installed(
    version: str, importer: Callable[[str], Any] = importlib.import_module
) -> list[Finding]:
    """Python, the package, its libraries and rclpy.

    Args:
        version: version of the package.
        importer: imports a module by name.
    """
    return [_python(version), *_libraries(importer), _ros(importer)]


def _python(version: str) -> Finding:
    here = sys.version_info[:2]
    text = (
        f"dlo_ros {version} on Python {platform.python_version()}, "
        f"{platform.system()} {platform.machine()} ({sys.executable})"
    )
    if not PYTHONS[0] <= here <= PYTHONS[1]:
        span = " to ".join(".".join(map(str, v)) for v in PYTHONS)
        return warning(text, f"the package is tested on Python {span}")
    if platform.machine() not in TESTED_MACHINES:
        return warning(text, f"the package is tested on {' and '.join(TESTED_MACHINES)} only")
    return ok(text)


def _libraries(importer: Callable[[str], Any]) -> list[Finding]:
    """One line on all libraries that are in order, and a line for each other one."""
    good, bad = [], []
    for dependency in DEPENDENCIES:
        finding = _library(dependency, importer)
        if finding.remedy:
            bad.append(finding)
        else:
            good.append(finding.text)
    return [*([ok(", ".join(good))] if good else []), *bad]


def _library(dependency: Dependency, importer: Callable[[str], Any]) -> Finding:
    name, upgrade = dependency.module, f"pip install --upgrade '{dependency.distribution}'"
    try:
        module = importer(name)
    except ModuleNotFoundError as err:
        if (err.name or name).partition(".")[0] == name:
            text, _, remedy = dependency.missing.partition("; ")
            return wrong(text, remedy)
        return wrong(f"{name} cannot be imported: {err}", upgrade)
    except Exception as err:  # such as a library that was built against another NumPy
        said = str(err).strip().splitlines() or [type(err).__name__]
        return wrong(
            f"{name} cannot be imported: {said[0]}",
            "its version does not go with another one's, often NumPy's: "
            "install all of them by pip into one virtual environment",
        )
    found = _version(dependency, module)
    text = f"{name} {found}"
    if numbers(found) < numbers(dependency.minimum) and not (
        name == "cv2" and hasattr(module, "aruco")  # Ubuntu's 4.6 has it, pip's has it from 4.7 on
    ):
        return wrong(f"{text} is older than {dependency.minimum}", upgrade)
    return ok(text)


def _version(dependency: Dependency, module: Any) -> str:
    """Version that the module states, or that was installed."""
    said = getattr(module, "__version__", None)
    if isinstance(said, str):
        return said
    try:
        return metadata.version(dependency.distribution)
    except metadata.PackageNotFoundError:
        return "unknown"


def numbers(version: str) -> tuple[int, ...]:
    """The leading numbers of a version, as they compare; those of an unknown one are above all."""
    found = re.match(r"\d+(?:\.\d+)*", version)
    return tuple(int(part) for part in found[0].split(".")) if found else (sys.maxsize,)


def _ros(importer: Callable[[str], Any]) -> Finding:
    try:
        importer("rclpy")
    except ModuleNotFoundError as err:
        if (err.name or "").partition(".")[0] != "rclpy":
            return wrong(f"rclpy cannot be imported: {err}", ROS_REMEDY)
        return warning(
            "rclpy is not installed: the nodes, play and demo do not run; all other tools do",
            ROS_REMEDY,
        )
    except Exception as err:  # such as one that was built for another Python
        return wrong(
            f"rclpy cannot be imported: {str(err).strip().splitlines()[0]}",
            "run this with the Python that ROS was built for (3.12 for Jazzy on Ubuntu 24.04)",
        )
    try:
        return ok(f"rclpy {metadata.version('rclpy')}")
    except metadata.PackageNotFoundError:
        return ok("rclpy")


def kernels() -> list[Finding]:
    """Whether the numerical kernels are compiled, and where their machine code is kept."""
    from dlo_ros.compilation import PartFiles
    from dlo_ros.kernel_cache import cache_folder, jit_disabled, writable

    try:
        if jit_disabled():
            return [
                warning(
                    "NUMBA_DISABLE_JIT is set: all kernels run as plain Python, hundreds of times "
                    "slower",
                    "unset NUMBA_DISABLE_JIT",
                )
            ]
        folder = cache_folder()
    except DloError as err:
        text, _, remedy = str(err).partition("; ")
        return [wrong(text, remedy or "see the section on starting in the documentation")]
    missing = [
        stage
        for stage, parts in STAGES.items()
        if not all(PartFiles(folder, part.name).complete for part in parts)
    ]
    return judge_kernels(str(folder), writable(folder), missing)


def judge_kernels(folder: str, can_write: bool, missing: Sequence[str]) -> list[Finding]:
    """Findings about the folder of compiled kernels.

    Args:
        folder: path of the folder.
        can_write: whether new machine code can be kept there.
        missing: stages whose machine code is not complete.
    """
    if not missing:
        note = "" if can_write else ", which cannot be written and need not be"
        return [ok(f"kernels are compiled, in {folder}{note}")]
    text = f"kernels are not compiled yet ({', '.join(missing)}), in {folder}"
    if not can_write:
        return [
            wrong(
                f"{text}, which cannot be written: every process compiles them for itself",
                f"set NUMBA_CACHE_DIR to a folder that can be written, then {COMPILE}",
            )
        ]
    return [warning(text, f"the first start takes minutes for it; beforehand: {COMPILE}")]
