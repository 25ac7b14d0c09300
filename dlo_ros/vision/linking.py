"""What it costs to go on from the end of one chain to the start of another.

A DLO bends smoothly, so a strand leaves a crossing as it came in: with the same direction and
curvature. Costs are without unit, of the order of a negative log likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dlo_ros.spline import FloatArray
from dlo_ros.vision.chains import Chain, chain_end
from dlo_ros.vision.segmentation import BarMap

BENDING = 2.0  # times 4 (a^2 + ab + b^2) w / gap: bending energy of the bridge
UNSEEN = 0.25  # per width of bridge over pixels that do not look like the DLO
HIDDEN = 0.06  # per width of bridge over pixels like the DLO: a crossing, not a chain
COLOUR = 1.0  # for a change of colour by half the contrast
BACK = 0.75  # [widths] ends are moved back by this: chains overlap, or stop short of crossings
LARGEST_TURN = 1.8  # [rad] between the chord of a bridge and an end
CURVATURE_TRUST = 0.7  # share of the measured end curvature that is expected to go on


@dataclass(frozen=True, eq=False)
class Ends:
    """The ends of all chains, seen as entrances or exits; arrays of length 2 x chains.

    Index 2 k is the first point of chain k, 2 k + 1 the last. `directions` point out of the chain.
    """

    positions: FloatArray
    directions: FloatArray
    curvatures: FloatArray
    colours: FloatArray
    strengths: FloatArray

    def __len__(self) -> int:
        return len(self.positions)


def chain_ends(chains: list[Chain], width: float) -> Ends:
    """Measure both ends of all chains."""
    found = [chain_end(chain, last, width) for chain in chains for last in (False, True)]
    strengths = [float(np.median(chain.strength)) for chain in chains]
    return Ends(
        np.array([e.position for e in found]).reshape(-1, 2),
        np.array([e.direction for e in found]).reshape(-1, 2),
        np.array([e.curvature for e in found]),
        np.repeat(np.array([c.colour for c in chains]).reshape(-1, 3), 2, axis=0),
        np.repeat(np.array(strengths), 2),
    )


def bending_costs(
    position: FloatArray, direction: FloatArray, curvature: float, ends: Ends, width: float
) -> tuple[FloatArray, FloatArray]:
    """Cost of the bend to enter each of the ends, and the length of the bridge [px].

    Args:
        position, direction, curvature: where the curve comes from, shapes (2,), (2,).
        ends: those to go to; they are entered against their outward direction.
        width: of the DLO [px].

    Returns:
        Two arrays, one value for each end; infinite cost where no smooth curve leads there.
    """
    back = BACK * width
    inward = -ends.directions
    chord = (ends.positions + back * inward) - (position - back * direction)
    distance = np.maximum(np.hypot(chord[:, 0], chord[:, 1]), 1e-6)
    c = chord / distance[:, None]
    a = np.arctan2(direction[0] * c[:, 1] - direction[1] * c[:, 0], c @ direction)
    b = np.arctan2(c[:, 0] * inward[:, 1] - c[:, 1] * inward[:, 0], np.sum(c * inward, axis=1))
    # The curvature known at the ends holds for a short way only.
    half = 0.5 * np.minimum(distance, 4.0 * width) * CURVATURE_TRUST
    ea = a - half * curvature
    eb = b + half * ends.curvatures  # an end's curvature is signed going out
    energy = 4.0 * (ea * ea + ea * eb + eb * eb) * width / np.maximum(distance, 1.5 * width)
    possible = (np.abs(a) < LARGEST_TURN) & (np.abs(b) < LARGEST_TURN) & (distance > 0.4 * back)
    return np.where(possible, BENDING * energy, np.inf), np.maximum(distance - 2.0 * back, 0.0)


def bridge(
    position: FloatArray, direction: FloatArray, target: FloatArray, arriving: FloatArray
) -> FloatArray:
    """Smooth curve between two ends (cubic Hermite), about one point per pixel, shape (m, 2)."""
    chord = float(np.hypot(*(target - position)))
    count = max(2, int(np.ceil(chord)) + 1)
    s = np.linspace(0.0, 1.0, count)[:, None]
    m0, m1 = chord * direction, chord * arriving
    return np.asarray(
        (1 + 2 * s) * (1 - s) ** 2 * position
        + s * (1 - s) ** 2 * m0
        + s * s * (3 - 2 * s) * target
        - s * s * (1 - s) * m1
    )


def unseen_cost(
    points: FloatArray, colour: FloatArray, strength: float, bars: BarMap
) -> tuple[float, float]:
    """Cost of a bridge over pixels unlike the DLO, and the length of those pixels [px]."""
    height, width = bars.strength.shape
    columns = np.clip(np.rint(points[:, 0]).astype(int), 0, width - 1)
    rows = np.clip(np.rint(points[:, 1]).astype(int), 0, height - 1)
    difference = np.linalg.norm(bars.colour[rows, columns].astype(np.float64) - colour, axis=1)
    unlike = np.clip(difference / (0.6 * max(strength, 1.0)) - 0.3, 0.0, 1.0)
    length = float(np.sum(np.hypot(*np.diff(points, axis=0).T)))
    seen = float(np.mean(unlike))
    return (UNSEEN * seen + HIDDEN) * length / bars.width, seen * length


def colour_costs(colour: FloatArray, strength: float, ends: Ends) -> FloatArray:
    """Cost of the change of colour from one chain to each of the ends."""
    scale = 0.5 * np.maximum(strength, ends.strengths)
    difference: NDArray[np.float64] = np.linalg.norm(ends.colours - colour, axis=1) / scale
    return COLOUR * np.minimum(difference**2, 6.0)


def split_at(chains: list[Chain], point: FloatArray, width: float) -> list[Chain]:
    """Cut chains where they pass a clamp, so that a path can start or end there."""
    result: list[Chain] = []
    least = max(4, round(1.0 * width))
    for chain in chains:
        distance = np.hypot(*(chain.points - point).T)
        at = int(np.argmin(distance))
        if distance[at] > 1.5 * width or at < least or at > len(distance) - least:
            result.append(chain)
            continue
        result.extend([chain.part(0, at + 1), chain.part(at, len(distance))])
    return result
