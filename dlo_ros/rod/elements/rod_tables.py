# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Description of a rod for compiled code: quadrature, stiffness, reference frame.

Every knot span has three Gauss points; point k of span e is number 3 e + k.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dlo_ros.spline import FloatArray

DOF = 4  # x, y, z, theta of a control point
BAND = 15  # half bandwidth of the stiffness matrix


class Quadrature(NamedTuple):
    """Basis functions at the quadrature points; tables that never change.

    Stretch counts by its value in the middle of a span and twist by its mean, or either by the
    straight line that fits it best: three points by themselves would lock, see `RodModel.rule`.
    """

    span: NDArray[np.int64]  # (nb,)
    b: FloatArray  # (nb, 4)
    b1: FloatArray  # (nb, 4)
    b2: FloatArray  # (nb, 4)
    weight: FloatArray  # (nb,) [m]
    stretch_linear: NDArray[np.bool_]  # (spans,)
    twist_linear: NDArray[np.bool_]  # (spans,)


class Stiffness(NamedTuple):
    """Stiffness and rest strain at every quadrature point.

    Those of stretch and twist are the same all over a span.
    """

    stretch: FloatArray  # (nb,) [N]
    stretch_rest: FloatArray  # (nb,)
    bend: FloatArray  # (nb, 3) 11, 22, 12 [N m^2]
    bend_rest: FloatArray  # (nb, 2) [1/m]
    twist: FloatArray  # (nb,) [N m^2]
    twist_rest: FloatArray  # (nb,) [rad/m]


class ConstitutiveLaw(NamedTuple):
    """Deviation of bending from linear elasticity; see `constitutive_law`."""

    active: float  # 0: it does not
    half_curvature: FloatArray  # (nb,) [1/m] infinite: linear
    yield_curvature: FloatArray  # (nb,) [1/m] infinite: elastic
    hardening: float  # h: tangent stiffness past the yield over that before it, 0 to 1
    relaxing: float  # share of the bending stiffness that relaxes
    lasting: float  # [s] time in which it does
    slide: float  # largest moment of internal friction [N m]
    turn: FloatArray  # (nb,) [1/m] change of curvature within which that moment turns over


class Response(NamedTuple):
    """Stress resultants and their derivatives by the strains."""

    tension: FloatArray  # (nb,) [N]
    bend: FloatArray  # (nb, 2) [N m]
    torque: FloatArray  # (nb,) [N m]
    stretch_tangent: FloatArray  # (nb,) [N]
    bend_tangent: FloatArray  # (nb, 3) 11, 12, 22 [N m^2]
    twist_tangent: FloatArray  # (nb,) [N m^2]
    pull: FloatArray  # (nb,) tension that counts in the second derivatives [N]


class Springs(NamedTuple):
    """Forces on the control points that are linear in their places: stiffness q - pull."""

    stiffness: FloatArray  # (n d, 4 d) lower rows [N/m]
    pull: FloatArray  # (n d,) [N]


class Surroundings(NamedTuple):
    """Bodies in contact with the DLO, friction and quadratic drag; see `contact_and_friction`."""

    friction: float  # Coulomb friction with the board [N/m]
    creep: float  # displacement at which it acts fully [m]
    pegs: FloatArray  # (k, 3) x, z and distance from there to the DLO's axis at contact [m]
    contact: float  # stiffness of a contact [N/m^2]
    span: NDArray[np.int64]  # (nc,) of the points at which contact is looked for
    b: FloatArray  # (nc, 4) basis functions there
    weight: FloatArray  # (nc,) [m]
    walls: (
        FloatArray  # (k, 3) normal x, z to the free side, offset of the DLO's axis at contact [m]
    )
    brake: float  # c of the quadratic drag [N s^2/m^3]
    tow: Springs  # quadratic drag of a step, see `drag_springs`; or none


NO_SPRINGS = Springs(np.zeros((0, 0)), np.zeros(0))


class InternalVariables(NamedTuple):
    """Internal variables: the memory of bending and of friction."""

    yield_centre: FloatArray  # (nb, 2) middle of the elastic range [1/m]
    anchor: FloatArray  # (nb, 2) x and z where friction with the board is free of force [m]
    inner: FloatArray  # (nb, 6) two components each: moment of what relaxes over the bending
    # stiffness [1/m], moment of internal friction over its largest, curvature then [1/m]


class Material(NamedTuple):
    """All that resists a change of shape."""

    stiffness: Stiffness  # with damping
    damping: float  # stiffness with damping over that without
    bend_rest: FloatArray  # (nb, 2) without damping [1/m]
    law: ConstitutiveLaw
    around: Surroundings
    internal: InternalVariables  # before
    keep: float  # share of what has not relaxed that is left at the end of the step; 0 at rest
    gain: float  # what is added to that over the change of curvature; 0 at rest


class Reference(NamedTuple):
    """Reference frame at the quadrature points, transported in time without spin."""

    tangent: FloatArray  # (nb, 3)
    rate: FloatArray  # (nb, 3) derivative of the tangent along u [1/m]
    director: FloatArray  # (nb, 3) first director, unit and normal to the tangent
    twist: FloatArray  # (nb,) twist of the frame [rad/m]
