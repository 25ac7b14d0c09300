# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measured photographs, each DLO in them looked for with its clamps, length and width known.

    python test/support/vision_photographs.py FOLDER [--control-points N] \
        [--disturb SEED] [--overlays DIR]

FOLDER holds photographs with ground truth (the folder `images` of the measured data). Prints for
each DLO the share of its true centreline within 3 px of the observed one, the share of the observed
one that lies on no DLO, and the share on another DLO; or why nothing was found. With --disturb the
clamps, the length and the width are off by what they are in practice.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial import cKDTree
from vision_scenes import clamps

from dlo_ros.errors import VisionError
from dlo_ros.parameters import CameraPose, RodParameters, Settings
from dlo_ros.vision import Camera, Observer
from dlo_ros.vision.overlay import draw_overlay
from dlo_ros.vision.photograph import find_dlos
from dlo_ros.vision.segmentation.picture_strip import resample

PIXEL = 0.0005  # m
DISTANCE = 1.0  # m


@dataclass
class Case:
    """One DLO in one photograph: image, true centreline, those of the others, width [px]."""

    name: str
    image: np.ndarray
    truth: np.ndarray
    others: list
    width: float


def camera_of(image):
    height, width = image.shape[:2]
    focal = DISTANCE / PIXEL
    k = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    pose = CameraPose((0.0, 0.0, DISTANCE), (2**-0.5, 0.0, 0.0, 2**-0.5))
    return Camera(k, (), width, height, pose)


def through(clicks):
    """A smooth curve through clicks, about half a pixel dense."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(clicks, axis=0).T))])
    keep = np.concatenate([[True], np.diff(s) > 0])
    spline = make_interp_spline(s[keep], clicks[keep], k=min(3, keep.sum() - 1))
    return spline(np.linspace(0.0, s[-1], int(2 * s[-1])))


def width_along(image, curve, guess):
    from dlo_ros.vision.segmentation.edge_profile import locate

    return locate(image, resample(curve, 2.0), guess).width


def cases(folder):
    for path in sorted(folder.glob("ariadne*/*.jpg")):
        image = cv2.imread(str(path))
        curves = []
        for line in path.with_suffix(".txt").read_text().splitlines():
            numbers = np.array(line.split(), dtype=float)
            if len(numbers) > 6:
                curves.append(through(numbers[1:].reshape(-1, 2)))
        for k, curve in enumerate(curves):
            others = [c for j, c in enumerate(curves) if j != k]
            # One half of a cable of two tones looks like a thinner cable.
            usual = np.median([width_along(image, c, 8.0) for c in curves])
            width = max(width_along(image, curve, 8.0), 0.95 * usual)
            yield Case(f"{path.stem} {k}", image, curve, others, width)
    for path in sorted(folder.glob("mbest*/*.jpg")):
        image = cv2.imread(str(path))
        labels = cv2.imread(str(path.with_name(f"{path.stem}_labels.png")), -1)
        found = find_dlos(image)
        for k, dlo in enumerate(found):
            # Checked against the labels, so that it may stand for the truth.
            x, y = np.rint(dlo.pixels.T).astype(int)
            on = labels[y.clip(0, labels.shape[0] - 1), x.clip(0, labels.shape[1] - 1)]
            if np.mean(on == np.bincount(on[on > 0]).argmax()) < 0.93:
                print(f"{path.stem}: no truth for DLO {k}")
                continue
            others = [d.pixels for j, d in enumerate(found) if j != k]
            yield Case(f"{path.stem} {k}", image, dlo.pixels, others, dlo.width)
    for name, ending, width in (("black0", "centreline", 20.0), ("white0", "clicked", 20.0)):
        path = next(iter(folder.glob(f"hanging*/{name}.jpg")))
        truth = np.loadtxt(path.with_name(f"{name}_{ending}_px.csv"), delimiter=",")
        yield Case(name, cv2.imread(str(path)), truth, [], width)


def judge(case, control_points, seed, overlays):
    camera = camera_of(case.image)
    truth = resample(case.truth, 1.0)
    xz = camera.to_board(truth)[:, [0, 2]]
    length = float(np.sum(np.hypot(*np.diff(xz, axis=0).T)))
    rng = np.random.default_rng(seed)
    off = 0.0 if seed is None else 1.0
    diameter = case.width * PIXEL * (1 + off * rng.uniform(-0.15, 0.15))
    rod = RodParameters(
        length * (1 + off * rng.normal(0, 0.01)), diameter, 1e6, 1e3, control_points=control_points
    )
    held = xz.copy()
    span = max(2, round(2 * case.width))
    held[0] += off * rng.normal(0, 0.3, 2) * diameter
    held[-1] += off * rng.normal(0, 0.3, 2) * diameter
    held[1] = held[0] + (xz[span] - xz[0])
    held[-2] = held[-1] - (xz[-1] - xz[-1 - span])
    settings = Settings(rod, camera=camera.pose)
    observer = Observer(settings, camera, clamps(held, control_points))
    result, problem = None, ""
    try:
        result = observer.observe(0, case.image)
    except VisionError as err:
        problem = str(err)
    if overlays:
        picture = draw_overlay(case.image, camera, rod.length, result, message=problem)
        if result is not None:
            cv2.polylines(
                picture, [np.int32(np.rint(result.pixels * 8))], False, (255, 255, 255), 1, 16, 3
            )
        cv2.imwrite(str(overlays / f"{case.name.replace(' ', '_')}.png"), picture)
    if result is None:
        return None, problem
    curve = resample(result.pixels, 0.5)
    distance, _ = cKDTree(curve).query(truth)
    limit = max(3.0, 0.5 * case.width)
    own, _ = cKDTree(truth).query(result.pixels)
    other = np.full(len(result.pixels), np.inf)
    if case.others:
        other, _ = cKDTree(np.vstack(case.others)).query(result.pixels)
    off_own = own > limit
    return (
        float(np.mean(distance < 3.0)),
        float(np.mean(off_own & (other > limit))),
        float(np.mean(off_own & (other <= limit))),
        float(np.mean(distance)),
    ), ""


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--control-points", type=int, default=20)
    parser.add_argument("--disturb", type=int, default=None, metavar="SEED")
    parser.add_argument("--overlays", type=Path)
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    if options.overlays:
        options.overlays.mkdir(parents=True, exist_ok=True)
    for case in cases(options.folder):
        if options.only not in case.name:
            continue
        marks, problem = judge(case, options.control_points, options.disturb, options.overlays)
        if marks is None:
            print(f"{case.name:14} {case.width:5.1f} px  silent: {problem}")
        else:
            seen, false, other, mean = marks
            print(
                f"{case.name:14} {case.width:5.1f} px  within 3 px {100 * seen:5.1f} %  "
                f"nowhere {100 * false:4.1f} %  on another {100 * other:4.1f} %  mean {mean:.2f} px"
            )


if __name__ == "__main__":
    main()
