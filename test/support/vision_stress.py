# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Rendered pictures that are hard on purpose: occlusion, faint ropes, shadows, blur, clutter.

    python test/support/vision_stress.py [COUNT [FIRST_SEED]]
                                 [--set issue|motion|other|dark|cell|absent] [--kind KIND]
                                 [--ends both|start|none] [--hint right|wrong]
                                 [--disturb] [--wrong FOLDER]

prints how many were found rightly, wrongly, or not at all with the reason. Every picture is a first
detection: nothing is known of the frame before. The set `issue` is the one of this file, `motion`
that of vision_motion.py (a rope that moves by 0 to 12 px while the picture is taken), `other` and
`absent` (no rope at all) are those of vision_kinds.py, `dark` and `cell` those of vision_cells.py.
--kind takes but the pictures of one kind of the set `issue`. With --disturb the clamps, the length
and the diameter are off by what they are in practice. With --hint the observer is told a predicted
shape: the true one, off by up to 5 mm, or that of another seed. --wrong keeps pictures of what was
found wrongly, or beyond three stated standard deviations.

The column `> 3 std` counts the published pictures, right or not, whose error exceeds three stated
standard deviations: the root mean square over the points of error over std is larger than 3, across
the rope (`std`) or along it (`std_along`, which pictures with a free end have). So neither an error
that all points share nor a short stretch on something else is averaged away. `points` is the share
of the published points beyond three std, across or along.
"""

import argparse
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
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
from dlo_ros.spline import SplineBasis
from dlo_ros.vision import Observer
from dlo_ros.vision.overlay import draw_overlay

KINDS = ("occlusion", "contrast", "shadow", "blur", "crossing", "clutter", "plain", "mix")
RIGHT_PX = 2.0  # across the rope; along it only u is concerned
RIGHT_ALONG_PX = 15.0
CONTROL_POINTS = 20
BEYOND = 3.0  # stated standard deviations
HINT_ERROR = 0.005  # [m]
NEARBY = 0.05  # of L: how far along the true curve a point's nearest place is looked for


@dataclass(frozen=True)
class Verdict:
    """What became of one picture.

    Args:
        kind: kind of the picture.
        found: 'right', 'wrong' or 'silent'.
        reason: reason for which no spline was published.
        across, along: root mean square of error over stated std, over the published points; NaN
            where nothing was published.
        points: share of the published points beyond three std, likewise.
    """

    kind: str
    found: str
    reason: str = ""
    across: float = np.nan
    along: float = np.nan
    points: float = np.nan

    @property
    def beyond(self):
        """Whether the picture is wrong by more than three stated standard deviations."""
        return max(self.across, self.along) > BEYOND


def errors_over_std(points, curve, length):
    """Errors of published points over their std, across and along, shapes (m,); 0 without a std.

    A point's error across is its distance from the true curve near its u (at a crossing the nearest
    point of all may lie on the other strand), that along the difference of material coordinates.
    """
    xz = points.positions[:, [0, 2]]
    step = length / (len(curve) - 1)
    reach = round(NEARBY * (len(curve) - 1))
    around = np.rint(points.u / step).astype(int)[:, None] + np.arange(-reach, reach + 1)
    around = np.clip(around, 0, len(curve) - 1)
    nearest = np.argmin(np.hypot(*(xz[:, None] - curve[around]).transpose(2, 0, 1)), axis=1)
    at = around[np.arange(len(xz)), nearest]
    tangent = np.gradient(curve, axis=0)[at]
    tangent /= np.hypot(*tangent.T)[:, None]
    offset = xz - curve[at]
    across = tangent[:, 0] * offset[:, 1] - tangent[:, 1] * offset[:, 0]
    along = points.u - at * step - np.sum(tangent * offset, axis=1)
    return across / points.std, 0.0 if points.std_along is None else along / points.std_along


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


def predicted(rng, curve, control_points, length):
    """Control points (n, 4) of a curve as a simulator with somewhat wrong parameters tells them."""
    u = np.linspace(0.0, length, len(curve))
    x = u / length
    off = HINT_ERROR * np.sin(np.pi * x)[:, None] * rng.uniform(-1.0, 1.0, 2) / np.sqrt(2.0)
    flat = SplineBasis(control_points, length).fit(u, curve + off)
    result = np.zeros((control_points, 4))
    result[:, [0, 2]] = flat
    return result


def picture_of(which, seed):
    """Kind, true curve, scene and picture of a seed."""
    if which == "issue":
        kind, curve, scene = make(seed)
        return kind, curve, scene, render(curve, scene)
    if which == "motion":
        import vision_motion

        return vision_motion.moving_picture(seed)
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


def judge(seed, which="issue", ends="both", disturb=False, wrong=None, hint=None):
    """What the observer makes of the picture of a seed, a `Verdict`."""
    kind, curve, scene, picture = picture_of(which, seed)
    known, held = settings(scene, CONTROL_POINTS), curve
    if disturb:
        rng = np.random.default_rng([17, seed])
        held, known = disturbed(rng, curve, known, scene.diameter)
    names = {"both": ("start", "end"), "start": ("start",), "none": ()}[ends]
    motion = clamps(held, CONTROL_POINTS, names) if names else None
    shape = None
    if hint is not None:
        rng = np.random.default_rng([18, seed])
        about = curve if hint == "right" else random_shape(rng, bool(rng.integers(2)))
        shape = predicted(rng, about, CONTROL_POINTS, known.rod.length)
    try:
        result = Observer(known, scene.camera(), motion).observe(0, picture, shape)
    except VisionError as err:
        return Verdict(kind, "silent", str(err))
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
    off, along_off = errors_over_std(points, curve, known.rod.length)
    far = np.maximum(np.abs(off), np.abs(along_off)) > BEYOND
    verdict = Verdict(
        kind,
        "right" if right else "wrong",
        across=float(np.sqrt(np.mean(off**2))),
        along=float(np.sqrt(np.mean(along_off**2))),
        points=float(np.mean(far)),
    )
    if wrong is not None and (not right or verdict.beyond):
        drawn = draw_overlay(picture, scene.camera(), known.rod.length, result)
        line = np.int32(np.rint(result.pixels * 8))
        cv2.polylines(drawn, [line], False, (255, 0, 255), 1, cv2.LINE_AA, 3)
        cv2.imwrite(str(wrong / f"{which}_{ends}_{seed}_{kind}.png"), drawn)
    return verdict


def verdicts_of(seeds, which="issue", ends="both", disturb=False, wrong=None, hint=None):
    """The verdict of each seed's picture."""
    return [judge(seed, which, ends, disturb, wrong, hint) for seed in seeds]


def tally(seeds, which="issue", ends="both", disturb=False, wrong=None):
    """Verdicts by kind, and reasons of silence."""
    found, reasons = defaultdict(Counter), Counter()
    for verdict in verdicts_of(seeds, which, ends, disturb, wrong):
        found[verdict.kind][verdict.found] += 1
        if verdict.reason:
            reasons[f"{verdict.kind}: {verdict.reason}"] += 1
    return found, reasons


def seeds_of(first, count, which="issue", kind=None):
    """The seeds of a number of pictures, all of one kind of the set `issue` where one is given."""
    if kind is None:
        return list(range(first, first + count))
    if which != "issue":
        raise SystemExit("--kind takes the kinds of the set issue")
    offset = (KINDS.index(kind) - first) % len(KINDS)
    return [first + offset + len(KINDS) * k for k in range(count)]


def show(verdicts, most_reasons):
    """Print the table of some verdicts and the reasons of silence."""
    by_kind = defaultdict(list)
    for verdict in verdicts:
        by_kind[verdict.kind].append(verdict)
    print(f"{'':10} {'right':>6} {'silent':>6} {'wrong':>6} {'> 3 std':>8} {'across':>7} "
          f"{'along':>6} {'points':>7}")  # fmt: skip
    for name, some in [*by_kind.items(), ("all", verdicts)]:
        found = Counter(v.found for v in some)
        published = [v for v in some if v.found != "silent"]
        beyond = sum(v.beyond for v in published)
        across = sum(v.across > BEYOND for v in published)
        along = sum(v.along > BEYOND for v in published)
        points = 100.0 * np.mean([v.points for v in published]) if published else np.nan
        print(f"{name:10} {found['right']:6} {found['silent']:6} {found['wrong']:6} {beyond:8} "
              f"{across:7} {along:6} {points:5.1f} %")  # fmt: skip
    published = [v for v in verdicts if v.found != "silent"]
    if published:
        share = 100.0 * np.mean([v.beyond for v in published])
        across, along = (np.median([getattr(v, d) for v in published]) for d in ("across", "along"))
        print(f"{share:.1f} % of {len(published)} published pictures beyond three stated std")
        print(f"error over std, median picture: across {across:.2f}, along {along:.2f}")
    reasons = Counter(f"{v.kind}: {v.reason}" for v in verdicts if v.reason)
    for reason, number in reasons.most_common(most_reasons):
        print(f"  {number} {reason}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("count", type=int, nargs="?", default=80)
    parser.add_argument("first", type=int, nargs="?", default=0)
    parser.add_argument(
        "--set", choices=("issue", "motion", "other", "dark", "cell", "absent"), default="issue"
    )
    parser.add_argument("--kind", choices=KINDS, help="of the set issue")
    parser.add_argument("--ends", choices=("both", "start", "none"), default="both")
    parser.add_argument("--hint", choices=("right", "wrong"), help="a predicted shape is told")
    parser.add_argument("--disturb", action="store_true")
    parser.add_argument("--wrong", type=Path, metavar="FOLDER")
    parser.add_argument("--reasons", type=int, default=10)
    parser.add_argument("--each", action="store_true", help="a line for each published picture")
    options = parser.parse_args()
    if options.wrong:
        options.wrong.mkdir(parents=True, exist_ok=True)
    seeds = seeds_of(options.first, options.count, options.set, options.kind)
    verdicts = verdicts_of(
        seeds, options.set, options.ends, options.disturb, options.wrong, options.hint
    )
    if options.each:
        for seed, verdict in zip(seeds, verdicts, strict=True):
            print(f"{seed} {verdict.kind} {verdict.found} across {verdict.across:.2f} along "
                  f"{verdict.along:.2f} points {verdict.points:.3f} {verdict.reason}")  # fmt: skip
    show(verdicts, options.reasons)


if __name__ == "__main__":
    main()
