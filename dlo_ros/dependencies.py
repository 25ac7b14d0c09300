# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The libraries that the package needs: their names, oldest versions, and how to get them.

Nothing is imported here, so that a missing one can be reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dlo_ros.kernel_cache import NUMBA_MISSING


@dataclass(frozen=True)
class Dependency:
    """One library.

    Args:
        module: name by which Python imports it.
        distribution: name by which pip installs it.
        minimum: oldest version that serves.
        package: name of its package in Ubuntu 24.04, which is its rosdep key, too; empty where
            there is none.
    """

    module: str
    distribution: str
    minimum: str
    package: str = ""

    @property
    def missing(self) -> str:
        """A line for a person who lacks the library."""
        if self.module == "numba":
            return NUMBA_MISSING
        by_apt = f"apt install {self.package}, or " if self.package else ""
        why = "" if self.package else " (Ubuntu 24.04 has no package of it)"
        return f"{self.module} is not installed; {by_apt}pip install {self.distribution}{why}"


DEPENDENCIES = (
    Dependency("numpy", "numpy", "1.26", "python3-numpy"),
    Dependency("scipy", "scipy", "1.11", "python3-scipy"),
    Dependency("numba", "numba", "0.59"),
    Dependency("cv2", "opencv-python-headless", "4.7", "python3-opencv"),
    Dependency("skimage", "scikit-image", "0.22", "python3-skimage"),
    Dependency("rosbags", "rosbags", "0.11.7"),
    Dependency("yaml", "PyYAML", "6.0", "python3-yaml"),
    Dependency("matplotlib", "matplotlib", "3.6", "python3-matplotlib"),
    Dependency("rich", "rich", "13.7", "python3-rich"),
    Dependency("argcomplete", "argcomplete", "3.1", "python3-argcomplete"),
)
"""Those of setup.cfg, the numerical ones first."""

BY_MODULE: Mapping[str, Dependency] = {d.module: d for d in DEPENDENCIES}

# Besides all that end in _msgs.
ROS_MODULES = ("ament_index_python", "builtin_interfaces", "rcl_interfaces", "rclpy", "std_srvs")


def extra(name: str) -> str:
    """The command that installs the modules of an extra of the package beside it."""
    return f"pip install -e '.[{name}]' in the folder of dlo_ros's sources"


ROS_REMEDY = f"source a ROS 2 Jazzy installation, or {extra('ros')}"


def missing(module: str) -> str | None:
    """A line for a person who lacks a module.

    Args:
        module: full name, as a ModuleNotFoundError has it.

    Returns:
        None where the module is none that the package needs.
    """
    root = "numba" if module.startswith("llvmlite") else module.partition(".")[0]
    if root in BY_MODULE:
        return BY_MODULE[root].missing
    if root in ROS_MODULES or root.endswith("_msgs"):
        return f"{module} is not installed; {ROS_REMEDY}"
    return None
