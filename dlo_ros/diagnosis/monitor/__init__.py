# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The residual monitor of a live identification, and the causes that it suspects."""
