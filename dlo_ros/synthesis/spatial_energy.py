# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Energy of the discrete rod in space, with its gradient and Hessian, for all vertices at once.

Degrees of freedom are x, y, z of a node and the spin of the edge after it, in this order along the
rod; that of the last node has no edge and is held. A change of the nodes carries each edge's
directors along the short way, a spin turns them about the edge. So derivatives are those at the
present frames, where the carrying adds nothing (Bergou, Audoly, Vouga, Wardetzky and Grinspun,
Discrete viscous threads, 2010, section 6). A banded matrix is stored by its lower half.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.rod_laws import Contact, lean, press
from dlo_ros.synthesis.spatial_rod import (
    angle_between,
    cross,
    dot,
    edges_of,
    spun,
    transported,
)

DOF = 4
BANDS = 11  # a vertex couples three nodes and two spins: eleven numbers in a row
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


class _Vertices(NamedTuple):
    """The two edges of each vertex; clamps stand for those beyond the ends."""

    te: FloatArray
    tf: FloatArray
    e: FloatArray  # 1 / size; 0 for a clamp, whose direction does not depend on the nodes
    f: FloatArray
    d1: tuple[FloatArray, FloatArray]
    d2: tuple[FloatArray, FloatArray]
    open: FloatArray  # 1 + te . tf
    binormal: FloatArray
    mean: FloatArray  # (te + tf) / open


def _outer(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[:, :, None] * b[:, None, :])


def _skew(a: FloatArray) -> FloatArray:
    """Matrices of the cross product a x, shape (n, 3, 3)."""
    result = np.zeros((len(a), 3, 3))
    result[:, 0, 1], result[:, 0, 2], result[:, 1, 2] = -a[:, 2], a[:, 1], -a[:, 0]
    return np.asarray(result - result.transpose(0, 2, 1))


def _vertices(shape: Frames, ends: EndFrames) -> _Vertices:
    tangent, size = edges_of(shape.x)
    t, d1 = np.empty((len(size) + 2, 3)), np.empty((len(size) + 2, 3))
    t[1:-1], d1[1:-1] = tangent, shape.director
    for end, k, beside in ((0, 0, 1), (1, -1, -2)):
        held = ends.held[end]
        t[k] = ends.tangent[end] if held else t[beside]
        d1[k] = ends.director[end] if held else d1[beside]
    d2 = cross(t, d1)
    r = np.concatenate([[0.0], 1.0 / size, [0.0]])
    te, tf = t[:-1], t[1:]
    open_ = 1.0 + dot(te, tf)
    binormal = 2.0 * cross(te, tf) / open_[:, None]
    mean = (te + tf) / open_[:, None]
    return _Vertices(
        te, tf, r[:-1], r[1:], (d1[:-1], d1[1:]), (d2[:-1], d2[1:]), open_, binormal, mean
    )


def strains(shape: Frames, lengths: FloatArray, ends: EndFrames) -> tuple[FloatArray, FloatArray]:
    """Stretch of the edges, shape (N,), and curvatures and twist of the vertices [rad], (N + 1, 3).

    Curvatures are integrated, about the first and the second director; at a free end all are 0.
    """
    _, size = edges_of(shape.x)
    return size / lengths - 1.0, _vertex_strains(_vertices(shape, ends))


def _vertex_strains(v: _Vertices) -> FloatArray:
    carried = transported(v.d1[0], v.te, v.tf)
    return np.column_stack(
        [
            0.5 * dot(v.binormal, v.d1[0] + v.d1[1]),
            0.5 * dot(v.binormal, v.d2[0] + v.d2[1]),
            angle_between(carried, v.d1[1], v.tf),
        ]
    )


def _slopes(v: _Vertices) -> FloatArray:
    """Derivatives of the strains by first edge, its spin, second edge, its spin, (n, 3, 8)."""
    n = len(v.e)
    result = np.zeros((n, 3, 8))
    for a, (de, df) in enumerate((v.d1, v.d2)):
        kappa = 0.5 * dot(v.binormal, de + df)[:, None]
        mean = (de + df) / v.open[:, None]
        result[:, a, 0:3] = v.e[:, None] * (cross(v.tf, mean) - kappa * v.mean)
        result[:, a, 4:7] = v.f[:, None] * (-cross(v.te, mean) - kappa * v.mean)
    for k, at in ((0, 3), (1, 7)):
        result[:, 0, at] = 0.5 * dot(v.binormal, v.d2[k])
        result[:, 1, at] = -0.5 * dot(v.binormal, v.d1[k])
    result[:, 2, 0:3] = 0.5 * v.e[:, None] * v.binormal
    result[:, 2, 4:7] = 0.5 * v.f[:, None] * v.binormal
    result[:, 2, 3], result[:, 2, 7] = -1.0, 1.0
    return result


def _bends(v: _Vertices, stress: FloatArray) -> FloatArray:
    """Second derivatives of the strains, summed with the stresses (n, 3), shape (n, 8, 8).

    Both curvatures at once: with moments M1, M2 they are that of kb . (De + Df) / 2 with the
    vectors D = M1 d1 + M2 d2, whose derivative by the spin is D' = M1 d2 - M2 d1.
    """
    m1, m2, torque = (stress[:, [a]] for a in range(3))
    de, df = (m1 * d1 + m2 * d2 for d1, d2 in zip(v.d1, v.d2, strict=True))
    ge, gf = (m1 * d2 - m2 * d1 for d1, d2 in zip(v.d1, v.d2, strict=True))
    e, f, c = v.e[:, None, None], v.f[:, None, None], v.open[:, None, None]
    kb, mean = v.binormal, v.mean
    work = 0.5 * dot(kb, de + df)[:, None, None]
    across = (de + df) / v.open[:, None]
    mm, one = _outer(mean, mean), np.eye(3)
    te_m, tf_m = _outer(cross(v.te, across), mean), _outer(cross(v.tf, across), mean)
    result = np.zeros((len(v.e), 8, 8))
    kbe, kbf = _outer(kb, de), _outer(kb, df)
    twisted_e, twisted_f = _outer(kb, v.te + mean), _outer(kb, v.tf + mean)
    t = torque[:, :, None]
    ee = 2.0 * work * mm - tf_m - tf_m.transpose(0, 2, 1)
    ee += 0.25 * (kbe + kbe.transpose(0, 2, 1)) - work / c * (one - _outer(v.te, v.te))
    ee -= 0.25 * t * (twisted_e + twisted_e.transpose(0, 2, 1))
    ff = 2.0 * work * mm + te_m + te_m.transpose(0, 2, 1)
    ff += 0.25 * (kbf + kbf.transpose(0, 2, 1)) - work / c * (one - _outer(v.tf, v.tf))
    ff -= 0.25 * t * (twisted_f + twisted_f.transpose(0, 2, 1))
    ef = 2.0 * work * mm - tf_m + te_m.transpose(0, 2, 1) - _skew(across)
    ef -= work / c * (one + _outer(v.te, v.tf))
    ef += 0.5 * t * (2.0 / c * _skew(v.te) - _outer(kb, mean))
    result[:, 0:3, 0:3] = e * e * ee
    result[:, 4:7, 4:7] = f * f * ff
    result[:, 0:3, 4:7] = e * f * ef
    result[:, 4:7, 0:3] = (e * f * ef).transpose(0, 2, 1)
    for g, d, at in ((ge, de, 3), (gf, df, 7)):
        along = 0.5 * dot(kb, g)[:, None] * mean
        by_e = v.e[:, None] * (cross(v.tf, g) / v.open[:, None] - along)
        by_f = v.f[:, None] * (-cross(v.te, g) / v.open[:, None] - along)
        result[:, 0:3, at] = result[:, at, 0:3] = by_e
        result[:, 4:7, at] = result[:, at, 4:7] = by_f
        result[:, at, at] = -0.5 * dot(kb, d)
    return result


@lru_cache(maxsize=1)
def _incidence() -> FloatArray:
    """First edge, its spin, second edge, its spin of a vertex by its eleven numbers, (8, 11)."""
    result = np.zeros((8, BANDS))
    for c in range(3):
        result[c, c], result[c, 4 + c] = -1.0, 1.0
        result[4 + c, 4 + c], result[4 + c, 8 + c] = -1.0, 1.0
    result[3, 3] = result[7, 7] = 1.0
    return result


@lru_cache(maxsize=8)
def _places(nodes: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Places of the lower halves of the vertices' matrices in the flat band, padded at both
    ends.
    """
    size = DOF * (nodes + 2)
    row, column = np.tril_indices(BANDS)
    start = DOF * np.arange(nodes)[:, None]
    return ((row - column) * size + start + column).ravel(), row, column


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
    tangent, size = edges_of(x)
    stretch = size / p.lengths - 1.0
    v = _vertices(shape, p.ends)
    strain = _vertex_strains(v)
    stress = np.einsum("nab,nb->na", p.stiffness, strain) - p.offset
    value = 0.5 * float(np.sum((stress - p.offset) * strain))
    value += float(np.sum((0.5 * p.stretch[0] * stretch - p.stretch[1]) * stretch))
    tangents = p.stiffness
    if p.softening is not None:
        energy, more, steeper = _softened(strain, *p.softening)
        value, stress, tangents = value + energy, stress + more, tangents + steeper
    value += float(np.sum((0.5 * p.spring[0][:, None] * x - p.load[0]) * x))
    value += float(np.sum((0.5 * p.spring[1] * spin - p.load[1]) * spin))
    gradient, band = np.zeros(DOF * nodes), np.zeros((BANDS, DOF * nodes))
    at = gradient.reshape(nodes, DOF)
    if slopes:
        jacobian = _slopes(v)
        hessian = _bends(v, stress)
        hessian += jacobian.transpose(0, 2, 1) @ tangents @ jacobian
        a = _incidence()
        local = np.einsum("na,nab->nb", stress, jacobian) @ a  # (nodes, 11)
        padded = np.zeros((nodes + 2) * DOF)
        for c in range(BANDS):
            padded[c : c + DOF * nodes : DOF] += local[:, c]
        gradient += padded[DOF : DOF * (nodes + 1)]
        flat, row, column = _places(nodes)
        values = (a.T @ hessian @ a)[:, row, column].ravel()
        count = BANDS * DOF * (nodes + 2)
        whole = np.bincount(flat, weights=values, minlength=count).reshape(BANDS, -1)
        band += whole[:, DOF : DOF * (nodes + 1)]
        _stretch_slopes(p, tangent, size, stretch, at, band)
        at[:, :3] += p.spring[0][:, None] * x - p.load[0]
        at[:-1, 3] += p.spring[1] * spin - p.load[1]
        for c in range(3):
            band[0, c::DOF] += p.spring[0]
        band[0, 3 : DOF * (nodes - 1) : DOF] += p.spring[1]
    value += _touch(p, x, at, band, slopes)
    if p.drag is not None:
        value += _blow(p.drag, x, at, band)
    if slopes:
        _hold(p.free, gradient, band)
    return value, gradient, band


def _stretch_slopes(
    p: SpatialPotential, tangent: FloatArray, size: FloatArray, stretch: FloatArray, at: FloatArray,
    band: FloatArray,
) -> None:  # fmt: skip
    """Add the stretch of the edges to gradient (N + 1, 4) and Hessian."""
    force = (p.stretch[0] * stretch - p.stretch[1]) / p.lengths
    at[:-1, :3] -= force[:, None] * tangent
    at[1:, :3] += force[:, None] * tangent
    along, across = p.stretch[0] / p.lengths**2, force / size
    h = (along - across)[:, None, None] * _outer(tangent, tangent)
    h += across[:, None, None] * np.eye(3)
    last = DOF * len(tangent)
    for r in range(3):
        for c in range(3):
            if r >= c:
                band[r - c, c:last:DOF] += h[:, r, c]
                band[r - c, DOF + c :: DOF] += h[:, r, c]
            band[DOF + r - c, c:last:DOF] -= h[:, r, c]


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


def _hold(free: NDArray[np.bool_], gradient: FloatArray, band: FloatArray) -> None:
    """Take what is held out of gradient and Hessian."""
    gradient[~free] = 0.0
    band[:, ~free] = 0.0
    for d in range(1, BANDS):
        band[d, :-d][~free[d:]] = 0.0
    band[0, ~free] = 1.0


def moved(shape: Frames, change: FloatArray) -> Frames:
    """A shape after a change of its degrees of freedom, shape (4 (N + 1),)."""
    by = change.reshape(-1, DOF)
    before, _ = edges_of(shape.x)
    x = shape.x + by[:, :3]
    after, _ = edges_of(x)
    director = transported(shape.director, before, after)
    return Frames(x, spun(director, after, by[:-1, 3]))
