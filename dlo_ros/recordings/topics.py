# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Topics of the interface: their names, types, and rules of stamps, in one place.

The names are relative, and remappable.
"""

from __future__ import annotations

FUTURE = 10.0
"""Seconds ahead of the clock from which a stamp is refused: it is another clock's."""

IMAGE = "image_raw"
COMPRESSED = "image_raw/compressed"
CAMERA_INFO = "camera_info"
MASK = "image_mask"
DEPTH = "depth/image_raw"
DEPTH_INFO = "depth/camera_info"
COMMAND = "dlo/command"
OBSERVED = "dlo/observed"
OBSERVED_POINTS = "dlo/observed_points"
POINTS = "dlo/points"
START_POSE = "dlo/start_pose"
END_POSE = "dlo/end_pose"
PREDICTED = "dlo/predicted"
WRENCH_START = "dlo/wrench_start"
WRENCH_END = "dlo/wrench_end"
FORCE_START = "dlo/force_start"
FORCE_END = "dlo/force_end"
TENSION = "dlo/tension"
MIN_BEND_RADIUS = "dlo/min_bend_radius"
REHEARSAL_COMMAND = "dlo/rehearsal_command"
REHEARSAL = "dlo/rehearsal"
ERR = "dlo/err"
YOUNG_MODULUS = "dlo/young_modulus"
DENSITY = "dlo/density"
METRICS = "dlo/metrics"
MARKERS = "dlo/markers"
OVERLAY = "dlo/overlay"

TYPES: dict[str, str] = {
    DEPTH: "sensor_msgs/msg/Image",
    IMAGE: "sensor_msgs/msg/Image",
    COMPRESSED: "sensor_msgs/msg/CompressedImage",
    CAMERA_INFO: "sensor_msgs/msg/CameraInfo",
    MASK: "sensor_msgs/msg/Image",
    COMMAND: "trajectory_msgs/msg/MultiDOFJointTrajectory",
    OBSERVED: "geometry_msgs/msg/PoseArray",
    OBSERVED_POINTS: "sensor_msgs/msg/PointCloud2",
    POINTS: "sensor_msgs/msg/PointCloud2",
    START_POSE: "geometry_msgs/msg/PoseStamped",
    END_POSE: "geometry_msgs/msg/PoseStamped",
    PREDICTED: "geometry_msgs/msg/PoseArray",
    WRENCH_START: "geometry_msgs/msg/WrenchStamped",
    WRENCH_END: "geometry_msgs/msg/WrenchStamped",
    FORCE_START: "geometry_msgs/msg/WrenchStamped",
    FORCE_END: "geometry_msgs/msg/WrenchStamped",
    TENSION: "std_msgs/msg/Float64",
    MIN_BEND_RADIUS: "std_msgs/msg/Float64",
    REHEARSAL_COMMAND: "trajectory_msgs/msg/MultiDOFJointTrajectory",
    REHEARSAL: "geometry_msgs/msg/PoseArray",
    ERR: "std_msgs/msg/Float64",
    YOUNG_MODULUS: "std_msgs/msg/Float64",
    DENSITY: "std_msgs/msg/Float64",
    METRICS: "statistics_msgs/msg/MetricsMessage",
    MARKERS: "visualization_msgs/msg/MarkerArray",
    OVERLAY: "sensor_msgs/msg/Image",
}

WRENCHES = (WRENCH_START, WRENCH_END)
"""What force-torque sensors at the grips measure."""

LOADS = (FORCE_START, FORCE_END, TENSION, MIN_BEND_RADIUS)
"""What the DLO and its grips bear, beside each predicted spline."""

IMAGE_TYPES = (TYPES[IMAGE], TYPES[COMPRESSED])
CAMERA_TYPES = (*IMAGE_TYPES, TYPES[CAMERA_INFO])

LATCHED = frozenset({COMMAND, YOUNG_MODULUS, DENSITY})
"""Published transient local: who comes later still gets the last message."""

TRANSFORMS = "/tf_static"
TRANSFORMS_TYPE = "tf2_msgs/msg/TFMessage"
"""Transforms that hold for good, of the whole system; published transient local."""

FIXED_TRANSFORMS = 100
"""Messages with such transforms that who comes later still gets: each publisher has its own."""

MOVING_TRANSFORMS = "/tf"
"""Transforms that change, of the whole system."""

STATE = ("/clock", "/observer/ready", "/simulator/ready", "/identifier/ready")
"""Ends of the names of topics that describe the present state; played again they would be wrong."""


def of_camera(name: str, topic: str) -> str:
    """A topic of one of several cameras; that of the one camera where the name is empty."""
    return f"{name}/{topic}" if name else topic


def type_of(topic: str) -> str:
    """Message type of a topic of the interface, also of one of several cameras."""
    return TYPES[topic if topic in TYPES else relative(topic) or topic]


def is_topic(full_name: str, topic: str) -> bool:
    """Whether a full name such as `/left/dlo/observed` is the topic in some namespace."""
    return full_name.lstrip("/") == topic or full_name.endswith("/" + topic)


def is_latched(full_name: str) -> bool:
    """Whether a topic is published transient local, by its full name."""
    return full_name == TRANSFORMS or any(is_topic(full_name, topic) for topic in LATCHED)


def relative(full_name: str) -> str | None:
    """The topic of the interface that a full name stands for, None where it is another's."""
    return next((topic for topic in TYPES if is_topic(full_name, topic)), None)
