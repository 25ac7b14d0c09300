# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The elements of the rod: strains, constitutive law, element stiffness, contact and friction.

An element is one knot span of the spline; `element_stiffness` gathers its stiffness matrix, which
`spatial_assembly` and `planar_assembly` add to that of the rod.
"""
