# The simulator in a container; it needs no GPU, display or ROS:
#   docker build -t lunar_rover_sim .
#   docker run --rm -v "$PWD/runs:/runs" lunar_rover_sim lunar_rover_sim demo -o /runs/demo
# On ROS 2 Jazzy, for `ros2 run` and a workspace of yours:
#   docker build -t lunar_rover_sim:jazzy --build-arg BASE=ros:jazzy .
ARG BASE=debian:bookworm-slim
FROM ${BASE}

# libegl1 and libgl1-mesa-dri draw without a GPU.
RUN apt-get update && apt-get install -y --no-install-recommends \
        ca-certificates libegl1 libgl1 libgl1-mesa-dri python3 python3-pip python3-venv \
    && if [ -d /opt/ros/jazzy ]; then apt-get install -y --no-install-recommends \
        ros-jazzy-common-interfaces ros-jazzy-simulation-interfaces ros-jazzy-tf2-msgs \
        ros-jazzy-vision-msgs; fi \
    && rm -rf /var/lib/apt/lists/*

COPY . /src
# Where ROS 2 is installed, its rclpy is used, which is compiled against NumPy 1; elsewhere that of
# PyPI.
RUN if [ -d /opt/ros/jazzy ]; then \
        python3 -m venv --system-site-packages /opt/venv \
        && /opt/venv/bin/pip install --no-cache-dir '/src[view,policy]' 'numpy<2'; \
    else \
        python3 -m venv /opt/venv \
        && /opt/venv/bin/pip install --no-cache-dir '/src[ros,view,policy]' \
            -c /src/resource/constraints.txt; \
    fi && rm -rf /src

ENV PATH=/opt/venv/bin:$PATH
CMD ["lunar_rover_sim", "--help"]
