# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rendered pictures that are hard on purpose: occlusion, faint ropes, shadows, blur, clutter.

    python test/support/vision_stress.py [COUNT [FIRST_SEED]] [--set issue|other|dark|cell|absent]
                                 [--ends both|start|none] [--disturb] [--wrong FOLDER]

prints how many were found rightly, wrongly, or not at all with the reason. Every picture is a first
detection: nothing is known of the frame before. The set `issue` is the one of this file, `other`
and `absent` (no rope at all) are those of vision_kinds.py, `dark` and `cell` those of
vision_cells.py. With --disturb the clamps, the length
and the diameter are off by what they are in practice; --wrong keeps pictures of what was found
wrongly.
"""

import argparse
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from vision_scenes import (
    Scene,
    across_errors,
    clamps,
    curve_from_curvature,
    render,
    settings,
    to_board,
)

from dlo_ros.errors import VisionError
from dlo_ros.vision import Observer
from dlo_ros.vision.overlay import draw_overlay

KINDS = ("occlusion", "contrast", "shadow", "blur", "crossing", "clutter", "plain", "mix")
RIGHT_PX = 2.0  # across the rope; along it only u is concerned
RIGHT_ALONG_PX = 15.0
CONTROL_POINTS = 20


def random_shape(rng, crossing):
    if crossing:
        strength, middle = rng.uniform(5.5, 9.0) * rng.choice([-1, 1]), rng.uniform(0.4, 0.6)
        extent = rng.uniform(0.16, 0.26)
        curve = curve_from_curvature(
            lambda u: 4.4 * strength * np.exp(-(((u - middle) / extent) ** 2)),
            angle=rng.uniform(0, 2 * np.pi),
        )
    else:
        k = rng.normal(0, 1, 5) * [8, 10, 9, 6, 4]
        curve = curve_from_curvature(
            lambda u: sum(k[i] * np.cos(np.pi * i * u) for i in range(5)),
            angle=rng.uniform(0, 2 * np.pi),
        )
    return curve - 0.5 * (curve.max(axis=0) + curve.min(axis=0))


def crossings(curve):
    p = curve[::10]
    a, b = p[:-1, None], p[1:, None]
    c, d = p[None, :-1], p[None, 1:]

    def side(p, q, r):
        u, v = q - p, r - p
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    cross = (side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)
    return int(cross[np.triu_indices(len(p) - 1, 2)].sum())


def make(seed):
    """Kind, true curve and scene of a seed."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    mixed = kind == "mix"
    scene = Scene(
        width_px=10,
        seed=seed,
        holes=rng.choice([0, 0.02, 0.025]),
        jpeg=int(rng.choice([0, 80, 90])),
        texture=rng.uniform(0, 15),
        gradient=rng.uniform(0, 40),
        shade=rng.uniform(-20, 20),
        noise=rng.uniform(1, 3),
    )
    own = rng.random() < 0.3
    scene.hole_tone = scene.rope if own else tuple(int(v) for v in rng.integers(40, 150, 3))
    while True:
        curve = random_shape(rng, kind == "crossing" or (mixed and rng.random() < 0.4))
        if np.any(np.ptp(curve, axis=0) > [0.34, 0.19]):
            continue
        count = crossings(curve)
        if mixed or (count > 0) == (kind == "crossing"):
            break
    if kind == "occlusion" or (mixed and rng.random() < 0.5):
        share = rng.uniform(0.05, 0.3)
        first = int(rng.uniform(0.1, 0.9 - share) * len(curve))
        hidden = curve[first : first + int(share * len(curve))]
        pixels = scene.camera().project(to_board(hidden))
        low = np.maximum(pixels.min(axis=0) - 6, 0).astype(int)
        high = (pixels.max(axis=0) + 6).astype(int)
        colour = tuple(int(v) for v in rng.integers(0, 255, 3))
        scene.extra.append(("box", low[0], low[1], high[0], high[1], colour))
    if kind == "contrast" or (mixed and rng.random() < 0.3):
        difference = 40 if mixed else rng.uniform(10, 30)
        scene.rope = tuple(int(v - difference) for v in scene.board)
        scene.texture *= 0.2
        scene.shade *= 0.1
        scene.holes = 0 if rng.random() < 0.7 else scene.holes
    if kind == "shadow" or (mixed and rng.random() < 0.4):
        scene.extra.append(("shadow", int(rng.uniform(250, 700)), rng.uniform(0.5, 0.8)))
    if kind == "blur":
        scene.blur = rng.uniform(1.5, 3.0)
    if kind == "clutter" or (mixed and rng.random() < 0.3):
        for _ in range(rng.integers(1, 4)):
            other = random_shape(rng, False) * 0.5 + rng.uniform(-0.08, 0.08, 2)
            scene.extra.append(("below", other, scene.rope))
    return kind, curve, scene


def disturbed(rng, curve, known, diameter):
    """Clamped curve and settings as somebody measured them who is no machine."""
    off = rng.normal(0, 0.3, (2, 2)) * diameter
    turn = rng.normal(0, 0.08, 2)
    held = curve.copy()
    for at, beside, k in ((0, 1, 0), (-1, -2, 1)):
        c, s = np.cos(turn[k]), np.sin(turn[k])
        held[beside] = held[at] + np.array([[c, -s], [s, c]]) @ (curve[beside] - curve[at]) + off[k]
        held[at] += off[k]
    rod = known.rod
    rod = replace(
        rod,
        length=rod.length * (1 + rng.normal(0, 0.007)),
        diameter=rod.diameter * rng.uniform(0.88, 1.12),
    )
    return held, replace(known, rod=rod)


def picture_of(which, seed):
    """Kind, true curve, scene and picture of a seed."""
    if which == "issue":
        kind, curve, scene = make(seed)
        return kind, curve, scene, render(curve, scene)
    import vision_kinds

    if which == "other":
        kind, curve, scene = vision_kinds.make_other(seed)
        return kind, curve, scene, vision_kinds.finish(render(curve, scene), scene, curve)
    if which in ("dark", "cell"):
        import vision_cells

        make_one = vision_cells.make_dark if which == "dark" else vision_cells.make_cell
        kind, curve, scene = make_one(seed)
        return kind, curve, scene, render(curve, scene)
    kind, curve, scene = vision_kinds.make_absent(seed)
    return kind, curve, scene, render(None, scene)


def judge(seed, which="issue", ends="both", disturb=False, wrong=None):
    """Kind, 'right', 'wrong' or 'silent', and the reason of silence."""
    kind, curve, scene, picture = picture_of(which, seed)
    known, held = settings(scene, CONTROL_POINTS), curve
    if disturb:
        rng = np.random.default_rng([17, seed])
        held, known = disturbed(rng, curve, known, scene.diameter)
    names = {"both": ("start", "end"), "start": ("start",), "none": ()}[ends]
    motion = clamps(held, CONTROL_POINTS, names) if names else None
    try:
        result = Observer(known, scene.camera(), motion).observe(0, picture)
    except VisionError as err:
        return kind, "silent", str(err)
    first, last = result.observation.control_points[[0, -1], 0]
    if not names and (first < last or abs(first - last) < 1.5 * scene.diameter):
        # The start is the end further left, and either one where they lie above one another.
        ends_at = result.observation.control_points[[0, -1]][:, [0, 2]]
        if np.hypot(*(ends_at[0] - curve[-1])) < np.hypot(*(ends_at[0] - curve[0])):
            curve = curve[::-1]
    points = result.observation.points
    pixel = scene.diameter / scene.width_px
    across, _ = across_errors(points.positions[:, [0, 2]], curve)
    # At a crossing the nearest point of the curve may lie on the other strand, so compare at u.
    at = np.linspace(0.0, known.rod.length, len(curve))
    same = np.column_stack([np.interp(points.u, at, column) for column in curve.T])
    apart = np.hypot(*(points.positions[:, [0, 2]] - same).T)
    along = RIGHT_ALONG_PX * max(1.0, scene.width_px / 10.0)
    right = np.max(np.abs(across)) < RIGHT_PX * pixel and np.max(apart) < along * pixel
    right = bool(right) and which != "absent"
    if wrong is not None and not right:
        drawn = draw_overlay(picture, scene.camera(), known.rod.length, result)
        line = np.int32(np.rint(result.pixels * 8))
        cv2.polylines(drawn, [line], False, (255, 0, 255), 1, cv2.LINE_AA, 3)
        cv2.imwrite(str(wrong / f"{which}_{ends}_{seed}_{kind}.png"), drawn)
    return kind, "right" if right else "wrong", ""


def tally(seeds, which="issue", ends="both", disturb=False, wrong=None):
    """Verdicts by kind, and reasons of silence."""
    verdicts, reasons = defaultdict(Counter), Counter()
    for seed in seeds:
        kind, verdict, reason = judge(seed, which, ends, disturb, wrong)
        verdicts[kind][verdict] += 1
        if reason:
            reasons[f"{kind}: {reason}"] += 1
    return verdicts, reasons


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("count", type=int, nargs="?", default=80)
    parser.add_argument("first", type=int, nargs="?", default=0)
    parser.add_argument(
        "--set", choices=("issue", "other", "dark", "cell", "absent"), default="issue"
    )
    parser.add_argument("--ends", choices=("both", "start", "none"), default="both")
    parser.add_argument("--disturb", action="store_true")
    parser.add_argument("--wrong", type=Path, metavar="FOLDER")
    parser.add_argument("--reasons", type=int, default=10)
    options = parser.parse_args()
    if options.wrong:
        options.wrong.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first, options.first + options.count)
    by_kind, silence = tally(seeds, options.set, options.ends, options.disturb, options.wrong)
    print(f"{'':10} {'right':>6} {'silent':>6} {'wrong':>6}")
    total = Counter()
    for name, found in by_kind.items():
        total += found
        print(f"{name:10} {found['right']:6} {found['silent']:6} {found['wrong']:6}")
    print(f"{'all':10} {total['right']:6} {total['silent']:6} {total['wrong']:6}")
    for reason, number in silence.most_common(options.reasons):
        print(f"  {number} {reason}")


if __name__ == "__main__":
    main()
