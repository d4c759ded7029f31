"""The data card in Croissant, the vocabulary of MLCommons for data sets (version 1.0).

Croissant (Akhtar et al., NeurIPS 2024) describes files and records in JSON-LD, so that search
engines find a data set and loaders read it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import hashlib
from typing import Any

from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.campaign.dataset import FIRST_COLUMNS
from lunar_rover_sim.campaign.layout import CARD_FILE, EPISODE_TABLE, EPISODES
from lunar_rover_sim.campaign.statistics import MEANINGS
from lunar_rover_sim.products.sequences.export import FORMATS, WEBDATASET
from lunar_rover_sim.products.sequences.sensor_samples import COLUMNS, SCAN_COLUMNS
from lunar_rover_sim.sensors.registry import card_contents

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
