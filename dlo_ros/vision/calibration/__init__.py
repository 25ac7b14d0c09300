# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Calibration of cameras by views of a pattern: corners, lens model, pose, calibration file."""
