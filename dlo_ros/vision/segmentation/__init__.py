# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Segmentation: from an image to ridges, strips along curves, and the DLO's profile across."""
