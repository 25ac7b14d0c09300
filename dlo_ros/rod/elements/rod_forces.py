# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled forces of a configuration, for the rod in space and in the plane alike.

Configurations are q of shape (n, 4) in space and (n, 2) in the plane: the number of columns says
which. Basis matrices (mass, drag) are lower bands of shape (n, 4), one for positions and one for
theta.
"""

from __future__ import annotations

import numpy as np

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.elements import (
    constitutive_law,
    contact_and_friction,
    planar_assembly,
    spatial_assembly,
)
from dlo_ros.rod.elements import strains as kernels
from dlo_ros.rod.elements.planar_assembly import PLANAR


@linked()
def strains(q, rule, ref):
    """Strains of a configuration; see `strains.strains` and `planar_assembly.strains`."""
    if q.shape[1] == PLANAR:
        return planar_assembly.strains(q, rule)
    return kernels.strains(q, rule, ref)


@linked()
def transport(q, rule, ref):
    """The reference frame carried to configuration q; the plane needs none."""
    if q.shape[1] == PLANAR:
        return ref
    return kernels.transport(q, rule, ref)


@linked()
def strain_gradients(q, rule):
    """Arrays for the derivatives of the strains."""
    nb = rule.weight.size
    if q.shape[1] == PLANAR:
        return np.empty((nb, 2)), np.zeros((nb, 1, 4))
    return np.empty((nb, 3)), np.zeros((nb, 3, 8))


@linked()
def assemble(q, rule, ref, matter, response, predicted_tensions, gradient, band, grad_s, grad_o):
    """Energy of a configuration [J], its gradient and its exact Hessian.

    Args:
        q: configuration.
        rule, ref: quadrature tables, reference frame.
        matter: see `Material`.
        response: room for stresses and tangents, see `constitutive_law.room`.
        predicted_tensions: tensions that count in the Hessian instead of those at q, shape (nb,);
            none (0,) for the exact one.
        gradient, band, grad_s, grad_o: outputs, see `spatial_assembly.assemble`.
    """
    stretch, other = strains(q, rule, ref)
    energy = constitutive_law.respond(stretch, other, rule.weight, matter, response)
    for e in range(predicted_tensions.size):
        response.pull[e] = predicted_tensions[e]
    if q.shape[1] == PLANAR:
        planar_assembly.assemble(q, rule, other, response, gradient, band, grad_s, grad_o)
    else:
        spatial_assembly.assemble(q, rule, ref, other, response, gradient, band, grad_s, grad_o)
    around = matter.around
    if contact_and_friction.any_surroundings(around):
        energy += contact_and_friction.add_contact_and_friction(
            q, rule, around, matter.internal.anchor, gradient, band
        )
    return energy


@linked()
def energy_of(q, rule, ref, matter, response):
    """Energy of a configuration [J]; see `assemble`."""
    stretch, other = strains(q, rule, ref)
    energy = constitutive_law.respond(stretch, other, rule.weight, matter, response)
    return energy + contact_and_friction.energy_of(q, rule, matter.around, matter.internal.anchor)


@linked()
def stress_forces(rule, grad_s, grad_o, stress_s, stress_o):
    """Generalised forces, (P, 4 n) or (P, 2 n), of stresses (P, nb) and (P, nb, 3)."""
    dof = PLANAR if grad_s.shape[1] == 2 else 4
    out = np.zeros((stress_s.shape[0], dof * (rule.span[-1] + 4)))
    for a in range(stress_s.shape[0]):
        if dof == PLANAR:
            planar_assembly.scatter_stress(rule, grad_s, grad_o, stress_s[a], stress_o[a], out[a])
        else:
            spatial_assembly.scatter_stress(rule, grad_s, grad_o, stress_s[a], stress_o[a], out[a])
    return out


@linked()
def strain_sensitivities(rule, grad_s, grad_o, dq):
    """Strains (P, nb) and (P, nb, 3) of increments dq, (P, n, 4) or (P, n, 2), to first order."""
    count = dq.shape[0]
    stretch = np.empty((count, rule.weight.size))
    other = np.empty((count, rule.weight.size, 3))
    for a in range(count):
        if dq.shape[2] == PLANAR:
            planar_assembly.strain_increments(rule, grad_s, grad_o, dq[a], stretch[a], other[a])
        else:
            spatial_assembly.strain_increments(rule, grad_s, grad_o, dq[a], stretch[a], other[a])
    return stretch, other


@linked()
def add_scalar_band(band, scalar, spin, factor):
    """Add factor times a basis matrix, `scalar` (n, 4) for positions, `spin` for theta."""
    dof, last = band.shape[0] // scalar.shape[0], band.shape[1] - 1
    positions = min(dof, 3)
    for i in range(scalar.shape[0]):
        for j in range(max(0, i - 3), i + 1):
            k, at = 3 - i + j, last - dof * (i - j)
            for c in range(positions):
                band[dof * i + c, at] += factor * scalar[i, k]
            if positions < dof:
                band[dof * i + 3, at] += factor * spin[i, k]


@linked(from_python=True)
def multiply_scalar(scalar, spin, x, out):
    """Write basis matrix times x (n, 4) or (n, 2) to out."""
    out[:, :] = 0.0
    dof = x.shape[1]
    for i in range(scalar.shape[0]):
        for j in range(max(0, i - 3), i + 1):
            a = scalar[i, 3 - i + j]
            for c in range(min(dof, 3)):
                out[i, c] += a * x[j, c]
                if j < i:
                    out[j, c] += a * x[i, c]
            if dof == 4:
                a = spin[i, 3 - i + j]
                out[i, 3] += a * x[j, 3]
                if j < i:
                    out[j, 3] += a * x[i, 3]


@linked()
def predict_tensions(rule, response, grad_s, step, out):
    """Write the tensions (nb,) that the linear solution `step` (1, n d) predicts.

    With them in the next Hessian, Newton's method converges for stiff stretch as it would with
    tensions as unknowns: in few iterations and with long steps (Magisano, Leonetti and Garcea,
    Computer Methods in Applied Mechanics and Engineering 313, 2017).
    """
    nb, dof = rule.weight.size, grad_s.shape[1] if grad_s.shape[1] == PLANAR else 4
    move = step[0]
    for e in range(nb):
        more, at = 0.0, dof * rule.span[e]
        for i in range(4):
            for c in range(grad_s.shape[1]):
                more += rule.b1[e, i] * grad_s[e, c] * move[at + dof * i + c]
        out[e] = more
    for k in range(nb // 3):
        kernels.span_stretch(out[3 * k : 3 * k + 3], rule.stretch_linear[k])
    for e in range(nb):
        out[e] = response.tension[e] + response.stretch_tangent[e] * out[e]
