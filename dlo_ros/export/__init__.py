# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Export: the model as a chain of rigid links, in the formats of other simulators."""
