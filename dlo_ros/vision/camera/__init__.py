# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The calibrated camera: pinhole projection and lens distortion."""
