# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How well the observer in space does on rendered pictures of a rope that moves in space.

    python test/support/vision_space_accuracy.py [MOTIONS] [FIRST] [--depth] [--late MS]
                                                 [--blur PX] [--exposure MS] [--faint LEVELS]

Each motion is the experiment `twisted` with another seed: other ways of the end, other colours. Two
cameras of 1280 x 720 px see the rope 5 px wide from 1.2 m, 0.3 m apart; with --depth the left one
alone with a depth sensor of 2 mm noise, holes and mixed pixels. --late shifts the right camera's
pictures: they show the rope by so much later, and say so. --blur is the standard deviation of the
lens's point spread, --exposure the time over which a picture is gathered, --faint the grey levels
by which the rope is darker than the board.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import dlo_ros  # isort: skip (sets the number of threads before numpy counts them)
import numpy as np
import yaml
from scipy.spatial import cKDTree

from dlo_ros.command import Motion
from dlo_ros.errors import VisionError
from dlo_ros.parameters import Settings
from dlo_ros.recordings.camera_bags import iterate_together
from dlo_ros.recordings.images import decode
from dlo_ros.recordings.read import read_recording
from dlo_ros.synthesis.camera_geometry import Geometry
from dlo_ros.synthesis.experiment import find_experiment, read_experiment
from dlo_ros.synthesis.picture_bag import SAMPLES
from dlo_ros.synthesis.picture_settings import Look
from dlo_ros.synthesis.spatial_render import SpatialRenderer
from dlo_ros.synthesis.synthesize import synthesize
from dlo_ros.vision.space import SpaceObserver
from dlo_ros.vision.space.spatial_observer import Frame
from dlo_ros.vision.space.view import cameras_of

assert dlo_ros
DURATION = 2.5  # [s] of each motion
WRONG = 5e-3  # [m] that a point may lie beside the rope
INSIDE = 2.448  # stds across within which 95 % of the points lie, two directions


def experiment(
    seed: int, depth: bool, camera: Mapping[str, float] = {}, faint: float | None = None
):
    """The experiment of a seed, with further entries of its cameras and the rope's contrast."""
    rng = np.random.default_rng(seed)
    tree = yaml.safe_load(find_experiment("twisted").read_text())
    tree["duration"] = DURATION
    for point in tree["motion"]["end"]:
        point["position"] = [
            float(v) for v in np.array(point["position"]) + rng.normal(0, 0.015, 3)
        ]
        for key in ("angle", "swing", "turn"):
            point[key] = float(point.get(key, 0.0) + rng.normal(0, 0.2))
    tree["look"] = {"rope_colour": [float(v) for v in rng.uniform(10, 90, 3)]}
    if faint is not None:
        tree["look"]["rope_colour"] = [v - faint for v in Look.board_colour]
    for one in tree["cameras"].values():
        one.update(camera)
    if depth:
        left = tree.pop("cameras")["left"]
        tree["parameters"]["camera"] = {k: left.pop(k) for k in ("translation", "rotation")}
        tree["camera"] = {"rate": 30.0, **left}
        tree["depth"] = {"std": 0.002}
    return read_experiment(tree, f"seed {seed}", "twisted")


def shown_later(made, truth, name: str, late: float, seed: int):
    """The pictures of one camera, taken later than the others' [s]."""
    camera, stated = made.cameras[name]
    u = np.linspace(0.0, made.truth.rod.length, SAMPLES)
    renderer = SpatialRenderer(
        Geometry(camera, stated), made.look, made.truth.rod.diameter, made.look.board_distance, seed
    )
    times = (np.array(truth.stamps) - truth.stamps[0]) * 1e-9
    for k in range(len(times) - 1):
        # Between two frames by cubic Hermite: positions and velocities are known.
        h, s = times[k + 1] - times[k], late / (times[k + 1] - times[k])
        nodes = (
            (2 * s**3 - 3 * s**2 + 1) * truth.nodes[k]
            + (s**3 - 2 * s**2 + s) * h * truth.velocities[k]
            + (3 * s**2 - 2 * s**3) * truth.nodes[k + 1]
            + (s**3 - s**2) * h * truth.velocities[k + 1]
        )
        moved = nodes - truth.nodes[k]
        line = truth.centreline(k, u) + np.column_stack(
            [np.interp(u, truth.u, column) for column in moved.T]
        )
        yield decode(renderer.encode(renderer.frame([line], u)))


def evaluate(
    seed: int,
    folder: Path,
    *,
    depth: bool,
    late: float,
    camera: Mapping[str, float],
    faint: float | None,
) -> dict[str, list]:
    """Errors of every picture of one motion."""
    made = experiment(seed, depth, camera, faint)
    truth = synthesize(made, folder, seed=seed)
    settings = Settings.load(folder / "params.yaml")
    motion = Motion()
    for command in read_recording(folder, settings).commands:
        motion.add(command)
    poses = dict(settings.cameras) or {"": settings.camera}
    later = shown_later(made, truth, "right", late, seed) if late else None
    observer = None
    result = {k: [] for k in ("across", "depth", "inside", "wrong", "silent", "wall", "cpu", "std")}
    u = np.linspace(0.0, settings.rod.length, 4001)
    index = {stamp: k for k, stamp in enumerate(truth.stamps)}
    for images in iterate_together(folder, list(poses), depth=depth):
        if observer is None:
            cameras = cameras_of({n: i.info for n, i in images.items()}, poses)
            observer = SpaceObserver(settings, cameras, motion)
            view = next(iter(cameras.values())).rotation[2]
        frames = {n: Frame(i.stamp, i.image, i.depth) for n, i in images.items()}
        if later is not None:
            picture = next(later, None)
            if picture is None:
                break
            frames["right"] = Frame(frames["right"].stamp + round(late * 1e9), picture)
        stamp = frames[next(iter(frames))].stamp
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            found = observer.observe(frames).observation.points
        except VisionError as err:
            result["silent"].append(str(err))
            continue
        result["wall"].append(time.perf_counter() - wall)
        result["cpu"].append(time.process_time() - cpu)
        curve = truth.centreline(index[stamp], u)
        distance, nearest = cKDTree(curve).query(found.positions)
        error = found.positions - curve[nearest]
        along = error @ view
        result["depth"].append(np.mean(along**2))
        result["across"].append(np.mean(np.sum((error - along[:, None] * view) ** 2, axis=1)))
        result["inside"].append(np.mean(distance < INSIDE * found.std))
        result["std"].append(np.median(found.std))
        result["wrong"].append(distance.max() > WRONG)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("motions", nargs="?", type=int, default=4)
    parser.add_argument("first", nargs="?", type=int, default=0)
    parser.add_argument("--depth", action="store_true")
    parser.add_argument("--late", type=float, default=0.0, metavar="MS")
    parser.add_argument("--blur", type=float, default=None, metavar="PX")
    parser.add_argument("--exposure", type=float, default=None, metavar="MS")
    parser.add_argument("--faint", type=float, default=None, metavar="LEVELS")
    arguments = parser.parse_args()
    camera = {} if arguments.blur is None else {"blur": arguments.blur}
    if arguments.exposure is not None:
        camera["exposure"] = 1e-3 * arguments.exposure
    total: dict[str, list] = {}
    for seed in range(arguments.first, arguments.first + arguments.motions):
        with tempfile.TemporaryDirectory() as folder:
            found = evaluate(
                seed, Path(folder) / "bag", depth=arguments.depth, late=1e-3 * arguments.late,
                camera=camera, faint=arguments.faint,
            )  # fmt: skip
        for key, values in found.items():
            total.setdefault(key, []).extend(values)
    count = len(total["wrong"]) + len(total["silent"])
    across, deep = (1e3 * np.sqrt(np.mean(total[key])) for key in ("across", "depth"))
    print(
        f"{count} instants: {len(total['silent'])} silent, {sum(total['wrong'])} wrong; RMS "
        f"{across:.3f} mm across the view, {deep:.3f} mm in depth, stated std "
        f"{1e3 * np.median(total['std']):.3f} mm, {100 * np.mean(total['inside']):.1f} % of the "
        f"points inside; {1e3 * np.median(total['cpu']):.1f} ms of processor, "
        f"{1e3 * np.median(total['wall']):.1f} ms of wall time (median)"
    )
    for reason in sorted(set(total["silent"])):
        print(f"  silent {total['silent'].count(reason)} times: {reason}")


if __name__ == "__main__":
    main()
