"""The page of a data set, opened in a real browser."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
import shutil
import subprocess

import cv2
import numpy as np
import pytest
import synthetic_bag
from waiting import LIMIT_S

from lunar_rover_sim.campaign.campaign_file import parse_campaign
from lunar_rover_sim.campaign.dataset import Dataset
from lunar_rover_sim.campaign.episode_process import finish
from lunar_rover_sim.campaign.layout import EPISODES
from lunar_rover_sim.campaign.manifest import write_json
from lunar_rover_sim.cli.main import main

BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')
HOSTILE = '<script>document.title = "owned"</script>'


@pytest.fixture(scope='module')
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of a data set of one episode, whose description is hostile."""
    folder = tmp_path_factory.mktemp('set')
    campaign = parse_campaign(f"episodes: 1\nname: moon\ndescription: '{HOSTILE}'",
                              folder / 'x.yaml')
    with Dataset(folder / 'data', campaign) as dataset:
        dataset.record()
        made = folder / 'data' / 'partial' / 'made'
        made.mkdir()
        synthetic_bag.write(made / 'bag', synthetic_bag.drive(1.0))
        finish(made, {'name': '0000', 'drawn': {'seed': 1}, 'formats': [], 'keep_bag': True,
                      'scenario_sha256': ''}, 1.0)
        made.rename(folder / 'data' / EPISODES / '0000')
    write_json_failed(folder / 'data' / 'failed' / '0001')
    assert main(['dataset', 'show', str(folder / 'data')]) == 0
    return folder / 'data' / 'index.html'


def write_json_failed(folder: Path) -> None:
    """Record a failed episode."""
    folder.mkdir(parents=True)
    write_json(folder / 'error.json', {'error': 'the sun <b>set</b>'})


class Links(HTMLParser):
    """Collects what a page would load."""

    def __init__(self) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.targets += [value or '' for name, value in attrs
                         if name in ('src', 'href', 'srcset', 'data', 'action')]


def test_the_page_is_self_contained(page: Path) -> None:
    """Every picture is in it; nothing is loaded, nothing runs."""
    links = Links()
    links.feed(page.read_text(encoding='utf-8'))
    assert len(links.targets) == 1 + 3 + 1  # distributions, thumbnails, path
    assert all(target.startswith('data:image/') for target in links.targets)
    assert not {'script', 'iframe', 'link', 'object', 'b'} & set(links.tags)
    text = page.read_text(encoding='utf-8')
    assert '&lt;script&gt;' in text and 'the sun &lt;b&gt;set' in text
    assert '<td>0000</td><td>10</td>' in text   # name and frames


def test_a_browser_shows_it(page: Path, tmp_path: Path) -> None:
    """A real headless browser renders text and pictures, and does not run what is hostile."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        pytest.skip(f'none of {", ".join(BROWSERS)} is installed')
    options = [browser, '--headless', '--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage',
               '--hide-scrollbars', f'--user-data-dir={tmp_path / "profile"}']
    shot = tmp_path / 'page.png'
    subprocess.run([*options, '--window-size=1200,1800', f'--screenshot={shot}', page.as_uri()],
                   check=True, capture_output=True, timeout=LIMIT_S)
    picture = cv2.imread(str(shot))
    assert picture.shape[:2] == (1800, 1200)
    dom = subprocess.run([*options, '--dump-dom', page.as_uri()], check=True, capture_output=True,
                         text=True, timeout=LIMIT_S).stdout
    assert '<title>moon</title>' in dom
    assert '&lt;script&gt;' in dom
    assert 'the sun &lt;b&gt;set' in dom
    # Thumbnails are where the page is neither paper nor ink: a band of the texture's grey levels.
    grey = picture.mean(axis=2)
    assert np.mean((grey > 40) & (grey < 215)) > 0.05
    assert len(np.unique(grey)) > 100
