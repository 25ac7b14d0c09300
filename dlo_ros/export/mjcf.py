# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""MJCF, the format of MuJoCo: with its plugin for cables, or as a plain chain of ball joints.

The first link is free and welded to a mocap body, as a grip moves a cable; MuJoCo would move a
child of a mocap body without its inertia. A plain ball joint resists twist as it does bending. The
plugin (`mujoco.elasticity.cable`, MuJoCo 2.3 to 3) takes the stiffness of a joint from Young's
modulus, the radius r of the link's first geom and the distance h to the link before: it is
E pi r^4 / (4 h), and that of twist G pi r^4 / (2 h). Where the cable is not uniform, a link's first
geom has the radius that gives the joint its stiffness; it is not seen and touches nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from dlo_ros.export.chain import CableChain
from dlo_ros.export.format_support import CHAIN, body_fields
from dlo_ros.export.grips import Grip, Pose
from dlo_ros.spline import FloatArray

FIELDS = CHAIN | body_fields("air_drag quadratic_drag twist_rest twisting_ratio")
"""Fields of the rod that the format can express."""
PLUGIN = "mujoco.elasticity.cable"
WELD = 2.0  # time constant of the grips, in steps: the hardest that MuJoCo allows
HARD = "0.9999 0.9999 0.001"  # impedance of a grip
BOX = math.sqrt(0.75)  # side of the box that has a cylinder's inertia, over its diameter
REST = "start"  # name of the keyframe


def mjcf(chain: CableChain, *, plugin: bool, step: float, comment: str) -> str:
    """The cable as MJCF.

    Args:
        plugin: whether the joints' elasticity is that of MuJoCo's cable plugin.
        step: time step [s].
        comment: comment at the top of the file.

    Returns:
        A whole model, which can be included in another one.
    """
    thick, dense = fluid(chain)
    lines = [
        '<mujoco model="cable">',
        *(f"  {line}" for line in _comment(comment)),
        f'  <option timestep="{step:g}" integrator="Euler" jacobian="dense" '
        f'gravity="{_text(chain.gravity)}" viscosity="{thick:.9g}" density="{dense:.9g}"/>',
        "  <!-- viscosity and density are the air's: they act on every body of a scene. -->",
    ]
    if plugin:
        lines += _plugin(chain)
    lines.append("  <worldbody>")
    for grip in chain.grips:
        lines += _grip(grip)
    lines += [f"    {line}" for line in _links(chain, plugin)]
    lines += ["  </worldbody>", "  <equality>"]
    for grip in chain.grips:
        held = "weld" if grip.kind == "clamp" else "connect"
        lines.append(
            f'    <{held} name="{grip.end}" site1="grip_{grip.end}" site2="cable_{grip.end}" '
            f'solref="{WELD * step:g} 1" solimp="{HARD}"/>'
        )
    lines += ["  </equality>", *_keyframe(chain), "</mujoco>", ""]
    return "\n".join(lines)


def fluid(chain: CableChain) -> tuple[float, float]:
    """Viscosity [Pa s] and density [kg/m^3] of a fluid that drags links as the air does.

    MuJoCo drags a body by its box of equal inertia: by 3 pi d b v with d the mean of its sides and
    b the viscosity, and across by rho |v| v / 2 times the area of its side (chapter "Fluid forces"
    of its documentation).
    """
    return viscosity(chain, chain.air_drag), 2.0 * chain.quadratic_drag / (BOX * chain.diameter)


def viscosity(chain: CableChain, air_drag: float) -> float:
    """Viscosity [Pa s] that drags by a force per length over velocity [N s/m^2]."""
    return air_drag * chain.cell / (math.pi * (chain.cell + 2.0 * BOX * chain.diameter))


def approximations(chain: CableChain, *, plugin: bool) -> tuple[str, ...]:
    """Parts of the cable that the format only approximates, one line each."""
    ratio = float(np.mean(chain.twist)) / float(np.mean(chain.bend))
    if plugin and not chain.uniform:
        return (
            "twist: its stiffness varies along u as that of bending does, not at all as it should",
        )
    if plugin:
        return ()
    return (
        "twist: a ball joint is as stiff against it as against bending; "
        f"{ratio:.3g} of that would be right",
    )


def coordinates(chain: CableChain) -> FloatArray:
    """Coordinates (qpos) when the motion begins, shape (7 + 4 N,)."""
    turns = [Pose(np.zeros(3), turn).quaternion for turn in chain.turns]
    return np.concatenate([chain.root.position, chain.root.quaternion, *turns])


def _comment(text: str) -> Iterable[str]:
    """A comment; two dashes may not stand in one."""
    yield "<!--"
    for line in text.splitlines():
        yield f"  {line.replace('--', '- -')}".rstrip()
    yield "-->"


def _text(values: Sequence[float] | FloatArray) -> str:
    return " ".join(f"{float(v):.9g}" for v in values)


def _grip(grip: Grip) -> list[str]:
    at = grip.commanded
    return [
        f'    <body name="{grip.end}" mocap="true" pos="{_text(at.position)}" '
        f'quat="{_text(at.quaternion)}">',
        f'      <site name="grip_{grip.end}" pos="{_text(grip.offset.position)}" '
        f'quat="{_text(grip.offset.quaternion)}" size="0.001"/>',
        "    </body>",
    ]


def _moduli(chain: CableChain) -> tuple[float, float]:
    """E and G with which the plugin makes the softest joint of a cable of its own diameter [Pa]."""
    radius = 0.5 * chain.diameter
    bend = 4.0 * float(chain.bend.min()) * chain.cell / (math.pi * radius**4)
    # Of the joints' twist their mean, since the plugin has both in one proportion.
    ratio = float(np.mean(chain.twist)) / float(np.mean(chain.bend))
    return bend, 0.5 * ratio * bend


def _plugin(chain: CableChain) -> list[str]:
    bend, twist = _moduli(chain)
    return [
        "  <extension>",
        f'    <plugin plugin="{PLUGIN}">',
        '      <instance name="cable">',
        f'        <config key="bend" value="{bend:.9g}"/>',
        f'        <config key="twist" value="{twist:.9g}"/>',
        f'        <config key="flat" value="{"true" if chain.straight else "false"}"/>',
        "      </instance>",
        "    </plugin>",
        "  </extension>",
    ]


def _links(chain: CableChain, plugin: bool) -> list[str]:
    """The links as nested bodies; fixed masses come after all links, as the plugin wants it."""
    opened, closed = [], []
    for k in range(chain.joints + 1):
        at = chain.root if k == 0 else Pose(np.array([chain.cell, 0.0, 0.0]), chain.rest[k - 1])
        opened += [
            f'<body name="link_{k}" pos="{_text(at.position)}" quat="{_text(at.quaternion)}">',
            *(f"  {line}" for line in _link(chain, k, plugin)),
        ]
        weights = [
            f'  <body name="mass_{number}" pos="{place:.9g} 0 0"><inertial pos="0 0 0" '
            f'mass="{mass:.9g}" diaginertia="1e-12 1e-12 1e-12"/></body>'
            for number, (mass, link, place) in enumerate(chain.masses)
            if link == k and mass > 0.0
        ]
        closed.append([*weights, "</body>"])
    return opened + [line for part in reversed(closed) for line in part]


def _link(chain: CableChain, k: int, plugin: bool) -> list[str]:
    """The parts of a link: joint, inertia, geoms, plugin, the site at an end."""
    begin, stop = chain.extent(k)
    along, across = chain.inertia(k)
    lines = ['<freejoint name="cable"/>']
    if k:
        stiffness = float(chain.bend[k - 1])
        own = "" if plugin else f'stiffness="{stiffness:.9g}" '
        damping = chain.relaxation_time * stiffness
        lines = [f'<joint name="joint_{k}" type="ball" {own}damping="{damping:.9g}"/>']
    middle = 0.5 * (begin + stop)
    lines.append(
        f'<inertial pos="{middle:.9g} 0 0" mass="{chain.mass(k):.9g}" '
        f'diaginertia="{along:.9g} {across:.9g} {across:.9g}"/>'
    )
    shape = f'type="capsule" fromto="{begin:.9g} 0 0 {stop:.9g} 0 0"'
    if plugin and k and not chain.uniform:
        stiff = (float(chain.bend[k - 1]) / float(chain.bend.min())) ** 0.25
        lines.append(
            f'<geom {shape} size="{0.5 * stiff * chain.diameter:.9g}" contype="0" '
            'conaffinity="0" group="4"/>'
        )
    lines.append(
        f'<geom {shape} size="{0.5 * chain.diameter:.9g}" contype="0" conaffinity="1" '
        'rgba="0.9 0.5 0.1 1"/>'
    )
    if plugin:
        lines.append('<plugin instance="cable"/>')
    if k == 0:
        lines.append(f'<site name="cable_start" pos="{begin:.9g} 0 0" size="0.001"/>')
    if k == chain.joints:
        lines.append(f'<site name="cable_end" pos="{stop:.9g} 0 0" size="0.001"/>')
    return lines


def _keyframe(chain: CableChain) -> list[str]:
    places = np.ravel([grip.commanded.position for grip in chain.grips])
    turns = np.ravel([grip.commanded.quaternion for grip in chain.grips])
    return [
        "  <keyframe>",
        f'    <key name="{REST}" qpos="{_text(coordinates(chain))}"',
        f'      mpos="{_text(places)}"',
        f'      mquat="{_text(turns)}"/>',
        "  </keyframe>",
    ]
