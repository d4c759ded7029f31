"""The data card: the content of a data set, for people (Markdown) and programs (JSON).

Croissant is the vocabulary of MLCommons for data sets (version 1.0; Akhtar et al., NeurIPS 2024):
it describes files and records in JSON-LD, so that search engines find a data set and loaders read
it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lunar_rover_sim import __version__
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import brief, CampaignError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import BAG_FOLDER, counted
from lunar_rover_sim.campaign.dataset import episode_table, failures, FIRST_COLUMNS, manifests
from lunar_rover_sim.campaign.manifest import (CAMPAIGN_FILE, CARD_FILE, CROISSANT_FILE,
                                               EPISODE_TABLE, EPISODES, json_text, read_json,
                                               README_FILE)
from lunar_rover_sim.campaign.statistics import MEANINGS
from lunar_rover_sim.products.sequences.export import FORMATS, WEBDATASET
from lunar_rover_sim.products.sequences.sensor_samples import COLUMNS, SCAN_COLUMNS
from lunar_rover_sim.sensors.registry import card_contents

IMAGES, STEREO, DEPTH, LABELS, IMU, LIDAR = (
    'images', 'stereo', 'depth', 'labels', 'imu', 'lidar')
# Each needs one topic of each of its groups.
_LEFT = topics.LEFT_IMAGE, topics.LEFT_COMPRESSED
_NEEDS: Mapping[str, tuple[tuple[topics.Topic, ...], ...]] = {
    IMAGES: (_LEFT,),
    STEREO: (_LEFT, (topics.RIGHT_IMAGE, topics.RIGHT_COMPRESSED)),
    DEPTH: ((topics.TRUE_DEPTH,),),
    LABELS: ((topics.LABELS,),),
    IMU: ((topics.IMU_RAW,),),
    LIDAR: (topics.OF_LIDAR,),
    **{content.name: (published,) for content, published in card_contents().items()}}
CONTENTS = tuple(_NEEDS)
LARGEST = 1e18     # of a statistic
_KINDS = {IMAGES: 'images', STEREO: 'stereo images', DEPTH: 'depth', LABELS: 'labels',
          LIDAR: 'LiDAR scans', **{content.name: content.title for content in card_contents()}}
_SUMS = ('duration_s', 'frames', 'distance_m', 'bytes')
_BAG = ('rosbag2 (MCAP or SQLite), all topics; the bag of an episode is checked by '
        '`lunar_rover_sim bag check`')


def make_card(dataset: Path) -> dict[str, Any]:
    """Return the data card of a data set as plain values.

    Its `statistics` are name → mean, min, max over the episodes, and total of what can be summed.

    Raises:
        CampaignError: If the folder is not a data set.
    """
    episodes = list(manifests(dataset))
    recorded = read_json(dataset / CAMPAIGN_FILE)
    campaign = recorded.get('campaign')
    if not isinstance(campaign, dict):
        raise CampaignError(f'{dataset / CAMPAIGN_FILE}: has no campaign')
    formats = campaign.get('formats', [])
    if not isinstance(formats, list) or not all(isinstance(name, str) for name in formats):
        raise CampaignError(f'{dataset / CAMPAIGN_FILE}: formats: {brief(formats)} is not a list '
                            'of names')
    for name in ('settings', 'vary'):
        value = campaign.get(name, {})
        if not isinstance(value, dict):
            raise CampaignError(f'{dataset / CAMPAIGN_FILE}: {name}: {brief(value)} is not a '
                                'mapping')
    failed = failures(dataset)
    presets = sorted({str(e['statistics'].get('imu_preset') or '') for e in episodes} - {''})
    return {
        'name': campaign.get('name'), 'description': campaign.get('description'),
        'license': campaign.get('license'), 'version': __version__, 'campaign': campaign,
        'contents': contents(_recorded(episodes), campaign), 'imu_presets': presets,
        'episodes': {e['name']: {'drawn': e.get('drawn'), 'bag_hash': e.get('bag_hash'),
                                 'statistics': e['statistics']} for e in episodes},
        'failed': failed,
        'statistics': {name: summary for name in MEANINGS
                       if (summary := _summary(name, episodes)) is not None},
        'meanings': dict(MEANINGS),
    }


def write_card(dataset: Path) -> dict[str, Any]:
    """Write the data card into the folder of a data set, in four files; return it.

    card.json, README.md, episodes.csv and croissant.json.

    Raises:
        CampaignError: If the folder is not a data set, or they cannot be written.
    """
    card = make_card(dataset)
    try:
        described = {CARD_FILE: json_text(card).encode(),
                     EPISODE_TABLE: episode_table(card).encode()}
        files = {**described, README_FILE: markdown(card).encode(),
                 CROISSANT_FILE: json_text(croissant(
                     card, _description(card), described, _kept(card))).encode()}
    except ValueError as error:     # NaN is no JSON
        raise CampaignError(f'{dataset / CARD_FILE}: cannot be written: {error}') from None
    for name, content in files.items():
        atomic_write(dataset / name, content, CampaignError)
    return card


def _description(card: dict[str, Any]) -> str:
    if card['description']:
        return str(card['description'])
    held = card['contents']
    kinds = [_KINDS[name] for name in held if not (name == IMAGES and STEREO in held)]
    words = ' and '.join([', '.join(kinds[:-1]), kinds[-1]] if kinds[1:] else kinds)
    return f'Simulated drives of a rover on the Moon{": " if words else ""}{words}.'


def _recorded(episodes: Sequence[dict[str, Any]]) -> set[str]:
    """Return the topics that any episode has; none of manifests that do not name them."""
    return {name for episode in episodes if isinstance(episode.get('topics'), list)
            for name in episode['topics'] if isinstance(name, str)}


def _kept(card: dict[str, Any]) -> dict[str, str]:
    """Return the folders that each episode holds, with what is in them."""
    campaign = card['campaign']
    return {**({BAG_FOLDER: _BAG} if campaign.get('keep_bag', True) else {}),
            **{kind: FORMATS[kind].layout for kind in campaign.get('formats', ())
               if kind in FORMATS}}


def _summary(name: str, episodes: Sequence[dict[str, Any]]) -> dict[str, float] | None:
    values = [value for e in episodes
              if isinstance(value := e['statistics'].get(name), (int, float))
              and abs(value) <= LARGEST]
    if not values:
        return None
    result = {'mean': float(f'{np.mean(values):.9g}'), 'min': min(values), 'max': max(values)}
    if name in _SUMS:
        result['total'] = float(f'{sum(values):.9g}')
    return result


def markdown(card: dict[str, Any]) -> str:
    """Return the data card as Markdown, with the head that Hugging Face's hub reads."""
    campaign = card['campaign']
    lines = [f'# {card["name"]}', '', _description(card), '',
             f'- licence: {card["license"]}',
             f'- made with lunar_rover_sim {card["version"]} from the scenario '
             f'`{campaign.get("base")}`, design {campaign.get("design")}, seed '
             f'{campaign.get("seed")}',
             f'- {counted(len(card["episodes"]), "episode")}'
             + (f', {len(card["failed"])} more failed' if card['failed'] else ''),
             *([f'- IMU noise: {", ".join(card["imu_presets"])}'] if IMU in card['contents']
               else []), '',
             '## What is in an episode', '',
             'Every folder in `episodes/` holds `scenario.yaml`, from which `lunar_rover_sim run '
             'scenario.yaml -o DIR` records the same messages, byte for byte on one kind of '
             'machine; `manifest.json` with the sizes and SHA-256 of all files, the result of the '
             'bag check and the statistics; and:', '',
             *(f'- `{kind}`: {what}' for kind, what in _kept(card).items()), '',
             '## Statistics', '', '| | mean | min | max | total | meaning |', '|---|---|---|---|'
             '---|---|']
    for name, summary in card['statistics'].items():
        cells = [number(summary.get(key)) for key in ('mean', 'min', 'max', 'total')]
        lines.append(f'| {name} | {" | ".join(cells)} | {card["meanings"][name]} |')
    lines += _parameters('What varies', 'distribution', campaign.get('vary', {}))
    if campaign.get('settings'):
        lines += _parameters('What is set in all episodes', 'value', campaign['settings'])
    lines += ['', '## Limits', '',
              'Images are rendered, not photographed. Semi-global matching leaves holes and errors'
              ' on purpose; ground truth has none. Slip and penetration follow a contact model,'
              ' not measured regolith.', '']
    if card['failed']:
        lines += ['## Failed episodes', '',
                  *(f'- {name}: {_cell(error)}' for name, error in card['failed'].items()), '']
    return front_matter(card) + '\n'.join(lines)


def number(value: object) -> str:
    """Return a number as text of at most five digits; nothing for None."""
    if isinstance(value, float):
        return f'{value:.4g}' if abs(value) < 1e5 else f'{value:.5g}'
    return '' if value is None else str(value)


def _parameters(title: str, column: str, values: dict[str, Any]) -> list[str]:
    """Return a section with a table of parameters."""
    return ['', f'## {title}', '', f'| parameter | {column} |', '|---|---|',
            *(f'| `{_cell(name)}` | `{_cell(str(value))}` |' for name, value in values.items())]


def _cell(text: str) -> str:
    return ' '.join(text.split()).replace('|', '\\|').replace('`', "'")


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


_CONFORMS_TO = 'http://mlcommons.org/croissant/1.0'
_INTEGERS = ('frames', 'bytes')
# Of the specification.
_CONTEXT: dict[str, Any] = {
    '@language': 'en', '@vocab': 'https://schema.org/',
    'citeAs': 'cr:citeAs', 'column': 'cr:column', 'conformsTo': 'dct:conformsTo',
    'cr': 'http://mlcommons.org/croissant/', 'rai': 'http://mlcommons.org/croissant/RAI/',
    'data': {'@id': 'cr:data', '@type': '@json'},
    'dataType': {'@id': 'cr:dataType', '@type': '@vocab'},
    'dct': 'http://purl.org/dc/terms/', 'equivalentProperty': 'cr:equivalentProperty',
    'examples': {'@id': 'cr:examples', '@type': '@json'},
    'extract': 'cr:extract', 'field': 'cr:field', 'fileProperty': 'cr:fileProperty',
    'fileObject': 'cr:fileObject', 'fileSet': 'cr:fileSet', 'format': 'cr:format',
    'includes': 'cr:includes', 'isLiveDataset': 'cr:isLiveDataset',
    'jsonPath': 'cr:jsonPath', 'key': 'cr:key', 'md5': 'cr:md5',
    'parentField': 'cr:parentField', 'path': 'cr:path', 'recordSet': 'cr:recordSet',
    'references': 'cr:references', 'regex': 'cr:regex', 'repeated': 'cr:repeated',
    'replace': 'cr:replace', 'samplingRate': 'cr:samplingRate', 'sc': 'https://schema.org/',
    'separator': 'cr:separator', 'source': 'cr:source', 'subField': 'cr:subField',
    'transform': 'cr:transform',
}


def croissant(card: Mapping[str, Any], description: str, contents: Mapping[str, bytes],
              kept: Mapping[str, str]) -> dict[str, Any]:
    """Return the description of a data set as JSON-LD.

    Args:
        card: See `card.make_card`.
        contents: Those of CARD_FILE and EPISODE_TABLE.
        kept: Folders that each episode holds, with what is in them.
    """
    return {
        '@context': _CONTEXT, '@type': 'sc:Dataset', 'conformsTo': _CONFORMS_TO,
        'name': str(card['name']),
        'description': description,
        'license': f'https://spdx.org/licenses/{card["license"]}.html',
        'version': '1.0.0',
        'distribution': [_file(CARD_FILE, 'application/json', contents),
                         _file(EPISODE_TABLE, 'text/csv', contents),
                         *(_file_set(*item) for item in kept.items()),
                         *([_lidar_set()] if WEBDATASET in kept and LIDAR in card['contents']
                           else [])],
        'recordSet': [_records()],
    }


def _file(name: str, media: str, contents: Mapping[str, bytes]) -> dict[str, Any]:
    return {'@type': 'cr:FileObject', '@id': name, 'name': name, 'contentUrl': name,
            'encodingFormat': media, 'contentSize': f'{len(contents[name])} B',
            'sha256': hashlib.sha256(contents[name]).hexdigest()}


def _file_set(kind: str, description: str) -> dict[str, Any]:
    return {'@type': 'cr:FileSet', '@id': kind, 'name': kind, 'description': description,
            'encodingFormat': 'application/octet-stream', 'includes': f'{EPISODES}/*/{kind}/**'}


def _lidar_set() -> dict[str, Any]:
    """Return the LiDAR scans in the shards: what their columns are, since NPY does not say it."""
    return {'@type': 'cr:FileSet', '@id': f'{WEBDATASET}/lidar', 'name': f'{WEBDATASET}/lidar',
            'description': 'LiDAR scans of the samples, float32 in the frame of the LiDAR: points '
            f'with the columns {", ".join(COLUMNS)} (lidar.npy, each at its own time; '
            'lidar_deskewed.npy, in the frame of the start of the scan), or a ring with '
            f'{", ".join(SCAN_COLUMNS)} (lidar_scan.npy). It is the last scan that began at or '
            'before the image; the JSON of the sample has its stamp in ns, and T_left_lidar.',
            'encodingFormat': 'application/octet-stream', 'containedIn': {'@id': WEBDATASET},
            'includes': ['*.lidar.npy', '*.lidar_deskewed.npy', '*.lidar_scan.npy']}


def _records() -> dict[str, Any]:
    types = {**dict.fromkeys(FIRST_COLUMNS, 'sc:Text'), **dict.fromkeys(MEANINGS, 'sc:Float'),
             **dict.fromkeys(_INTEGERS, 'sc:Integer')}
    meanings = {**FIRST_COLUMNS, **MEANINGS}
    return {'@type': 'cr:RecordSet', '@id': 'episodes', 'name': 'episodes',
            'key': {'@id': 'episodes/folder'},
            'field': [{'@type': 'cr:Field', '@id': f'episodes/{name}', 'name': name,
                       'description': meanings[name], 'dataType': types[name],
                       'source': {'fileObject': {'@id': EPISODE_TABLE},
                                  'extract': {'column': name}}} for name in meanings]}


def recorded_topics(bag: Bag) -> list[str]:
    """Return the topics of the contract of which a bag holds messages."""
    known = topics.of_legs(topics.CONTRACT, topics.legs_of(bag.types))
    return [topic.name for topic in known if bag.count(topic.name)]


def contents(recorded: Iterable[str], campaign: Mapping[str, Any]) -> list[str]:
    """Return those of CONTENTS that a data set holds.

    Args:
        recorded: Topics of the contract that were recorded.
        campaign: As in CAMPAIGN_FILE. Without bags, what its formats take of the topics counts.
    """
    held = {topic.name for name in recorded if (topic := topics.topic_of(name)) is not None}
    if not campaign.get('keep_bag', True):
        taken: set[str] = set()
        for kind in campaign.get('formats', ()):
            if kind in FORMATS:
                made = FORMATS[kind]
                taken.update(made.needs, made.uses)
        held &= taken
    return [name for name in CONTENTS
            if all(any(topic.name in held for topic in group) for group in _NEEDS[name])]
