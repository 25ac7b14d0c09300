# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The nearest shape to an observed one that is held as commanded and not stretched.

An observed spline has noise along its axis, which stiff stretch would turn into violent vibration.
The stretch energy is minimised, with a pull to the given shape and a bending energy that is zero in
the given shape: without it, what is too short between two points that are held would buckle in
waves as short as the basis allows. Beside a grip that gives the DLO is turned by the given shape's
moment, see `hinge_bending`. Pull and bending go from strong to weak together: a compression by a
share e of the length is held straight while e^2 is less than 4 `pull` `bend` (beam on an elastic
foundation). An end that is held otherwise than it was observed leads the DLO aside over a length of
sqrt(`STRAIGHT`), an eighth of the whole.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dlo_ros.errors import SimulationError
from dlo_ros.rod.boundary.imposed_motion import Boundary, Held
from dlo_ros.rod.elements import rod_forces
from dlo_ros.rod.elements.rod_tables import DOF, Material
from dlo_ros.rod.model import CONTACT_PENETRATION, RodModel
from dlo_ros.rod.solve import newton_iteration
from dlo_ros.rod.state import rest_state
from dlo_ros.rod.statics import FREE, LINEAR, NO_INTERNAL_VARIABLES
from dlo_ros.rod_settings import kink_curvature
from dlo_ros.spline import ORDER, FloatArray

# Pull to the given shape and bending stiffness while what is held is approached, and at the end.
STRONGEST, WEAKEST = 10.0, 1e-4
APPROACH = 10  # steps to what is held, at least
SMALLEST = 1e-3  # of the way there: a smaller step is not tried
SLOWEST = 0.9  # of the pull: smaller reductions are not tried
PROJECTIONS = 20  # onto the surface of a peg for each point of contact, at most
STRAIGHT = 0.015  # of the length: radius of gyration that the bending stiffness stands for


class Relaxation:
    """The search for the nearest shape that is not stretched.

    Args:
        model, boundary: the rod, and where it is held.
        held: degrees of freedom that the command holds; it is free of twist.
        shape: observed shape in the simulation's basis, shape (n, 4).
        growth: free length then over the model's, see `packing.growth_at`.
    """

    def __init__(
        self, model: RodModel, boundary: Boundary, held: Held, shape: FloatArray,
        growth: float,
    ) -> None:  # fmt: skip
        untwisted = held.target * [1.0, 1.0, 1.0, 0.0]
        self._model, self._boundary = model, boundary
        self._held = replace(held, target=untwisted)
        self._given = rest_state(0, led_back(model, boundary, shape), model)
        curvature = np.ascontiguousarray(self._given.strains.other[:, :2])
        self._turned, self._bend_share = hinge_bending(model, boundary, curvature, growth)
        twist = 0.0 * model.stiffness.twist + 1.0
        stretched = growth * (1.0 + model.stiffness.stretch_rest) - 1.0
        self._soft = model.stiffness._replace(
            stretch_rest=stretched, bend_rest=curvature, twist=twist
        )
        self._pulled = np.empty_like(self._given.q)
        rod_forces.multiply_scalar(model.gram, model.gram, self._given.q, self._pulled)

    def solution(self) -> tuple[FloatArray, float]:
        """The nearest shape (n, 4), and the pull with which it was found.

        Raises:
            SimulationError: the shape cannot be led to what is held.
        """
        best, share, step = self._given.q, 0.0, 1.0 / APPROACH
        while share < 1.0:
            to = share + step if 1.0 - share > 1.5 * step else 1.0
            found = self._relaxed(best, STRONGEST, to)
            if found is not None:
                best, share = found, to
            elif step > SMALLEST:
                step *= 0.5
            else:
                raise SimulationError(
                    "the first observed shape cannot be held as commanded; check rod.length, the "
                    "command and the observed spline"
                )
        weak, ratio = STRONGEST, 0.5
        while weak > WEAKEST and ratio < SLOWEST:
            found = self._relaxed(best, ratio * weak, 1.0)
            if found is None:
                ratio = ratio**0.5
            else:
                best, weak = found, ratio * weak
        return led_back(self._model, self._boundary, best), weak

    def solution_near(self, shape: FloatArray, pull: float) -> FloatArray:
        """The nearest shape (n, 4), where that of a little different problem is known.

        Raises:
            SimulationError: see `solution`.
        """
        found = self._relaxed(shape, pull, 1.0)
        if found is None:
            return self.solution()[0]
        return led_back(self._model, self._boundary, found)

    def _relaxed(self, q: FloatArray, weak: float, share: float) -> FloatArray | None:
        """The minimum near q (n, 4); None where Newton's method does not converge.

        Args:
            weak: weight of pull and bending.
            share: fraction of the way from the given shape to what is held.
        """
        model, boundary, held, given = self._model, self._boundary, self._held, self._given
        stiffest, length = float(self._soft.stretch.mean()), model.basis.length
        pull = weak * stiffest / length**2
        bend = weak * stiffest * (STRAIGHT * length) ** 2 * np.array([1.0, 1.0, 0.0])
        bend = self._bend_share[:, None] * bend
        rest = self._soft.bend_rest + share * self._turned
        matter = Material(
            self._soft._replace(bend=bend, bend_rest=rest), 1.0, rest, LINEAR, FREE,
            NO_INTERNAL_VARIABLES, 0.0, 0.0,
        )  # fmt: skip
        target, found = given.q + share * (held.target - given.q), q.copy()
        iterations, _ = newton_iteration.implicit_step(
            found, target, boundary.fixed, boundary.pins, boundary.pin_values(held),
            model.rule, matter, given.reference, pull * model.gram, pull * model.gram,
            pull * self._pulled, length, 1e-12,
        )  # fmt: skip
        return found if iterations > 0 else None


def hinge_bending(
    model: RodModel, boundary: Boundary, curvature: FloatArray, growth: float
) -> tuple[FloatArray, FloatArray]:
    """The bending beside grips that give, which an observed shape does not resolve.

    The grip turns by its compliance times the moment of the observed curvature. An error of that
    moment turns a soft grip far: the softer it is, the weaker it is held there, so that it follows
    the observed direction of the DLO instead.

    Args:
        model, boundary: the rod, and where it is held; an end of free direction has no moment.
        curvature: curvatures of the observed shape [1/m], shape (nb, 2).
        growth: see `Relaxation`.

    Returns:
        Curvatures of the hinges [1/m], shape (nb, 2), and bending stiffness over that elsewhere,
        shape (nb,).
    """
    body, result, share = model.body, np.zeros(curvature.shape), np.ones(len(curvature))
    for held, first in ((boundary.clamped_start, True), (boundary.clamped_end, False)):
        near = body.hinged & ((model.points < 0.5 * body.length) == first)
        if not (held and near.any()):
            continue
        give = np.asarray(body.hinge)[near]
        one, two, both = body.bend_matrix[near].T
        whole = np.stack([[one, both], [both, two]]).transpose(2, 0, 1)  # (m, 2, 2)
        alone = whole @ np.linalg.inv(np.eye(2) - give[:, None, None] * whole)
        bent = (curvature - body.bend_rest)[near]
        bent[:, 0] -= (1.0 / growth - 1.0) * kink_curvature(body)[near]
        result[near] = (give / growth)[:, None] * np.einsum("mij,mj->mi", alone, bent)
        turn = give * np.trace(alone, axis1=1, axis2=2) / 2.0  # over the DLO's own curvature
        turn *= 1.0 + body.weight[near] @ turn / (STRAIGHT * body.length)
        share[near] = 1.0 / (1.0 + turn)
    return result, share


def led_back(model: RodModel, boundary: Boundary, q: FloatArray) -> FloatArray:
    """The shape q (n, 4) with what is free of it led back to the free side of walls and pegs.

    A shape is observed with errors and may lie beyond a wall, or in a peg, by the DLO's radius; the
    contact would throw the DLO off.
    """
    result = np.array(q)
    free = ~boundary.fixed.reshape(-1, DOF)[:, 0]
    for x, z, offset in model.surroundings.walls:
        # A spline lies within the hull of its control points.
        deep = np.minimum(x * result[:, 0] + z * result[:, 2] - offset, 0.0) * free
        result[:, 0] -= deep * x
        result[:, 2] -= deep * z
    if len(model.surroundings.pegs):
        _lead_out_of_pegs(model, free, result)
    return result


def _lead_out_of_pegs(model: RodModel, free: NDArray[np.bool_], q: FloatArray) -> None:
    """Move the shape q (n, 4), in place, radially out of all pegs.

    The deepest point of contact is led to the surface by the smallest change of its control points,
    until none lies deeper than a contact at rest (Kaczmarz, Angenäherte Auflösung von Systemen
    linearer Gleichungen, 1937).

    Args:
        free: whether a control point is free, shape (n,).
    """
    around, length = model.surroundings, model.basis.length
    near = around.span[:, None] + np.arange(ORDER)  # (points of contact, 4)
    share = around.b * free[near]
    squares = np.sum(share**2, axis=1)
    movable = squares > 0.0
    for _ in range(PROJECTIONS * len(near)):
        points = np.einsum("pk,pkc->pc", around.b, q[near][:, :, [0, 2]])
        off = points[:, None] - around.pegs[:, :2]  # (points of contact, pegs, 2)
        distance = np.linalg.norm(off, axis=2)
        deep = (around.pegs[:, 2] - distance) * movable[:, None]
        k, peg = np.unravel_index(int(np.argmax(deep)), deep.shape)
        if deep[k, peg] <= CONTACT_PENETRATION * length:
            return
        outwards = off[k, peg] / max(float(distance[k, peg]), 1e-12)
        move = (share[k] / squares[k])[:, None] * (deep[k, peg] * outwards)
        q[near[k, 0] : near[k, 0] + ORDER, [0, 2]] += move
