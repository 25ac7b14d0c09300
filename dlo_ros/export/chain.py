# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The cable as a chain of rigid links with elastic joints, the common form of all formats.

The true length is cut into N cells of equal length h, with a joint in the middle of each. So the
first and the last link are half as long as the others, a clamp holds a half link, and the angle of
a joint is the integral of the curvature over its cell: compliances h / B and angles at rest are
exact for any stiffness and curvature along u, and the chain is right to second order in h. The
middles of links lie on the cable's curve, and their directions are its tangents.

The frame of link k has its x axis along the link and its origin at joint k; that of link 0 has it
where joint 0 would be, half a cell before the cable's start.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import END, START, Command
from dlo_ros.effects.base import Body
from dlo_ros.export.grips import Grip, Pose, kind_of, pose_at
from dlo_ros.parameters import Settings
from dlo_ros.rod.boundary.twist_free_frame import EndFrame, material_frame, twist_free
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.packing import true_command
from dlo_ros.spline import DEGREE, FloatArray, SplineBasis

FINE = 400  # knot spans in which stiffness and rest curvature are tabulated
STIFFEST = 30.0  # largest stiffness of a joint over that of the plain DLO: more is as good as rigid
SLOWEST = 1.875**4  # squared frequency of a cantilever's first mode over B / (line density L^4)


@dataclass(frozen=True)
class CableChain:
    """The cable with N joints and N + 1 links.

    Args:
        length: length of the whole cable [m].
        diameter: [m].
        bend, twist: stiffness of the joints [N m/rad], shape (N,).
        relaxation_time: damping of a joint over its stiffness [s].
        rest: rotation of link k in the frame of link k - 1 at rest, for k = 1 ... N.
        line_density: [kg/m].
        masses: masses fixed to links, each as mass [kg], link and place along its x axis [m].
        gravity: [m/s^2], shape (3,).
        air_drag: force per length over velocity [N s/m^2].
        quadratic_drag: force per length over squared velocity across [N s^2/m^3].
        grips: the grips of the ends that are held.
        root: pose of link 0 when the motion begins.
        turns: rotation of each joint from rest when the motion begins, N of them.
    """

    length: float
    diameter: float
    bend: FloatArray
    twist: FloatArray
    relaxation_time: float
    rest: Rotation
    line_density: float
    masses: tuple[tuple[float, int, float], ...]
    gravity: FloatArray
    air_drag: float
    quadratic_drag: float
    grips: tuple[Grip, ...]
    root: Pose
    turns: Rotation

    @property
    def joints(self) -> int:
        """N."""
        return len(self.bend)

    @property
    def cell(self) -> float:
        """Distance of the joints, h [m]."""
        return self.length / self.joints

    def extent(self, link: int) -> tuple[float, float]:
        """First and last coordinate of a link on its x axis [m]."""
        h = self.cell
        return (0.5 * h if link == 0 else 0.0), (0.5 * h if link == self.joints else h)

    def mass(self, link: int) -> float:
        """Mass of a link without what is fixed to it [kg]."""
        begin, stop = self.extent(link)
        return self.line_density * (stop - begin)

    def inertia(self, link: int) -> tuple[float, float]:
        """Inertia of a link about its own axis and across it, about its centre [kg m^2]."""
        begin, stop = self.extent(link)
        mass, thick = self.mass(link), self.diameter**2 / 16.0
        return 2.0 * mass * thick, mass * ((stop - begin) ** 2 / 12.0 + thick)

    def loaded(self, link: int) -> tuple[float, FloatArray, FloatArray]:
        """Mass [kg], centre (3,) [m] and inertia about it (3, 3) of a link with its masses."""
        begin, stop = self.extent(link)
        along, across = self.inertia(link)
        parts = [(self.mass(link), 0.5 * (begin + stop))]
        parts += [(mass, place) for mass, at, place in self.masses if at == link]
        whole = sum(mass for mass, _ in parts)
        centre = sum(mass * place for mass, place in parts) / whole
        across += sum(mass * (place - centre) ** 2 for mass, place in parts)
        return whole, np.array([centre, 0.0, 0.0]), np.diag([along, across, across])

    @property
    def poses(self) -> list[Pose]:
        """Poses of the N + 1 links when the motion begins."""
        result = [self.root]
        for rest, turn in zip(self.rest, self.turns, strict=True):
            result.append(result[-1] @ Pose(np.array([self.cell, 0.0, 0.0]), rest * turn))
        return result

    @property
    def rate(self) -> float:
        """Frequency of the slowest motion of a hanging or bending cantilever, roughly [rad/s]."""
        gravity = float(np.linalg.norm(self.gravity))
        bend = float(np.mean(self.bend)) * self.cell / self.line_density
        return math.sqrt(gravity / self.length + SLOWEST * bend / self.length**4)

    @property
    def straight(self) -> bool:
        """Whether it is straight at rest."""
        return bool(np.all(self.rest.magnitude() < 1e-12))

    @property
    def uniform(self) -> bool:
        """Whether all joints are equally stiff."""
        return float(np.ptp(self.bend)) < 1e-9 * float(self.bend.max())


def build_chain(
    settings: Settings, command: Command, stamp: int, basis: SplineBasis, shape: FloatArray,
    joints: int,
) -> CableChain:  # fmt: skip
    """The chain of a cable that a command holds.

    Args:
        settings: the parameter file; what its effects make of the rod is in the chain as far as
            a chain can have it.
        command: the command as it was given, effects not applied.
        stamp: stamp at which the motion begins [ns].
        basis: spline basis of `shape`.
        shape: control points when the motion begins, shape (n, 4).
        joints: N.

    Returns:
        The chain in that shape.
    """
    model = RodModel(settings, SplineBasis(FINE + DEGREE, settings.rod.length))
    body = model.body
    length = body.lengthening * settings.rod.length
    h = length / joints
    edges = np.linspace(0.0, settings.rod.length, joints + 1)

    def whole(density: FloatArray) -> FloatArray:
        """Integral over each cell of a density at the quadrature points, per true length."""
        return _integrals(density * body.weight * body.lengthening, body, edges)

    bend = 1.0 / whole(1.0 / body.bend.mean(axis=1))
    # Not over the softest joint: that may be a grip that turns almost freely.
    bend = np.minimum(bend, STIFFEST * max(settings.rod.bending_stiffness / h, bend.min()))
    round_ = settings.rod.shear_modulus * 2.0 * settings.rod.second_moment
    twist = np.full(joints, body.twisting_ratio * round_ / h)
    rest = np.column_stack(
        [whole(body.twist_rest), whole(body.bend_rest[:, 0]), whole(body.bend_rest[:, 1])]
    )
    frames = _frames(basis, shape, joints, material_frame(true_command(model, command), stamp))
    origin = basis.evaluate(shape[:, :3], [0.0])[0] - 0.5 * h * frames[0].apply([1.0, 0.0, 0.0])
    curved = Rotation.from_rotvec(rest)
    turns = curved.inv() * frames[:-1].inv() * frames[1:]
    masses = []
    for mass, u in body.masses:
        away = u * body.lengthening + 0.5 * h  # along the chain, from the origin of link 0
        link = min(max(int(away / h), 0), joints)
        masses.append((mass, link, away - link * h))
    root = Pose(np.asarray(origin), frames[0])
    stop = Pose(basis.evaluate(shape[:, :3], [settings.rod.length])[0], frames[joints])
    begin = Pose(basis.evaluate(shape[:, :3], [0.0])[0], frames[0])
    return CableChain(
        length, settings.rod.diameter, bend, twist, body.relaxation_time, curved,
        body.line_density, tuple(masses), body.gravity, body.air_drag,
        body.quadratic_drag or 0.0, _grips(model, command, stamp, begin, stop), root, turns,
    )  # fmt: skip


def _grips(
    model: RodModel, command: Command, stamp: int, begin: Pose, stop: Pose
) -> tuple[Grip, ...]:
    """The grips of a command, with the cable's ends as they lie in them."""
    true = true_command(model, command)
    grips = []
    for end, own in ((START, begin), (END, stop)):
        kind = kind_of(command, end)
        if kind is None:
            continue
        commanded, held = pose_at(command, end, stamp), pose_at(true, end, stamp)
        # The end's own direction is where the clamp truly holds it, up to the shape's rounding.
        turned = own.rotation if kind == "clamp" else held.rotation
        offset = commanded.inverse() @ Pose(held.position, turned)
        grips.append(Grip(end, kind, commanded, offset))
    return tuple(grips)


def _integrals(parts: FloatArray, body: Body, edges: FloatArray) -> FloatArray:
    """Integrals between edges of what lies in the cells of the quadrature points."""
    ends = np.concatenate([[0.0], np.cumsum(body.weight)])
    total = np.concatenate([[0.0], np.cumsum(parts)])
    return np.asarray(np.diff(np.interp(edges, ends, total)))


def _frames(basis: SplineBasis, shape: FloatArray, joints: int, held: EndFrame | None) -> Rotation:
    """Orientations of the links: x along the tangent, carried without twist, turned by theta.

    Args:
        held: frame of the clamp that holds the material's.
    """
    u = np.linspace(0.0, basis.length, joints + 1)
    reference, _ = twist_free(shape, basis, u, held)
    x, y = reference.tangent, reference.director
    bare = Rotation.from_matrix(np.stack([x, y, np.cross(x, y)], axis=-1))
    theta = basis.evaluate(shape[:, 3:], u)[:, 0]
    if held is not None:
        theta = theta - theta[held.end]  # there the clamp has turned with the material
    return bare * Rotation.from_rotvec(theta[:, None] * [1.0, 0.0, 0.0])


def part_lines(
    chain: CableChain,
    link: Callable[[CableChain, int, Pose], list[str]],
    joint: Callable[[CableChain, int], list[str]],
    grip: Callable[[CableChain, Grip], list[str]],
) -> list[str]:
    """Lines of a text format for all links, joints and grips, in this order."""
    lines = [line for k, pose in enumerate(chain.poses) for line in link(chain, k, pose)]
    lines += [line for k in range(1, chain.joints + 1) for line in joint(chain, k)]
    return lines + [line for held in chain.grips for line in grip(chain, held)]
