"""The YAML at the head of README.md by which Hugging Face's hub files a data set."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from lunar_rover_sim.campaign.contents import DEPTH, IMAGES, IMU, LABELS, LIDAR, STEREO
from lunar_rover_sim.campaign.layout import EPISODE_TABLE

# Licences by the hub's names, of those that data sets have; SPDX names in lower case.
_LICENSES = ('apache-2.0', 'bsd-2-clause', 'bsd-3-clause', 'cc-by-4.0', 'cc-by-nc-4.0',
             'cc-by-sa-4.0', 'cc0-1.0', 'mit', 'odbl', 'pddl')
_SIZES = ((1_000, 'n<1K'), (10_000, '1K<n<10K'), (100_000, '10K<n<100K'),
          (1_000_000, '100K<n<1M'))
_LARGEST = 'n>1M'
_TASKS = {DEPTH: 'depth-estimation', LABELS: 'image-segmentation'}


def front_matter(card: Mapping[str, Any]) -> str:
    """Return the block of a data card, with the lines `---` around it."""
    name, held = str(card['license']), card['contents']
    keeps_bags = card['campaign'].get('keep_bag', True)
    known = name.lower() in _LICENSES
    frames = card['statistics'].get('frames', {}).get('total', 0)
    size = next((text for limit, text in _SIZES if frames < limit), _LARGEST)
    values: dict[str, Any] = {
        'license': name.lower() if known else 'other',
        **({} if known else {'license_name': name}),
        'pretty_name': str(card['name']),
        'task_categories': ['robotics', *(task for name, task in _TASKS.items() if name in held)],
        'tags': ['moon', 'simulation', *(name for name in (STEREO, IMU, LIDAR) if name in held),
                 *(['slam'] if IMAGES in held else []), *(['ros2'] if keeps_bags else [])],
        'size_categories': [size],
        'configs': [{'config_name': 'episodes', 'data_files': EPISODE_TABLE}],
    }
    return '---\n' + yaml.safe_dump(values, sort_keys=False, allow_unicode=True) + '---\n\n'
