"""The episodes of a data set as a table: CSV, a row each."""

from __future__ import annotations

import csv
import io
from typing import Any

from lunar_rover_sim.campaign.layout import EPISODES
from lunar_rover_sim.campaign.statistics import MEANINGS

# Columns that are no statistics, with their meanings.
FIRST_COLUMNS = {'folder': 'folder of the episode in the data set',
                 'bag_hash': 'hash of the contents of its bag'}


def episode_table(card: dict[str, Any]) -> str:
    """Return the table of a data card; what is not known is empty, text is UTF-8."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator='\n')
    writer.writerow([*FIRST_COLUMNS, *MEANINGS])
    for name, episode in card['episodes'].items():
        values = [episode['statistics'].get(column) for column in MEANINGS]
        writer.writerow([f'{EPISODES}/{name}', episode.get('bag_hash') or '',
                         *(value if isinstance(value, (int, float)) else '' for value in values)])
    return file.getvalue()
