# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A clamp that goes round a loop in space and comes back leaves the rod as it was.

At rest the shape and the twist depend on the clamps alone, as long as the rod does not snap. The
frame that twist is counted from is carried along in time, though, at as many points as theta has
coefficients: what is lost between them falls with the second power of the spacing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from report import FAINT, OURS, Result, canvas, main, save
from scene import ROPE, hold, lead, straight

from dlo_ros.rod.resolution import build
from dlo_ros.rod.state import twist_angle
from dlo_ros.spline import FloatArray

SPANS = (14, 28, 56)


@dataclass(frozen=True)
class ClosedLoop(Result):
    """Changes of shape over L and of the total twist [rad] by spans; the loop's shapes [m]."""

    changes: FloatArray
    twists: FloatArray
    shapes: FloatArray


def run() -> ClosedLoop:
    """Bring one clamp closer, then lead it round a loop."""
    length = ROPE.rod.length
    approach = np.linspace([length, 0.0, 0.0], [0.625 * length, 0.0, 0.0], 10)
    t = np.linspace(0.0, 2.0 * np.pi, 121)
    loop = np.column_stack([0.2 * (np.cos(t) - 1.0), 0.3 * np.sin(t), 0.21 * (1.0 - np.cos(t))])
    ends = np.vstack([approach, approach[-1] + length * loop])
    command = hold(["start", "end"], [[[0.0, 0.0, 0.0], end] for end in ends])
    u = np.linspace(0.0, length, 101)
    changes, twists = [], []
    for spans in SPANS:
        model, boundary = build(ROPE, command, spans)
        states = [p.state for p in lead(model, boundary, straight(model), command)][len(approach) :]
        shapes = np.array([model.basis.evaluate(state.q[:, :3], u) for state in states])
        changes.append(np.linalg.norm(shapes[-1] - shapes[0], axis=1).max() / length)
        twists.append(abs(twist_angle(states[-1], model)[-1] - twist_angle(states[0], model)[-1]))
    summary = (
        f"after a loop the shape has changed by {changes[-1]:.1e} L and the twist by "
        f"{twists[-1]:.1e} rad, with {SPANS[-1]} spans"
    )
    return ClosedLoop(summary, changes[-1], np.array(changes), np.array(twists), shapes)


def plot(result: ClosedLoop, path: Path) -> None:
    """Shapes along the loop, and what is left of it by spans."""
    space, error = canvas(projections=("3d", None))
    for points in result.shapes[::10]:
        space.plot(*points.T, color=OURS, lw=1)
    space.plot(*result.shapes[:, -1].T, "--", color=FAINT, label="way of the clamp")
    space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", aspect="equal")
    space.locator_params(nbins=4)
    space.legend(loc="upper left")
    error.loglog(SPANS, result.changes, "o-", label="change of shape / L")
    error.loglog(SPANS, result.twists, "s-", label="change of twist [rad]")
    error.set(xlabel="knot spans", xticks=SPANS, xticklabels=SPANS)
    error.minorticks_off()
    error.legend()
    save(space, path, "A clamp led round a loop and back")


if __name__ == "__main__":
    main(run, plot)
