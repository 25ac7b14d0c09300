# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Energy of the discrete rod in space, with its gradient and Hessian.

Degrees of freedom are x, y, z of a node and the spin of the edge after it, in this order along the
rod; that of the last node has no edge and is held. A change of the nodes carries each edge's
directors along the short way, a spin turns them about the edge. So derivatives are those at the
present frames, where the carrying adds nothing (Bergou, Audoly, Vouga, Wardetzky and Grinspun,
Discrete viscous threads, 2010, section 6). A banded matrix is stored by its lower half.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.rod_laws import Contact, lean, press
from dlo_ros.synthesis.spatial_rod import dot, edges_of
from dlo_ros.synthesis.spatial_rod_kernels import (
    BANDS,
    DOF,
    add_bending,
    add_stretch,
    hold,
    move,
    vertex_strains,
)

PLANE_BANDS = 6  # of the contact laws, which act on x and z alone
IN_PLANE = [0, 2]


class Frames(NamedTuple):
    """A shape: nodes x [m], shape (N + 1, 3), and first directors of the edges, shape (N, 3)."""

    x: FloatArray
    director: FloatArray


class EndFrames(NamedTuple):
    """Clamps: tangents and first directors at start and end, (2, 3) each; NaN where free."""

    tangent: FloatArray
    director: FloatArray

    @property
    def held(self) -> NDArray[np.bool_]:
        """Whether each end is clamped, shape (2,)."""
        return np.isfinite(self.tangent[:, 0])


class Drag(NamedTuple):
    """Drag by the square of the velocity across the rod; v = rate x + past.

    Args:
        coefficient: drag coefficients of the nodes [N s^2/m^2], shape (N + 1,).
        along: unit tangents at the nodes, shape (N + 1, 3).
        past: [m/s], shape (N + 1, 3).
        rate: [1/s].
    """

    coefficient: FloatArray
    along: FloatArray
    past: FloatArray
    rate: float


class SpatialPotential(NamedTuple):
    """The function that one implicit step, or an equilibrium, minimises.

    Args:
        free: whether a degree of freedom is free, shape (4 (N + 1),).
        lengths: lengths of the edges [m], shape (N,).
        ends: the clamps.
        stretch: stiffness of each edge [J] and the force against its strain [J], (N,) each.
        stiffness: stiffness of curvatures and twist [J], shape (N + 1, 3, 3).
        offset: moments of rest strain and history against each strain [J], shape (N + 1, 3).
        softening: elastic stiffness that softens [J], (N + 1, 3, 3), strain at rest, (N + 1, 3),
            and the angle at which its tangent is half of it, (N + 1,); None: linear.
        spring: [N/m] of the nodes, shape (N + 1,), and [J] of the spins, shape (N,).
        load: [N] on the nodes, shape (N + 1, 3), and [J] on the spins, shape (N,).
        contact: pegs and a wall.
        drag: drag by the square of speed; None: none.
    """

    free: NDArray[np.bool_]
    lengths: FloatArray
    ends: EndFrames
    stretch: tuple[FloatArray, FloatArray]
    stiffness: FloatArray
    offset: FloatArray
    softening: tuple[FloatArray, FloatArray, FloatArray] | None
    spring: tuple[FloatArray, FloatArray]
    load: tuple[FloatArray, FloatArray]
    contact: Contact
    drag: Drag | None


def _outer(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[:, :, None] * b[:, None, :])


def strains(shape: Frames, lengths: FloatArray, ends: EndFrames) -> tuple[FloatArray, FloatArray]:
    """Stretch of the edges, shape (N,), and curvatures and twist of the vertices [rad], (N + 1, 3).

    Curvatures are integrated, about the first and the second director; at a free end all are 0.
    """
    _, size = edges_of(shape.x)
    return size / lengths - 1.0, vertex_strains(*shape, *ends)


def evaluate(
    shape: Frames, spin: FloatArray, p: SpatialPotential, *, slopes: bool = True
) -> tuple[float, FloatArray, FloatArray]:
    """Value of a potential [J].

    Args:
        shape: nodes and directors.
        spin: angle by which each edge has turned about itself in the step [rad], shape (N,).
        p: the potential.
        slopes: whether gradient and Hessian are wanted, too.

    Returns:
        The value, its gradient, shape (4 (N + 1),), zero where held, and its Hessian, whose entry
        (j + d, j) is at [d, j], shape (BANDS, 4 (N + 1)); without `slopes` both are empty.
    """
    x, nodes = shape.x, len(shape.x)
    stretch, strain = strains(shape, p.lengths, p.ends)
    stress = np.einsum("nab,nb->na", p.stiffness, strain) - p.offset
    value = 0.5 * float(np.sum((stress - p.offset) * strain))
    value += float(np.sum((0.5 * p.stretch[0] * stretch - p.stretch[1]) * stretch))
    tangents = p.stiffness
    if p.softening is not None:
        energy, more, steeper = _softened(strain, *p.softening)
        value, stress, tangents = value + energy, stress + more, tangents + steeper
    value += float(np.sum((0.5 * p.spring[0][:, None] * x - p.load[0]) * x))
    value += float(np.sum((0.5 * p.spring[1] * spin - p.load[1]) * spin))
    gradient, band = np.zeros((nodes, DOF)), np.zeros((BANDS, DOF * nodes))
    if slopes:
        add_bending(*shape, *p.ends, stress, tangents, gradient, band)
        add_stretch(x, p.lengths, *p.stretch, gradient, band)
        gradient[:, :3] += p.spring[0][:, None] * x - p.load[0]
        gradient[:-1, 3] += p.spring[1] * spin - p.load[1]
        for c in range(3):
            band[0, c::DOF] += p.spring[0]
        band[0, 3 : DOF * (nodes - 1) : DOF] += p.spring[1]
    value += _touch(p, x, gradient, band, slopes)
    if p.drag is not None:
        value += _blow(p.drag, x, gradient, band)
    if slopes:
        hold(p.free, gradient, band)
    return value, gradient.ravel(), band


def _softened(
    strain: FloatArray, stiffness: FloatArray, rest: FloatArray, half: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Loss by softening against the linear law: energy, stresses (n, 3), tangents (n, 3, 3)."""
    s = stiffness[:, :2, :2]
    mean = 0.5 * np.trace(s, axis1=1, axis2=2)
    mean[mean == 0.0] = 1.0  # a free end has no stiffness, and none to lose
    y = (strain - rest)[:, :2]
    m = np.einsum("nab,nb->na", s, y)
    q = np.sqrt(np.maximum(dot(y, m) / mean, 1e-300)) / half  # over the half angle
    ratio = np.arctan(q) / q
    energy = mean * half**2 * (q * np.arctan(q) - 0.5 * np.log1p(q * q) - 0.5 * q * q)
    fall = (1.0 / (1.0 + q * q) - ratio) / (mean * half**2 * q * q)
    stress, tangent = np.zeros_like(strain), np.zeros((len(strain), 3, 3))
    stress[:, :2] = (ratio - 1.0)[:, None] * m
    tangent[:, :2, :2] = (ratio - 1.0)[:, None, None] * s + fall[:, None, None] * _outer(m, m)
    return float(np.sum(energy)), stress, tangent


def _touch(
    p: SpatialPotential, x: FloatArray, at: FloatArray, band: FloatArray, slopes: bool
) -> float:
    """Add pegs, which stand along y, and a wall; returns their energy [J]."""
    if not p.contact.active:
        return 0.0
    plane = np.ascontiguousarray(x[:, IN_PLANE])
    push, stiff = np.zeros_like(plane), np.zeros((PLANE_BANDS, plane.size))
    value: float = press(p.contact, plane, p.lengths, push, stiff)
    if p.contact.wall.size:
        value += lean(p.contact, plane, p.lengths, push, stiff)
    if slopes:
        at[:, IN_PLANE] += push
        place = (DOF * np.arange(len(x))[:, None] + IN_PLANE).ravel()
        for d in range(PLANE_BANDS):
            rows, columns = place[d:], place[: plane.size - d]
            near = rows - columns < BANDS
            band[(rows - columns)[near], columns[near]] += stiff[d, : plane.size - d][near]
    return value


def _blow(drag: Drag, x: FloatArray, at: FloatArray, band: FloatArray) -> float:
    """Add the quadratic drag of a step; returns its potential c |v_n|^3 / (3 rate) [J]."""
    velocity = drag.rate * x + drag.past
    across = velocity - dot(velocity, drag.along)[:, None] * drag.along
    speed = np.sqrt(dot(across, across))
    c = drag.coefficient
    at[:, :3] += (c * speed)[:, None] * across
    projector = np.eye(3) - _outer(drag.along, drag.along)
    h = (c * speed * drag.rate)[:, None, None] * projector
    h += (c * drag.rate / np.maximum(speed, 1e-300))[:, None, None] * _outer(across, across)
    for r in range(3):
        for k in range(r + 1):
            band[r - k, k::DOF] += h[:, r, k]
    return float(np.sum(c * speed**3) / (3.0 * drag.rate))


def moved(shape: Frames, change: FloatArray) -> Frames:
    """A shape after a change of its degrees of freedom, shape (4 (N + 1),)."""
    return Frames(*move(*shape, change.reshape(-1, DOF)))
