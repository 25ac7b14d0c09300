# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of other kinds than those of vision_stress.py: ropes, boards and things of every day.

`make_other` draws a picture with a rope, `make_absent` one without. Kind and all else follow from
the seed.
"""

import cv2
import numpy as np
from vision_scenes import LENGTH, Scene, curve_from_curvature, to_board
from vision_stress import crossings, random_shape

OTHER = ("stripe", "twist", "shine", "cast", "width", "wood", "mat", "print", "cables", "hairpin",
         "hand", "colour")  # fmt: skip
ABSENT = ("empty", "holes", "wood", "mat", "print", "hand", "tools", "cables", "cloth")


def colour(rng, low=0, high=255):
    return tuple(int(v) for v in rng.integers(low, high, 3))


def apart(rng, other, least):
    """A colour that differs from another one by at least some grey levels."""
    while True:
        c = colour(rng)
        if np.linalg.norm(np.subtract(c, other)) > least:
            return c


def wood(rng, size):
    w, h = size
    grain = cv2.GaussianBlur(rng.normal(0, 1, (h, w)), (0, 0), sigmaX=60, sigmaY=2.0)
    fine = cv2.GaussianBlur(rng.normal(0, 1, (h, w)), (0, 0), sigmaX=15, sigmaY=0.8)
    grain = rng.uniform(8, 22) * grain / grain.std() + rng.uniform(2, 6) * fine / fine.std()
    tone = np.array([120, 160, 190]) + rng.uniform(-40, 40)
    canvas = tone + grain[:, :, None] * [0.8, 1.0, 1.0]
    for _ in range(rng.integers(0, 4)):  # knots
        centre = (int(rng.integers(0, w)), int(rng.integers(0, h)))
        knot = np.zeros((h, w))
        cv2.ellipse(knot, centre, (int(rng.integers(10, 25)), 8), 0, 0, 360, 1.0, -1)
        canvas -= 60 * cv2.GaussianBlur(knot, (0, 0), 2)[:, :, None]
    return np.clip(canvas, 0, 255)


def mat(rng, size):
    """A cutting mat: a grid of thin lines, every fifth thicker."""
    w, h = size
    board = colour(rng, 30, 150)
    canvas = np.ones((h, w, 3)) * board
    step = int(rng.integers(18, 40))
    line = apart(rng, board, 40)
    for k, at in enumerate(range(int(rng.integers(0, step)), max(w, h), step)):
        thick = 2 if k % 5 == 0 else 1
        cv2.line(canvas, (at, 0), (at, h), line, thick)
        cv2.line(canvas, (0, at), (w, at), line, thick)
    return canvas


def printed(rng, size):
    """Paper with a coloured print: patches of every size."""
    w, h = size
    canvas = np.ones((h, w, 3)) * colour(rng)
    for _ in range(int(rng.integers(60, 160))):
        x, y = rng.integers(0, w), rng.integers(0, h)
        a, b = rng.integers(12, 120, 2)
        if rng.random() < 0.5:
            cv2.rectangle(canvas, (int(x), int(y)), (int(x + a), int(y + b)), colour(rng), -1)
        else:
            angle = float(rng.uniform(0, 180))
            cv2.ellipse(canvas, (int(x), int(y)), (int(a), int(b)), angle, 0, 360, colour(rng), -1)
    return canvas


def cloth(rng, size):
    w, h = size
    folds = cv2.GaussianBlur(rng.normal(0, 1, (h, w)), (0, 0), sigmaX=8, sigmaY=120)
    across = cv2.GaussianBlur(rng.normal(0, 1, (h, w)), (0, 0), sigmaX=100, sigmaY=6)
    light = 12 * folds / folds.std() + 8 * across / across.std()
    return np.clip(np.asarray(colour(rng, 60, 220))[None, None] + light[:, :, None], 0, 255)


def hand(rng, canvas, at, width):
    """Fingers and a palm over a picture; the fingers are two to three ropes wide."""
    skin = np.array([rng.uniform(90, 160), rng.uniform(120, 180), rng.uniform(170, 225)])
    layer = np.zeros(canvas.shape[:2])
    angle = rng.uniform(0, 2 * np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    side = np.array([-along[1], along[0]])
    palm = np.asarray(at) + 11 * width * along
    cv2.circle(layer, tuple(int(v) for v in palm), int(5.5 * width), 1.0, -1)
    for k in range(4):
        root = palm + (k - 1.5) * 2.6 * width * side
        tip = root - along * width * rng.uniform(7, 12)
        ends = [tuple(int(v) for v in p) for p in (root, tip)]
        cv2.line(layer, ends[0], ends[1], 1.0, int(2.2 * width))
    layer = cv2.GaussianBlur(layer, (0, 0), 1.0)[:, :, None]
    return canvas * (1 - layer) + layer * skin


def tools(rng, canvas, width):
    for _ in range(int(rng.integers(1, 5))):
        p = rng.uniform(0, 1, 2) * canvas.shape[1::-1]
        angle = rng.uniform(0, np.pi)
        q = p + rng.uniform(15, 40) * width * np.array([np.cos(angle), np.sin(angle)])
        thick = int(width * rng.uniform(0.7, 4.0))
        tone = colour(rng)
        ends = [tuple(int(v) for v in e) for e in (p, q)]
        cv2.line(canvas, ends[0], ends[1], tone, thick, cv2.LINE_AA)
        if rng.random() < 0.6:
            middle = tuple(int(v) for v in 0.5 * (p + q))
            cv2.line(canvas, middle, ends[1], colour(rng), int(1.8 * thick), cv2.LINE_AA)
    return canvas


def base(rng, seed, width=10.0):
    scene = Scene(
        width_px=width,
        diameter=0.0004 * width,
        seed=seed,
        board=colour(rng, 120, 230),
        noise=rng.uniform(1, 3),
        blur=rng.uniform(0.6, 1.1),
        jpeg=int(rng.choice([0, 75, 90])),
        texture=rng.uniform(0, 12),
        gradient=rng.uniform(0, 40),
        shade=rng.uniform(-20, 20),
        tilt=rng.uniform(-0.3, 0.3),
        distortion=(rng.uniform(-0.2, 0.1), 0.03, 0.0, 0.0, 0.0),
    )
    scene.rope = apart(rng, scene.board, 90)
    return scene


def shape(rng, hairpin=False, crossing=None, scale=1.0):
    crossing = rng.random() < 0.25 if crossing is None else crossing
    while True:
        if hairpin:
            # There and back around a bulb, the strands closer together than a rope is wide.
            pitch = rng.uniform(1.35, 2.0) * 0.004
            radius = rng.uniform(3.0, 5.0) * 0.004
            neck = float(np.arccos(0.5 * (1.0 + 0.5 * pitch / radius)))
            share = radius / LENGTH
            middle, wave = rng.uniform(0.45, 0.55), rng.normal(0, 1.5)
            bulb, foot = (np.pi / 2 + neck) * share, neck * share
            sign = rng.choice([-1, 1])
            curve = curve_from_curvature(
                lambda u, m=middle, r=radius, b=bulb, f=foot, k=wave, s=sign: np.where(
                    abs(u - m) < b,
                    s / r,
                    np.where(abs(u - m) < b + f, -s / r, k * np.sign(u - m)),
                ),
                angle=rng.uniform(0, 2 * np.pi),
            )
            curve -= 0.5 * (curve.max(axis=0) + curve.min(axis=0))
            if crossings(curve):
                continue
        else:
            curve = random_shape(rng, crossing)
        if np.all(np.ptp(curve, axis=0) < np.array([0.34, 0.19]) * scale):
            return curve


def other_cables(rng, scene, count, key="below"):
    for _ in range(count):
        bend = rng.normal(0, 5)
        curve = curve_from_curvature(
            lambda u, b=bend: b + 0 * u, angle=rng.uniform(0, 2 * np.pi), length=0.8
        )
        curve += rng.uniform(-0.12, 0.12, 2) - curve[len(curve) // 2]
        scene.extra.append((key, curve, colour(rng)))


def make_other(seed):
    """Kind, true curve and scene of a seed; the picture is `render(curve, scene)`."""
    rng = np.random.default_rng([7, seed])
    kind = OTHER[seed % len(OTHER)]
    width = float(rng.choice([6, 8, 14, 20, 30, 40])) if kind == "width" else 10.0
    scene = base(rng, seed, width)
    if kind == "width":
        wide = max(1.0, width / 14.0)
        scene.size = (int(960 * wide), int(540 * wide))
        if width < 10:
            scene.diameter = 0.0004 * width
    curve = shape(rng, kind == "hairpin", scale=1.0)
    if kind in ("stripe", "twist"):
        while scene.second is None or np.linalg.norm(np.subtract(scene.second, scene.rope)) < 60:
            scene.second = apart(rng, scene.board, 90)
        scene.pitch = rng.uniform(2.0, 8.0) if kind == "twist" else 0.0
    elif kind == "shine":
        scene.highlight = rng.uniform(60, 150)
    elif kind == "cast":
        scene.cast = rng.uniform(0.2, 0.6)
    elif kind in ("wood", "mat", "print"):
        scene.painted = {"wood": wood, "mat": mat, "print": printed}[kind](rng, scene.size)
        tones = scene.painted.reshape(-1, 3)[::997]
        scene.rope = max(
            (colour(rng) for _ in range(40)),
            key=lambda c: np.percentile(np.linalg.norm(tones - c, axis=1), 10),
        )
    elif kind == "cables":
        other_cables(rng, scene, int(rng.integers(1, 4)))
        if rng.random() < 0.5:
            other_cables(rng, scene, 1, "above")
    elif kind == "hand":
        scene.painted = None
        scene.extra.append(("hand", seed, float(rng.uniform(0.15, 0.85))))
    elif kind == "colour":
        # Of the board's brightness, so that only the colour tells.
        grey = np.array([0.114, 0.587, 0.299])
        while True:
            c = apart(rng, scene.board, 60)
            if abs(grey @ np.subtract(c, scene.board)) < 8:
                scene.rope = c
                break
    return kind, curve, scene


def make_absent(seed):
    """Kind, scene and the picture of a seed; no rope of the scene's width and length is in it."""
    rng = np.random.default_rng([11, seed])
    kind = ABSENT[seed % len(ABSENT)]
    scene = base(rng, seed)
    if kind == "holes":
        scene.holes = float(rng.choice([0.012, 0.02, 0.025]))
        scene.hole_tone = apart(rng, scene.board, 60)
    elif kind in ("wood", "mat", "print", "cloth"):
        scene.painted = {"wood": wood, "mat": mat, "print": printed, "cloth": cloth}[kind](
            rng, scene.size
        )
    elif kind in ("hand", "tools"):
        canvas = np.ones((scene.size[1], scene.size[0], 3)) * scene.board
        if kind == "hand":
            for _ in range(int(rng.integers(1, 3))):
                canvas = hand(rng, canvas, rng.uniform(0.2, 0.8, 2) * scene.size, 10)
        else:
            canvas = tools(rng, canvas, 10)
        scene.painted = canvas
    elif kind == "cables":
        # Of the rope's width, but they run out of the picture on both sides.
        other_cables(rng, scene, int(rng.integers(1, 4)))
    return kind, shape(rng), scene


def finish(image, scene, curve):
    """What lies above a rendered picture: hands."""
    for action in scene.extra:
        if action[0] == "hand":
            rng = np.random.default_rng([13, action[1]])
            at = scene.camera().project(to_board(curve))[int(action[2] * (len(curve) - 1))]
            image = np.uint8(np.clip(hand(rng, image.astype(float), at, scene.width_px), 0, 255))
    return image
