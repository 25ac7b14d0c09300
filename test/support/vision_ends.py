# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How right u is along a rope with a free end: rendered pictures whose start alone is held.

    python test/support/vision_ends.py [COUNT [FIRST_SEED]] [--kinds KIND ...] [--wrong FOLDER]

prints for each kind of surroundings of the free end how many pictures were found, the error of u
along the rope (largest of a picture), and how often it lies within two stated std. Each picture is
a first detection.
"""

import argparse
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
from vision_scenes import LENGTH, Scene, clamps, render, settings
from vision_stress import crossings, random_shape

from dlo_ros.errors import VisionError
from dlo_ros.vision import Observer
from dlo_ros.vision.overlay import draw_overlay

KINDS = ("plain", "holes", "shadow", "dark", "hidden", "blur", "long")
PLACES = [(a, b) for a in (-1.0, -0.2, 0.6, 1.3, 2.2) for b in (-1.4, -0.5, 0.4, 1.2)]
CONTROL_POINTS = 20
RIGHT = 0.003  # of L: largest error of u


def make(kind, seed):
    """True curve, its length over rod.length, and scene of a seed."""
    rng = np.random.default_rng([23, KINDS.index(kind), seed])
    scene = Scene(
        seed=seed,
        jpeg=int(rng.choice([0, 80, 90])),
        texture=rng.uniform(0, 15),
        gradient=rng.uniform(0, 40),
        shade=rng.uniform(-20, 20),
        noise=rng.uniform(1, 3),
    )
    while True:
        curve = random_shape(rng, crossing=False)
        if np.all(np.ptp(curve, axis=0) < [0.32, 0.17]) and not crossings(curve):
            break
    tip, tangent = curve[-1], curve[-1] - curve[-20]
    tangent = tangent / np.hypot(*tangent)
    normal = np.array([-tangent[1], tangent[0]])
    width = scene.diameter
    if kind == "holes":
        ahead, beside = PLACES[seed % len(PLACES)]
        scene.holes = rng.choice([0.02, 0.025])
        scene.hole_radius = rng.uniform(0.4, 0.9)
        scene.hole_at = tuple(tip + width * (ahead * tangent + beside * normal))
        if rng.random() < 0.3:
            scene.hole_tone = scene.rope
        else:
            scene.hole_tone = tuple(int(v) for v in rng.integers(40, 150, 3))
    elif kind == "shadow":
        at = scene.camera().project(np.array([[tip[0], 0.0, tip[1]]]))[0, 0]
        scene.extra.append(("shadow", int(at + 10 * rng.uniform(-3, 3)), rng.uniform(0.35, 0.8)))
    elif kind in ("dark", "hidden"):
        centre = tip - width * rng.uniform(-3.0, 4.0) * tangent if kind == "dark" else tip
        size = rng.uniform(2.0, 5.0, 2) * scene.width_px
        x, y = scene.camera().project(np.array([[centre[0], 0.0, centre[1]]]))[0]
        box = (int(x - size[0]), int(y - size[1]), int(x + size[0]), int(y + size[1]))
        box = tuple(max(v, 0) for v in box)
        if kind == "dark":
            tone = tuple(
                int(v + d) for v, d in zip(scene.rope, rng.integers(-15, 25, 3), strict=True)
            )
            scene.extra.append(("patch", *box, tone))
        else:
            scene.extra.append(("box", *box, tuple(int(v) for v in rng.integers(0, 255, 3))))
    elif kind == "blur":
        scene.blur = rng.uniform(1.5, 3.0)
    longer = 1.0 + rng.normal(0.0, 0.005) if kind == "long" else 1.0
    return curve, longer, scene


def judge(kind, seed, wrong=None):
    """Largest error of u over L, largest across [px], share within two std; or the reason."""
    curve, longer, scene = make(kind, seed)
    picture = render(curve, scene)
    known = settings(scene, CONTROL_POINTS, LENGTH * longer)
    motion = clamps(curve, CONTROL_POINTS, ("start",))
    try:
        result = Observer(known, scene.camera(), motion).observe(0, picture)
    except VisionError as err:
        return str(err)
    points = result.observation.points
    error, across = errors(points, curve, longer)
    std = points.std_along
    inside = float(np.mean(np.abs(error) < 2.0 * std))
    found = (
        float(np.abs(error).max() / LENGTH),
        float(np.abs(across).max() / scene.diameter * scene.width_px),
        inside,
        float(np.abs(error[-1]) / LENGTH),
        float(std[-1] / LENGTH),
    )
    if wrong is not None and found[0] > RIGHT:
        drawn = draw_overlay(picture, scene.camera(), known.rod.length, result)
        line = np.int32(np.rint(result.pixels * 8))
        cv2.polylines(drawn, [line], False, (255, 0, 255), 1, cv2.LINE_AA, 3)
        cv2.imwrite(str(wrong / f"{kind}_{seed}.png"), drawn)
    return found


def errors(points, curve, longer=1.0):
    """Errors of measured points along the rope (u) and across it [m], shapes (m,).

    A point's place is its share of the whole rope, whatever length is told.
    """
    xz = points.positions[:, [0, 2]]
    at = np.linspace(0.0, LENGTH, len(curve))
    tangent = np.gradient(curve, axis=0)
    tangent /= np.hypot(*tangent.T)[:, None]
    along, across = np.empty(len(xz)), np.empty(len(xz))
    for k, (p, u) in enumerate(zip(xz, points.u / longer, strict=True)):
        # The rope may come near itself: only the part near the stated u counts.
        near = np.flatnonzero(np.abs(at - u) < 0.1 * LENGTH)
        offset = p - curve[near]
        nearest = int(np.argmin(np.hypot(*offset.T)))
        t = tangent[near[nearest]]
        d = offset[nearest]
        along[k] = u - at[near[nearest]] - d @ t
        across[k] = t[0] * d[1] - t[1] * d[0]
    return along, across


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("count", type=int, nargs="?", default=40)
    parser.add_argument("first", type=int, nargs="?", default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--wrong", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    if options.wrong:
        options.wrong.mkdir(parents=True, exist_ok=True)
    print("         found    u within  largest error of u [% of L]   within  across")
    print("                  0.3 % of L  median   95 %    most       2 std   most [px]")
    for kind in options.kinds:
        found, silent = [], defaultdict(int)
        for seed in range(options.first, options.first + options.count):
            result = judge(kind, seed, options.wrong)
            if isinstance(result, str):
                silent[result.split("(")[0]] += 1
            else:
                found.append(result)
        if found:
            error, across, inside, *_ = np.array(found).T
            print(
                f"{kind:8} {len(found):4}/{options.count:<4} {np.mean(error < RIGHT):8.1%}"
                f"    {100 * np.median(error):6.2f} {100 * np.quantile(error, 0.95):6.2f}"
                f"  {100 * error.max():6.2f}    {np.mean(inside):7.1%} {across.max():8.2f}"
            )
        for reason, number in silent.items():
            print(f"  {number} {reason}")


if __name__ == "__main__":
    main()
