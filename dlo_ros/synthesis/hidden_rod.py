# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The discrete rod with the effects that an experiment hides in it.

Positions u of effects, pins and measured points count in the configured length, as everything does
that is seen from outside; the true rope may be longer, evenly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dlo_ros.errors import InputError
from dlo_ros.parameters import Settings
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis import foreign_effects
from dlo_ros.synthesis.discrete_rod import DiscreteRod, tributary_lengths
from dlo_ros.synthesis.hidden_effects import HiddenEffects
from dlo_ros.synthesis.rod_simulation import Change
from dlo_ros.synthesis.spatial_rod import SpatialRod, in_space

SAMPLES = 16  # of a property over half an edge
PLANE_ONLY = ("plasticity", "hysteresis", "surface_friction")  # laws with a memory in one plane
PLUG = 500.0  # bending stiffness of a connector over that of the rope; more would cost rounding


def true_length(settings: Settings, hidden: HiddenEffects) -> float:
    """Length of the rope at the start [m]."""
    return settings.rod.length + hidden.number("length_error", "difference")


def nodes_at(
    settings: Settings, hidden: HiddenEffects, pins: Sequence[float], edges: int
) -> list[float]:
    """Material coordinates u [m] where the rod needs a node, pins first.

    Where two are wanted closer together than a third of an edge, the second is left out: it would
    make an edge too short to compute with.
    """
    length = settings.rod.length
    wanted = list(pins)
    if "stiff_segment" in hidden:
        centre = hidden.number("stiff_segment", "centre")
        half = 0.5 * hidden.number("stiff_segment", "extent")
        wanted += [centre - half, centre + half]
    if "connector" in hidden:
        wanted.append(length - hidden.number("connector", "extent"))
    for name in ("point_mass", "intrinsic_curvature"):
        if name in hidden:
            wanted.append(hidden.number(name, "position"))
    near = length / edges / 3.0
    result: list[float] = []
    for u in wanted:
        if near < u < length - near and all(abs(u - v) > near for v in result):
            result.append(u)
    return result


def build_spatial_rod(
    settings: Settings, hidden: HiddenEffects, *, edges: int, pins: Sequence[float] = ()
) -> SpatialRod:
    """A rod in space; see `build_rod`.

    Raises:
        InputError: an effect that the rod knows in the plane alone.
    """
    plane_only = [name for name in PLANE_ONLY if name in hidden]
    if plane_only:
        raise InputError(
            f"effects.{plane_only[0]} can be simulated in the plane y = 0 alone; leave it out, or "
            "keep motion, gravity and the other effects in that plane"
        )
    plane = build_rod(settings, hidden, edges=edges, pins=pins)
    rod = in_space(plane, settings.rod, hidden.gravity(np.array(settings.gravity)))
    rod.force[:, 1] = rod.vertex_lengths * hidden.number("constant_force", "y")
    u, length = rod.u * (settings.rod.length / rod.u[-1]), settings.rod.length
    rod.second_curvature = _over_vertices(u, lambda at: _curvature(at, length, hidden, "across"))
    rod.twist_stiffness *= hidden.number("twisting_stiffness", "ratio", 1.0)
    ratio = hidden.number("anisotropy", "ratio", 1.0)
    angle = hidden.number("anisotropy", "angle")
    soft = np.array([np.cos(angle), np.sin(angle)])  # axis about which it bends more easily
    stiff = np.array([-soft[1], soft[0]])
    section = np.outer(soft, soft) + ratio * np.outer(stiff, stiff)
    rod.section = np.tile(section, (len(rod.mass), 1, 1))
    # A grip gives alike about every axis, however flat the rope is that it holds.
    for end, key in ((0, "start"), (-1, "end")):
        whole = rod.bending_stiffness[end]
        give = hidden.number("clamp_compliance", key) / rod.vertex_lengths[end]
        softness = (1.0 / whole - give) * np.linalg.inv(section) + give * np.eye(2)
        rod.section[end] = np.linalg.inv(softness) / whole
    return rod


def build_rod(
    settings: Settings, hidden: HiddenEffects, *, edges: int, pins: Sequence[float] = ()
) -> DiscreteRod:
    """A rod with all that is hidden in it and does not change in time.

    Args:
        settings: parameters of the rod.
        hidden: the effects.
        edges: wanted number of edges.
        pins: material coordinates u [m] where a node must lie.
    """
    length = settings.rod.length
    grown = true_length(settings, hidden) / length
    damping = replace(
        settings.damping,
        air_drag=settings.damping.air_drag + hidden.number("air_drag", "coefficient"),
        relaxation_time=settings.damping.relaxation_time
        + hidden.number("internal_damping", "relaxation_time"),
    )
    rod = DiscreteRod.uniform(
        replace(settings.rod, length=length * grown),
        damping,
        gravity=hidden.gravity(np.array(settings.gravity))[[0, 2]],
        edges=edges,
        nodes_at=[grown * u for u in nodes_at(settings, hidden, pins, edges)],
    )
    u, tributary = rod.u / grown, rod.vertex_lengths
    softness = _over_vertices(u, lambda at: 1.0 / _stiffness_ratio(at, length, hidden))
    rod.bending_stiffness = rod.bending_stiffness / softness
    give_at_grips(rod, hidden)
    rod.rest_curvature = _over_vertices(u, lambda at: _curvature(at, length, hidden))
    rod.kink = hidden.number("intrinsic_curvature", "kink") * _hat(
        u, hidden.number("intrinsic_curvature", "position")
    )
    rod.mass = rod.mass + _hung_mass(u, length, hidden)
    along = (hidden.number("constant_force", "x"), hidden.number("constant_force", "z"))
    rod.force = tributary[:, None] * np.array(along)
    rod.friction = tributary * hidden.number("surface_friction", "force")
    rod.half_curvature = hidden.number("nonlinear_stiffness", "half_curvature", np.inf)
    rod.yield_curvature = hidden.number("plasticity", "yield_curvature", np.inf)
    rod.hardening = hidden.number("plasticity", "hardening")
    rod.quadratic_drag = tributary * hidden.number("quadratic_drag", "coefficient")
    if "wall" in hidden:
        angle, offset = (hidden.number("wall", key) for key in ("angle", "offset"))
        rod.wall = np.array([np.sin(angle), np.cos(angle), offset + 0.5 * settings.rod.diameter])
    if "obstacle" in hidden:
        x, z, radius = (hidden.number("obstacle", key) for key in ("x", "z", "radius"))
        rod.pegs = np.array([[x, z, radius + 0.5 * settings.rod.diameter]])
    rod.friction_moment = hidden.number("hysteresis", "moment")
    rod.hysteresis_width = hidden.number("hysteresis", "curvature", 1.0)
    rod.relaxing = hidden.number("viscoelasticity", "share")
    rod.lasting = hidden.number("viscoelasticity", "time", 1.0)
    return rod


def give_at_grips(rod: DiscreteRod, hidden: HiddenEffects) -> None:
    """Put a hinge beside each grip that gives, in series with the half edge that it clamps."""
    gives = [hidden.number("clamp_compliance", name) for name in ("start", "end")]
    for end, compliance in zip((0, -1), gives, strict=True):
        softer = rod.bending_stiffness[end] * compliance / rod.vertex_lengths[end]
        rod.bending_stiffness[end] /= 1.0 + softer
    rod.hinged = (gives[0] > 0.0, gives[1] > 0.0)


def change(
    settings: Settings, hidden: HiddenEffects, travelled: Callable[[float], float], axes: int = 2
) -> Change | None:
    """Properties of the rod at a time, where some of them change by themselves.

    Args:
        settings: parameters of the rod.
        hidden: the effects.
        travelled: fraction of the imposed points' way that is behind them at a time [s].
        axes: coordinates of a node: 2 in the plane, 3 in space.

    Returns:
        None where nothing changes.
    """
    parts: list[Change] = []
    slip = hidden.number("clamp_slip", "length")
    if slip:
        initial, onset = true_length(settings, hidden), hidden.number("clamp_slip", "onset", -1.0)
        took = hidden.number("clamp_slip", "duration", 0.1)

        def slide(rod: DiscreteRod, time: float) -> DiscreteRod:
            u = rod.u * (settings.rod.length / initial)
            hung = _hung_mass(u, settings.rod.length, hidden)
            share = travelled(time)
            if onset >= 0.0:  # half a wave of a cosine
                share = 0.5 - 0.5 * np.cos(np.pi * np.clip((time - onset) / took, 0.0, 1.0))
            return stretched(rod, 1.0 + slip / initial * share, hung)

        parts.append(slide)
    if "stiffness_drift" in hidden:
        parts.append(foreign_effects.stiffness_drift(hidden.number("stiffness_drift", "rate")))
    if "gusts" in hidden:
        force, tau, seed = (
            hidden.number("gusts", key) for key in ("force", "correlation_time", "seed")
        )
        parts.append(foreign_effects.gusts(force, tau, int(seed), axes))
    if not parts:
        return None

    def all_changes(rod: DiscreteRod, time: float) -> DiscreteRod:
        for part in parts:
            rod = part(rod, time)
        return rod

    return all_changes


def stretched(rod: DiscreteRod, factor: float, hung: FloatArray) -> DiscreteRod:
    """A rod with more of the same material on every edge; what hangs on it stays as it is.

    A rope that slips through a grip gains its length there. Since it is the same everywhere, an
    even gain gives the same shape, and no edge grows beyond what the others can follow.

    Args:
        rod: the rod before it is lengthened.
        factor: length over the length before.
        hung: masses that belong to bodies on the nodes [kg], shape (N + 1,).
    """
    return replace(
        rod,
        lengths=factor * rod.lengths,
        mass=factor * (rod.mass - hung) + hung,
        drag=factor * rod.drag,
        force=factor * rod.force,
        friction=factor * rod.friction,
        quadratic_drag=factor * rod.quadratic_drag,
    )


def _over_vertices(u: FloatArray, value: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Mean of a property over the half edges beside each node, shape (N + 1,)."""
    lengths = np.diff(u)
    inner = (np.arange(SAMPLES) + 0.5) / SAMPLES * 0.5
    first = value(u[:-1, None] + lengths[:, None] * inner).mean(axis=1)
    second = value(u[1:, None] - lengths[:, None] * inner).mean(axis=1)
    total = np.zeros(len(u))
    total[:-1] += 0.5 * lengths * first
    total[1:] += 0.5 * lengths * second
    return np.asarray(total / tributary_lengths(lengths))


def _within_segment(u: FloatArray, hidden: HiddenEffects) -> FloatArray:
    """1 within the segment and 0 beside it; a tapered end in between is half a wave of a cosine."""
    extent = hidden.number("stiff_segment", "extent")
    inner = 0.5 * extent - np.abs(u - hidden.number("stiff_segment", "centre"))
    stretch = hidden.number("stiff_segment", "taper") * extent
    if stretch == 0.0:
        return np.asarray(np.where(inner >= 0.0, 1.0, 0.0))
    return np.asarray(0.5 + 0.5 * np.sin(np.pi * np.clip(inner / stretch, -0.5, 0.5)))


def _stiffness_ratio(u: FloatArray, length: float, hidden: HiddenEffects) -> FloatArray:
    """Bending stiffness over that of the uniform rod, any shape."""
    result = 1.0 + hidden.number("stiffness_gradient", "change") * (u / length - 0.5)
    if "stiff_segment" in hidden:
        result = result * hidden.number("stiff_segment", "ratio") ** _within_segment(u, hidden)
    if "connector" in hidden:
        result = result * np.where(u > length - hidden.number("connector", "extent"), PLUG, 1.0)
    return result


def _curvature(
    u: FloatArray, length: float, hidden: HiddenEffects, key: str = "curvature"
) -> FloatArray:
    """Curvature at rest [1/m], any shape; values of a list are spread evenly over the length."""
    given = hidden.effects.get("intrinsic_curvature", {}).get(key, 0.0)
    values = np.atleast_1d(np.asarray(given, dtype=np.float64))
    return np.interp(u, np.linspace(0.0, length, len(values)), values)


def _hung_mass(u: FloatArray, length: float, hidden: HiddenEffects) -> FloatArray:
    """Mass of a hung body and of a plug on the nodes [kg], shape (N + 1,).

    The plug's is even from its beginning to the rope's end; each edge gives its share to its two
    nodes so that the plug keeps its centre of mass.
    """
    result = hidden.number("point_mass", "mass") * _hat(u, hidden.number("point_mass", "position"))
    mass, extent = (hidden.number("connector", key) for key in ("mass", "extent"))
    if mass and extent < 0.5 * (u[-1] - u[-2]):
        result[-1] += mass
    elif mass:
        first = np.clip(length - extent, u[:-1], u[1:])  # where the plug begins on each edge
        share = (u[1:] - first) / extent
        right = (0.5 * (first + u[1:]) - u[:-1]) / np.diff(u)  # its centre there, over the edge
        result[:-1] += mass * share * (1.0 - right)
        result[1:] += mass * share * right
    return result


def _hat(u: FloatArray, position: float) -> FloatArray:
    """Shares of the two nodes beside a position; all of it where a node lies, shape (N + 1,)."""
    result = np.zeros(len(u))
    right = min(max(int(np.searchsorted(u, position)), 1), len(u) - 1)
    share = float(np.clip((position - u[right - 1]) / (u[right] - u[right - 1]), 0.0, 1.0))
    result[right - 1], result[right] = 1.0 - share, share
    return result
