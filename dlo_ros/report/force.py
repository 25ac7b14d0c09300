# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of the missing force: maps over u and time, and arrows on the DLO."""

from __future__ import annotations

import numpy as np

from dlo_ros.report.elements import figure, number, paragraph
from dlo_ros.report.maps import field_maps
from dlo_ros.spline import FloatArray, SplineBasis

CLEAR_STDS = 2.0
"""Standard deviations from which a force is drawn as sure."""
STATIONS = 16
"""Along the DLO, at which arrows are drawn."""
LONGEST = 0.2
"""Length of the longest arrow, of the DLO's."""
HELD = (
    "A held end may be a little elsewhere, within the tolerances of a set-up, and do the same as a "
    "load beside it: there only a load that does more is sure."
)
FORCE_CAPTION = (
    " Arrows: the missing force, the load per length across the DLO that would bring the plain "
    f"model onto the measurement, where it is more than two standard deviations. {HELD}"
)
NOT_SURE = (
    "No missing force, a load that would bring the plain model onto the measurement, is sure here: "
    f"nowhere it is more than two standard deviations. {HELD}"
)


def across(
    observed: FloatArray, length: float, u: FloatArray, force: FloatArray, std: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The part of a force that stands across the DLO, with its standard deviation.

    A DLO hardly stretches, so that its shape says next to nothing of a force along it: what was
    computed there is as large as the stretching stiffness that was assumed.

    Args:
        observed: control points [m], shape (F, n, 3 or 4).
        length: L [m].
        u: [m], shape (U,).
        force, std: x, y, z [N/m], shape (F, U, 3).
    """
    basis = SplineBasis(observed.shape[1], length)
    tangents = basis.matrix(u, 1) @ observed[:, :, :3]
    tangents /= np.maximum(np.linalg.norm(tangents, axis=2, keepdims=True), 1e-300)
    parts = np.eye(3) - tangents[..., :, None] * tangents[..., None, :]  # (F, U, 3, 3)
    left = np.einsum("fuij,fuj->fui", parts, force)
    return left, np.sqrt(np.einsum("fuij,fuj->fui", parts**2, std**2))


def force_maps(
    times: FloatArray, u: FloatArray, force: FloatArray | None, std: FloatArray | None
) -> str:
    """Maps of the components, nothing where there is no force.

    Args:
        times: [s], shape (F,).
        u: [m], shape (U,).
        force, std: x, y, z [N/m], shape (F, U, 3).
    """
    if force is None or std is None:
        return ""
    shown = np.where(np.abs(force) > CLEAR_STDS * std, force, np.nan)
    axes = [k for k in range(3) if np.any(std[..., k] > 0.0)]
    if not axes:
        return ""
    if np.all(np.isnan(shown[..., axes])):
        return paragraph(NOT_SURE)
    titles = ["to the right", "away from the camera", "upwards"]
    inner = std[:, len(u) // 4 : -(len(u) // 4)][..., axes]
    return figure(
        field_maps(
            [titles[k] for k in axes], times, u, [shown[..., k] for k in axes],
            "missing force [N/m]",
        ),
        "The load per length across the DLO that would bring the plain model onto the measurement "
        "(a linear beam about the predicted shape). White where it is less than two standard "
        f"deviations, each {number(float(np.median(inner)), digits=2)} N/m in the DLO's middle. "
        f"{HELD}",
    )  # fmt: skip


def force_arrows(
    observed: FloatArray, length: float, u: FloatArray, force: FloatArray | None,
    std: FloatArray | None,
) -> tuple[list[FloatArray], str]:  # fmt: skip
    """The missing force along the observed shapes.

    Args:
        observed: control points [m], shape (F, n, 3 or 4).
        length: L [m].
        u, force, std: see `force_maps`.

    Returns:
        Begin and end of the arrows of each frame [m], shape (m, 2, 3), where the force is sure, and
            their legend; none where it is sure nowhere.
    """
    if force is None or std is None:
        return [], ""
    at = np.linspace(0, len(u) - 1, min(STATIONS, len(u))).round().astype(int)
    size = np.linalg.norm(force[:, at], axis=2)
    direction = force[:, at] / np.maximum(size, 1e-300)[..., None]
    # Of the component along the force itself.
    spread = np.sqrt(np.sum((direction * std[:, at]) ** 2, axis=2))
    sure = size > CLEAR_STDS * spread
    if not sure.any():
        return [], ""
    most = float(size[sure].max())
    scale = LONGEST * length / most
    points = SplineBasis(observed.shape[1], length).matrix(u[at]) @ observed[:, :, :3]
    ends = np.stack([points, points + scale * force[:, at]], axis=2)
    legend = f"missing force, the longest {number(most, 'N/m', digits=2)}"
    return [e[s] for e, s in zip(ends, sure, strict=True)], legend
