# timo_sim with ROS 2 Jazzy, Kilted or Lyrical; --build-arg ROS_DISTRO=lyrical chooses:
#   docker build -t timo_sim . && docker run --rm timo_sim ros2 run timo_sim sim_node
ARG ROS_DISTRO=jazzy

# What it needs to run.
FROM ros:${ROS_DISTRO}-ros-core AS base
SHELL ["/bin/bash", "-eo", "pipefail", "-c"]
WORKDIR /ws
COPY package.xml requirements-pip.txt src/timo_sim/
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-rosdep python3-venv \
    && rosdep init && rosdep update --rosdistro "$ROS_DISTRO" \
    && rosdep install --from-paths src --dependency-types exec -y \
    && python3 -m venv --system-site-packages venv \
    && venv/bin/pip install --no-cache-dir -r src/timo_sim/requirements-pip.txt \
    && rm -rf /var/lib/apt/lists/*

FROM base AS build
RUN apt-get update && apt-get install -y --no-install-recommends python3-colcon-common-extensions
COPY . src/timo_sim
RUN source "/opt/ros/$ROS_DISTRO/setup.bash" && source venv/bin/activate \
    && python -m colcon build --base-paths src --packages-select timo_sim

FROM base
COPY --from=build /ws/install install
ENTRYPOINT ["/bin/bash", "-c", "source /ws/install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "run", "timo_sim", "sim_node"]
