"""The README's tables are those of the code.

`python test/test_readme.py` writes them anew.
"""

from __future__ import annotations

from pathlib import Path
import re
import sys

README = Path(__file__).resolve().parents[2] / 'README.md'


def tables() -> dict[str, str]:
    """Return marker → text that belongs between its comments."""
    from lunar_rover_sim import topics
    from lunar_rover_sim.cli.parameters import markdown
    rates = {topics.STATE: '200 Hz', topics.FRAME: '10 Hz'}
    rows = ['| topic | type | from | rate | notes |', '|---|---|---|---|---|']
    for topic in topics.CONTRACT:
        rate = '20 Hz' if topic is topics.CMD_VEL else rates.get(topic.rate, topic.rate)
        rows.append(f'| `{topic.name}` | {topic.type.replace("/msg/", "/")} | '
                    f'{topic.node.removesuffix("_node")} | {rate} | {topic.note} |')
    return {'topics': '\n'.join(rows), 'parameters': markdown()}


def rendered(text: str) -> str:
    """Return the README with its tables made anew."""
    for marker, table in tables().items():
        pattern = re.compile(f'(<!-- {marker} -->).*?(<!-- /{marker} -->)', re.DOTALL)
        text = pattern.sub(lambda m: f'{m[1]}\n\n{table}\n\n{m[2]}', text)
    return text


def test_tables_are_current() -> None:
    """Topics and parameters in the README are those of the code."""
    text = README.read_text(encoding='utf-8')
    assert rendered(text) == text, 'run: python test/test_readme.py'


if __name__ == '__main__':
    README.write_text(rendered(README.read_text(encoding='utf-8')), encoding='utf-8')
    sys.exit(0)
