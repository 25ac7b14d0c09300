# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The variables of the environment that determine how nodes find each other."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from dlo_ros.doctor.finding import Finding, ok, warning, wrong

DISTRIBUTION = "jazzy"
MIDDLEWARE = "rmw_fastrtps_cpp"
"""The middleware of the tests, ROS's default."""

DOMAINS = 232
"""Highest number of a domain whose ports exist."""

COMMON_DOMAINS = 101
"""Highest number of a domain whose ports Linux gives to nobody else."""

RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
"""Values of ROS_AUTOMATIC_DISCOVERY_RANGE."""

PROFILES = (
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
)

SHARED_MEMORY = Path("/dev/shm")
ROOM = 64 * 2**20
"""Bytes of shared memory that a camera's images want; a container has that many by default."""


def network(variables: Mapping[str, str] = os.environ) -> list[Finding]:
    """Middleware, domain and discovery as the environment has them.

    Args:
        variables: the environment's variables.
    """
    return [
        _middleware(variables),
        *_domain(variables),
        *_discovery(variables),
        *_profiles(variables),
        *_distribution(variables),
    ]


def _middleware(variables: Mapping[str, str]) -> Finding:
    chosen = variables.get("RMW_IMPLEMENTATION", "")
    if chosen in ("", MIDDLEWARE):
        return ok(f"middleware {chosen or f'{MIDDLEWARE} (the default)'}")
    return warning(
        f"middleware {chosen} (RMW_IMPLEMENTATION)",
        f"the package is tested on {MIDDLEWARE}; all nodes of a system should use the same one",
    )


def _domain(variables: Mapping[str, str]) -> list[Finding]:
    text = variables.get("ROS_DOMAIN_ID", "") or "0"
    said = f"ROS_DOMAIN_ID {text}"
    if not text.isdigit() or int(text) > DOMAINS:
        return [wrong(said, f"give a number from 0 to {COMMON_DOMAINS}, the same to all nodes")]
    if int(text) > COMMON_DOMAINS:
        return [warning(said, f"above {COMMON_DOMAINS} ports may be in use by other programs")]
    return [ok(f"domain {text}")]


def _discovery(variables: Mapping[str, str]) -> list[Finding]:
    found = []
    if variables.get("ROS_LOCALHOST_ONLY"):
        found.append(
            warning(
                f"ROS_LOCALHOST_ONLY is {variables['ROS_LOCALHOST_ONLY']}, which Jazzy calls "
                "outdated; while it is set, ROS_AUTOMATIC_DISCOVERY_RANGE does not count",
                "unset it; ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST does the same",
            )
        )
    reach = variables.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if reach and reach not in RANGES:
        found.append(
            wrong(f"ROS_AUTOMATIC_DISCOVERY_RANGE is {reach}", f"give one of {', '.join(RANGES)}")
        )
    elif reach == "OFF" and not variables.get("ROS_STATIC_PEERS"):
        found.append(
            wrong(
                "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: no node sees another one",
                "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, or SUBNET for several computers",
            )
        )
    elif reach:
        where = "this computer only" if reach == "LOCALHOST" else reach
        found.append(ok(f"discovery: {where} (ROS_AUTOMATIC_DISCOVERY_RANGE)"))
    return found


def _profiles(variables: Mapping[str, str]) -> list[Finding]:
    return [
        wrong(f"{name} is {variables[name]}, which is no file", "mend the path, or unset it")
        for name in PROFILES
        if variables.get(name) and not Path(variables[name]).is_file()
    ]


def _distribution(variables: Mapping[str, str]) -> list[Finding]:
    chosen = variables.get("ROS_DISTRO", "")
    if chosen in ("", DISTRIBUTION):
        return []
    return [warning(f"ROS 2 {chosen}", f"the package is made for {DISTRIBUTION.title()}")]


def shared_memory(folder: Path = SHARED_MEMORY) -> list[Finding]:
    """Whether images fit into the shared memory through which nodes hand them over.

    Args:
        folder: folder where shared memory is mounted; there is no finding where it does not exist.
    """
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return []
    if free >= ROOM:
        return []
    return [
        warning(
            f"{folder} has {free / 2**20:.0f} MB left: images may be lost between nodes",
            "remove old files fastrtps_* there while no node runs; docker run --shm-size=512m",
        )
    ]
