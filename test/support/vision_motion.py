# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of a rope that moves while they are taken: blur by 0 to 12 px along the exposure's path.

The stamp is the middle of the exposure, and the truth is the rope's shape then. The rope swings
between two held ends, so its speed changes during the exposure as it does in a swing: a picture's
mean over the exposure is not quite the shape at its middle.
"""

import cv2
import numpy as np
from vision_scenes import Scene, ground, paint_rope
from vision_stress import crossings, random_shape

LONGEST = 12.0  # [px] path of the point that moves most
STEP = 1.0  # [px] between the instants of which a picture is the mean
MOST_TURNED = (0.05, 0.4)  # [rad] by which the swing's phase goes on during an exposure
PHASE = 1.2  # [rad] from the swing's middle, where a picture is taken


def moving_picture(seed):
    """Kind, true curve at mid-exposure, scene and picture of a seed."""
    rng = np.random.default_rng([4242, seed])
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
    scene.hole_tone = tuple(int(v) for v in rng.integers(40, 150, 3))
    while True:
        curve = random_shape(rng, False)
        if np.all(np.ptp(curve, axis=0) < [0.34, 0.18]) and not crossings(curve):
            break
    blur = rng.uniform(0.0, LONGEST)
    u = np.linspace(0.0, 1.0, len(curve))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    shape = np.sin(np.pi * u) + rng.uniform(-0.7, 0.7) * np.sin(2.0 * np.pi * u)
    shape /= np.abs(shape).max()
    turned, phase = rng.uniform(*MOST_TURNED), rng.uniform(-PHASE, PHASE)
    count = max(1, int(np.ceil(blur / STEP)))
    within = ((np.arange(count) + 0.5) / count - 0.5) * turned
    swing = np.sin(phase + within) - np.sin(phase)
    whole = np.sin(phase + 0.5 * turned) - np.sin(phase - 0.5 * turned)
    moved = blur * scene.diameter / scene.width_px * swing / whole
    camera = scene.camera()
    empty = ground(scene, camera)
    total = np.zeros_like(empty)
    for distance in moved:
        canvas = empty.copy()
        away = distance * shape[:, None] * [np.cos(angle), np.sin(angle)]
        paint_rope(canvas, camera, curve + away, scene, scene.rope)
        total += canvas
    picture = cv2.GaussianBlur(total / count, (0, 0), scene.blur)
    picture += rng.normal(0.0, scene.noise, picture.shape)
    image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    if scene.jpeg:
        image = cv2.imdecode(cv2.imencode(".jpg", image, [1, scene.jpeg])[1], cv2.IMREAD_COLOR)
    low = 3 * int(blur / 3.0)
    return f"{low}-{low + 3} px", curve, scene, image
