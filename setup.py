"""Installation of the ROS 2 package lunar_rover_sim (ament_python)."""

from glob import glob
import os
from pathlib import Path
import re
import sys

from setuptools import find_packages, setup

NAME = 'lunar_rover_sim'
SHARE = os.path.join('share', NAME)
# Read, not imported: a build has none of what the package imports.
VERSION = re.search(r"^__version__ = '(.+)'$",
                    Path(NAME, '__init__.py').read_text('utf-8'), re.M)[1]
# There are wheels of it for CPython 3.11 to 3.14, on Linux and macOS.
GTSAM = 'gtsam>=4.3,<5; python_version>="3.11" and python_version<"3.15" and ' \
        'sys_platform!="win32"'
# Its validators are those of the tests. There are no wheels of it for Python 3.10.
USD = 'usd-core>=26.5,<27; python_version>="3.11"'


def folder(path):
    """Return data_files entries for every file below `path`, keeping its folders."""
    return [(os.path.join(SHARE, root), [os.path.join(root, name) for name in sorted(names)])
            for root, _, names in os.walk(path) if names]


# colcon, and packagers of ROS, call setup.py themselves; pip builds a wheel, and makes bin/NAME of
# the console script. The others put console scripts into lib/NAME, as setup.cfg says, where
# `ros2 run` looks; the shell looks in bin/.
by_pip = {'bdist_wheel', 'dist_info', 'editable_wheel'} & set(sys.argv)
programs = [] if by_pip else [('bin', ['resource/bin/' + NAME])]

setup(
    name=NAME,
    version=VERSION,
    description='A spoke-leg micro rover on the Moon: MuJoCo walk, photorealistic stereo, rosbag2',
    long_description=Path('README.md').read_text('utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    maintainer='lunar_rover_sim developers',
    maintainer_email='lunar-rover-sim@example.com',
    packages=find_packages(include=[NAME, NAME + '.*']),
    package_data={NAME: ['image/rendering/shaders/*', '*/templates/*', '*/*/templates/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
        (SHARE, ['package.xml']),
        (os.path.join(SHARE, 'launch'), sorted(glob('lunar_rover_sim/nodes/launch/*.launch.py'))),
        *folder('config'),
        *folder('resource/orb_slam3'),
        *programs,
    ],
    zip_safe=False,
    python_requires='>=3.10',
    install_requires=[
        'click>=8.1.3',
        'Jinja2>=3.1',
        'matplotlib>=3.8',
        'mcap>=1.2',
        "backports.zstd>=1.0; python_version < '3.14'",     # as rosbags has it
        'moderngl>=5.12',
        # 4 needs Python 3.11.
        'mujoco>=3.17,<5; python_version<"3.11"',
        'mujoco>=4,<5; python_version>="3.11"',
        'numba>=0.58',
        # 1.26 for the rclpy of Ubuntu 24.04, 2 with the wheels.
        'numpy>=1.26,<3',
        'opencv-python-headless>=4.9,<6',
        'Pillow>=10',
        'psutil>=5.9',
        'pyerfa>=2.0',
        'PyYAML>=6',
        'rasterio>=1.4',
        'rich>=13',
        'rosbags>=0.11,<1',
        # Written in C: rosbags then writes and opens a bag of 25 topics twice as fast.
        'ruamel.yaml.clib>=0.2.12',
        'scikit-image>=0.22',
        'scipy>=1.11',
        'trimesh>=4',
    ],
    extras_require={
        # Where no ROS 2 is installed: real rclpy from PyPI. Never beside a sourced /opt/ros.
        'ros': ['ros-rclpy[fastrtps]==7.1.6', 'ros-jazzy-common-interfaces==5.3.6'],
        # Campaigns on the workers of a Dask cluster.
        'cluster': ['distributed>=2024.4'],
        # OpenUSD stages.
        'usd': [USD],
        # Gymnasium environments.
        'learn': ['gymnasium>=1.1'],
        # Training of policies. Take torch from its CPU index first, or it brings CUDA.
        'train': ['gymnasium>=1.1', 'stable-baselines3>=2.4', 'sb3-contrib>=2.4', 'torch>=2.5',
                  'cma>=4', 'onnx>=1.16', 'onnxruntime>=1.18', 'tensorboard', 'tqdm'],
        # The SLAM system `graph`.
        'graph': [GTSAM],
        # Policies: policy_node and `validate policy`.
        'policy': ['onnxruntime>=1.18'],
        # The live view in a browser.
        'view': ['websockets>=13'],
        # evo is GPL: the tests compare with it, nothing that is shipped imports it.
        'test': ['evo>=1.30', 'pytest>=9', 'pytest-xdist>=3.5', 'pytest-regressions>=2.5',
                 'import-linter>=2', 'isort>=5', 'mlcroissant>=1.0', 'mypy>=1.10',
                 'pycocotools>=2.0.8', 'pycodestyle>=2.11', 'ruff>=0.6', 'vulture>=2.11',
                 'types-PyYAML', 'types-psutil', 'mcap-ros2-support>=0.5',
                 'setuptools>=70.1', 'distributed>=2024.4', GTSAM, USD,
                 'webdataset>=1.0', 'websockets>=15', 'gymnasium>=1.1', 'onnx>=1.16',
                 'onnxruntime>=1.18'],
        'docs': ['furo>=2024.8', 'myst-nb>=1.1', 'sphinx>=7'],
    },
    # Each of these is a name for resource/nodes/start.
    scripts=sorted(glob('resource/nodes/*_node')),
    entry_points={'console_scripts': [
        'lunar_rover_sim = lunar_rover_sim.cli.main:main',
        'lunar_rover_sim_node = lunar_rover_sim.nodes.entry_points:main',
    ]},
)
