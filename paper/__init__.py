# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The five experiments of the paper on data from the independent simulator (`make paper`)."""
