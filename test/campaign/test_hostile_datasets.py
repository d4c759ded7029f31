"""Data sets are untrusted: what they say is shown, or one CampaignError says why not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from lunar_rover_sim.campaign.card import make_card, write_card
from lunar_rover_sim.campaign.page import write_page
from lunar_rover_sim.errors import CampaignError


def dataset(folder: Path, campaign: Any = None, **statistics: Any) -> Path:
    """Write a data set of one episode with a broken picture."""
    episode = folder / 'episodes' / '0000'
    (episode / 'kitti' / 'image_0').mkdir(parents=True)
    (episode / 'kitti' / 'image_0' / '000000.png').write_bytes(b'\x89PNG\r\n\x1a\nbroken')
    (episode / 'manifest.json').write_text(json.dumps({'statistics': statistics}))
    (folder / 'campaign.json').write_text(json.dumps({'campaign': campaign or {}}))
    return folder


@pytest.mark.parametrize(('campaign', 'words'), [
    ({'formats': [{}]}, 'formats: .* is not a list of names'),
    ({'formats': 3}, 'formats: 3 is not a list of names'), ({'vary': [1]}, 'vary: .* mapping'),
    ({'name': float('nan')}, 'card.json: cannot be written')])
def test_campaigns(tmp_path, campaign, words):
    with pytest.raises(CampaignError, match=words):
        write_card(dataset(tmp_path, campaign))


def test_pictures_and_numbers(tmp_path, capfd):
    """A broken picture is named on the page, numbers beyond all bounds are left out."""
    folder = dataset(tmp_path, duration_s=10**400, sgm_density=float('inf'), distance_m=2.0)
    card = make_card(folder)
    assert list(card['statistics']) == ['distance_m']
    write_page(folder, card, tmp_path / 'page.html')
    assert '000000.png: cannot be read as a picture' in (tmp_path / 'page.html').read_text()
    assert capfd.readouterr().err == ''


def test_what_was_drawn_is_a_mapping(tmp_path):
    folder = dataset(tmp_path)
    (folder / 'episodes' / '0000' / 'manifest.json').write_text('{"statistics": {}, "drawn": 3}')
    with pytest.raises(CampaignError, match='drawn is not a mapping'):
        make_card(folder)


def test_a_device_is_no_manifest(tmp_path):
    folder = dataset(tmp_path)
    (folder / 'episodes' / '0000' / 'manifest.json').unlink()
    (folder / 'episodes' / '0000' / 'manifest.json').symlink_to('/dev/zero')
    with pytest.raises(CampaignError, match='not a regular file'):
        make_card(folder)
