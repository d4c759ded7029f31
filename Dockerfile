# Untried: written after the sourced installation of ./bootstrap.
# ROS 2 Jazzy with this package in a workspace: docker build -t lunar_rover_sim . &&
# docker run --rm -p 127.0.0.1:8765:8765 -v "$PWD/runs:/runs" lunar_rover_sim \
#   lunar_rover_sim run baseline --fast --duration 5 -o /runs/a
FROM ros:jazzy

# libegl1 and libgl1-mesa-dri draw without a GPU.
RUN apt-get update && apt-get install -y --no-install-recommends \
        libegl1 libgl1 libgl1-mesa-dri python3-pip python3-venv \
        ros-jazzy-stereo-msgs ros-jazzy-tf2-msgs ros-jazzy-vision-msgs \
    && rm -rf /var/lib/apt/lists/*

COPY . /ws/lunar_rover_sim
# In an environment that sees the rclpy of the image, which is compiled against NumPy 1.
RUN python3 -m venv --system-site-packages /ws/venv \
    && /ws/venv/bin/pip install --no-cache-dir '/ws/lunar_rover_sim[view]' 'numpy<2'

ENV PATH=/ws/venv/bin:$PATH
CMD ["lunar_rover_sim", "--help"]
