# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The observer in space where strands cross: rendered pairs of pictures, each a first detection.

    python test/support/vision_space_strands.py [COUNT] [FIRST] [--kind loop|second] [--ends N]

A rope of random shape in front of the two cameras of the experiment `two_grippers`: one that turns
once over itself (loop), or one with a second rope of the same look behind it (second). Both of its
ends are held, or (--ends 1) its start alone. *Wrong*: published, and a point lies more than 5 mm
beside the rope, or 2 % of the points more than 12 mm from where the rope has the same u. Counted
beside that are pairs that are wrong by more than three stated standard deviations, as in
`vision_stress`.
"""

from __future__ import annotations

import argparse
from collections import Counter

import dlo_ros  # isort: skip (sets the number of threads before numpy counts them)
import numpy as np
import yaml
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from vision_stress import BEYOND, NEARBY

from dlo_ros.command import Command, Motion
from dlo_ros.errors import VisionError
from dlo_ros.observation import CentrelinePoints
from dlo_ros.recordings.images import decode
from dlo_ros.synthesis.camera_geometry import Geometry
from dlo_ros.synthesis.experiment import Experiment, find_experiment, read_experiment
from dlo_ros.synthesis.picture_bag import camera_info
from dlo_ros.synthesis.spatial_render import SpatialRenderer
from dlo_ros.vision.camera.pinhole import Camera
from dlo_ros.vision.space import SpaceObserver
from dlo_ros.vision.space.spatial_observer import Frame

assert dlo_ros
KINDS = ("loop", "second")
STAMP = 10**18
POINTS = 2001
WRONG, WRONG_AT_U = 5e-3, 12e-3  # [m]


def _experiment() -> Experiment:
    tree = yaml.safe_load(find_experiment("two_grippers").read_text())
    return read_experiment(tree, "two_grippers", "two_grippers")


def _rope(rng: np.random.Generator, length: float, turns: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (POINTS, 3) of a smooth curve about the middle of the pictures, and its tangents."""
    s = np.linspace(0.0, 1.0, POINTS)

    def waves(count: int) -> np.ndarray:
        rows = [rng.normal(0.0, 0.35) * np.sin(np.pi * k * s + rng.uniform(0.0, 6.0))
                for k in range(1, count + 1)]  # fmt: skip
        return np.sum(rows, axis=0)

    turn = 2.0 * np.pi * turns / (1.0 + np.exp((rng.uniform(0.4, 0.6) - s) / 0.11))
    heading, dip = rng.uniform(-0.4, 0.4) + turn + waves(2), rng.uniform(-0.3, 0.3) + waves(3)
    tangents = np.column_stack(
        [np.cos(dip) * np.cos(heading), np.sin(dip), np.cos(dip) * np.sin(heading)]
    )
    steps = 0.5 * (tangents[1:] + tangents[:-1]) * (length / (POINTS - 1))
    points = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    middle = np.array([0.15, 0.0, -0.05]) + rng.normal(0.0, 0.01, 3)
    return points - points.mean(axis=0) + middle, tangents


def _clamp(tangent: np.ndarray) -> np.ndarray:
    """Quaternion of a clamp whose x axis points along a tangent."""
    aside = np.cross([0.0, 0.0, 1.0], tangent)
    aside /= np.linalg.norm(aside)
    axes = np.column_stack([tangent, aside, np.cross(tangent, aside)])
    return Rotation.from_matrix(axes).as_quat()


def outcome(seed: int, kind: str, ends: int) -> str:
    """Outcome of one pair of pictures: "right", "wrong", or the reason of the silence."""
    return judged(seed, kind, ends)[0]


def judged(seed: int, kind: str, ends: int) -> tuple[str, float]:
    """The outcome of one pair of pictures, and its error over the stated std, NaN in silence."""
    made, rng = _experiment(), np.random.default_rng(seed)
    rod, turns = made.truth.rod, rng.choice([-1.0, 1.0]) if kind == "loop" else 0.0
    rope, tangents = _rope(rng, rod.length, turns)
    behind = [_rope(rng, rod.length, 0.0)[0]] if kind == "second" else []
    u = np.linspace(0.0, rod.length, POINTS)
    cameras, frames = {}, {}
    for name, (camera, pose) in made.cameras.items():
        geometry = Geometry(camera, pose)
        renderer = SpatialRenderer(
            geometry, made.look, rod.diameter, made.look.board_distance, seed
        )
        info = camera_info(camera, name)
        cameras[name] = Camera.from_info(
            info.k, info.d, info.distortion_model, info.width, info.height, pose
        )
        frames[name] = Frame(STAMP, decode(renderer.encode(renderer.frame([rope], u, behind))))
    motion, held = Motion(), slice(None) if ends == 2 else slice(1)
    places = rope[[0, -1]][held][None]
    rotations = np.array([_clamp(t) for t in tangents[[0, -1]][held]])[None]
    names = ("start", "end")[:ends]
    motion.add(
        Command(STAMP - 1, names, np.zeros(1), places, rotations, np.full(places.shape, np.nan),
                rod.control_points, "board")
    )  # fmt: skip
    try:
        found = SpaceObserver(made.guess, cameras, motion).observe(frames).observation.points
    except VisionError as err:
        return str(err), np.nan
    beside = cKDTree(rope).query(found.positions)[0]
    there = np.column_stack([np.interp(found.u, u, column) for column in rope.T])
    apart = np.linalg.norm(there - found.positions, axis=1)
    wrong = beside.max() > WRONG or np.quantile(apart, 0.98) > WRONG_AT_U
    return "wrong" if wrong else "right", error_over_std(found, rope, rod.length)


def error_over_std(points: CentrelinePoints, rope: np.ndarray, length: float) -> float:
    """Root mean square of error over stated std, across the rope or along it, the larger one.

    The rope is looked for near each point's u: at a crossing another part of it may be nearer.
    """
    step = length / (len(rope) - 1)
    reach = round(NEARBY * (len(rope) - 1))
    around = np.rint(points.u / step).astype(int)[:, None] + np.arange(-reach, reach + 1)
    around = np.clip(around, 0, len(rope) - 1)
    nearest = np.argmin(np.linalg.norm(points.positions[:, None] - rope[around], axis=2), axis=1)
    at = around[np.arange(len(points.u)), nearest]
    tangent = np.gradient(rope, step, axis=0)[at]
    offset = points.positions - rope[at]
    ahead = np.sum(tangent * offset, axis=1)
    aside = np.linalg.norm(offset - ahead[:, None] * tangent, axis=1) / np.sqrt(2.0)  # each way
    along = points.u - at * step - ahead
    found = [aside / points.std]
    if points.std_along is not None:
        found.append(along / points.std_along)
    return max(float(np.sqrt(np.mean(x**2))) for x in found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=40)
    parser.add_argument("first", nargs="?", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, default="second")
    parser.add_argument("--ends", type=int, choices=(1, 2), default=1)
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.count)
    found = {seed: judged(seed, arguments.kind, arguments.ends) for seed in seeds}
    told = Counter(x if x in ("right", "wrong") else "silent" for x, _ in found.values())
    print(f"{arguments.kind}, {arguments.ends} held: {dict(told)}")
    print("wrong:", [seed for seed, (x, _) in found.items() if x == "wrong"])
    print("beyond three std:", [seed for seed, (_, off) in found.items() if off > BEYOND])


if __name__ == "__main__":
    main()
