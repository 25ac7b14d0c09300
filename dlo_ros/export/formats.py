# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The formats of `export`, in one table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from dlo_ros.export import mjcf, newton, sdf, usd
from dlo_ros.export.chain import CableChain

Write = Callable[..., str]


@dataclass(frozen=True)
class Format:
    """One format.

    Args:
        title: name of the format, for people.
        simulator: the simulator that reads it.
        write: function that makes the text of a chain; arguments `step` [s] and `comment`.
        supported: fields of `dlo_ros.effects.Body` that it can say.
        approximations: function that names the parts of a chain that the format only approximates,
            one line each.
        plugin: the plugin of MuJoCo that it needs; empty: none.
        run: whether MuJoCo runs the file itself; otherwise the same chain stands for it.
        use: how the file is loaded, one line.
    """

    title: str
    simulator: str
    write: Write
    supported: frozenset[str]
    approximations: Callable[[CableChain], tuple[str, ...]]
    plugin: str
    run: bool
    use: str


LOAD = (
    "mujoco.MjModel.from_xml_path(FILE); keyframe 0 is its shape at rest; grips move by "
    "data.mocap_pos and data.mocap_quat, a little at each step"
)
FORMATS: dict[str, Format] = {
    "mjcf": Format(
        "MJCF with the plugin for cables", "MuJoCo", partial(mjcf.mjcf, plugin=True), mjcf.FIELDS,
        partial(mjcf.approximations, plugin=True), mjcf.PLUGIN, True, LOAD,
    ),
    "mjcf-chain": Format(
        "MJCF as a chain of ball joints", "MuJoCo", partial(mjcf.mjcf, plugin=False), mjcf.FIELDS,
        partial(mjcf.approximations, plugin=False), "", True, LOAD,
    ),
    "sdf": Format(
        "SDF as a chain of universal joints", "Gazebo", sdf.sdf, sdf.FIELDS, sdf.approximations, "",
        False, "gz sim FILE; or copy its <model> into a world",
    ),
    "usd": Format(
        "USD text with physics", "Isaac Sim", usd.usd, usd.FIELDS, usd.approximations, "", False,
        "open FILE, or add it as a reference; its name should end in .usda",
    ),
    "newton": Format(
        "Python script for Newton", "Newton", newton.newton, newton.FIELDS, newton.approximations,
        "", False, "python FILE --cpu; or import it: build() adds the cable to a ModelBuilder",
    ),
}  # fmt: skip
