# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Design of experiments: the manipulation with the largest expected information."""
