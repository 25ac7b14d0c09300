# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
# dlo_ros on a full ROS 2 Jazzy. Written and linted (hadolint); not run where this package is made, which has no Docker.
#
#   docker build --tag dlo_ros .
#   docker run --rm --shm-size=512m --volume "$PWD/build/docker:/demo" dlo_ros      # the demo; its results in build/docker
#   docker run --rm -it --shm-size=512m --network host dlo_ros ros2 run dlo_ros doctor
FROM osrf/ros:jazzy-desktop-full

SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /ws

# What apt has, from package.xml alone, so that a change of the sources does not install it anew.
COPY package.xml src/dlo_ros/package.xml
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3-venv \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src --default-yes \
    && rm -rf /var/lib/apt/lists/*

# What apt does not have, in a virtual environment that sees ROS's packages; NumPy stays the one that ROS was built with.
RUN python3 -m venv --system-site-packages /opt/dlo_ros \
    && /opt/dlo_ros/bin/pip install --no-cache-dir 'numba>=0.59' 'rosbags>=0.11.7' 'numpy<2'

COPY . src/dlo_ros
# The kernels are compiled for the processor of the machine that builds; another one compiles them again at the first start.
RUN source /opt/ros/jazzy/setup.bash \
    && /opt/dlo_ros/bin/python "$(command -v colcon)" build --packages-select dlo_ros \
    && source install/setup.bash \
    && /opt/dlo_ros/bin/python -m dlo_ros.compile

ENTRYPOINT ["/ros_entrypoint.sh", "bash", "-c", "source /ws/install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "run", "dlo_ros", "demo", "--output", "/demo"]
