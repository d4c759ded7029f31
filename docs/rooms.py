"""The architecture as a picture: rooms, their sizes, and the imports between them.

    python docs/rooms.py FILE.svg

Rooms are the top-level packages and modules of `lunar_rover_sim`. Each stands above every room
that it imports. An arrow is left out where a chain of other arrows already leads to its end
(transitive reduction), so that what is drawn is what holds the house up. Imports that break the
contract of setup.cfg (upwards) are drawn in red.
"""

from __future__ import annotations

import ast
from configparser import ConfigParser
from pathlib import Path
import re
import sys

import grimp

PACKAGE = 'lunar_rover_sim'
BOX_W, BOX_H, BEND_W, GAP_X, GAP_Y, MARGIN = 132, 46, 22, 14, 40, 16


def imports() -> dict[str, set[str]]:
    """Return room → rooms that it imports."""
    graph = grimp.build_graph(PACKAGE)
    rooms = sorted(graph.find_children(PACKAGE))
    result: dict[str, set[str]] = {room.rpartition('.')[2]: set() for room in rooms}
    inside = {module: room for room in rooms
              for module in {room} | graph.find_descendants(room)}
    for module, room in inside.items():
        for imported in graph.find_modules_directly_imported_by(module):
            target = inside.get(imported)
            if target is not None and target != room:
                result[room.rpartition('.')[2]].add(target.rpartition('.')[2])
    return result


def contract() -> dict[str, int]:
    """Return room → its place in the layers of setup.cfg, the lowest at 0."""
    settings = ConfigParser()
    settings.read(Path(__file__).parent.parent / 'setup.cfg')
    layers = settings['importlinter:contract:rooms']['layers'].split('\n')
    layers = [layer for layer in layers if layer.strip()]
    return {room: len(layers) - k for k, layer in enumerate(layers)
            for room in re.findall(r'\w+', layer)}


def reachable(arrows: dict[str, set[str]], start: str) -> set[str]:
    """Return all rooms below a room."""
    found: set[str] = set()
    waiting = list(arrows[start])
    while waiting:
        room = waiting.pop()
        if room not in found:
            found.add(room)
            waiting += arrows[room]
    return found


def reduced(arrows: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the arrows without those that a chain of others implies."""
    below = {room: reachable(arrows, room) for room in arrows}
    return {room: {target for target in targets
                   if not any(target in below[other] for other in targets - {target})}
            for room, targets in arrows.items()}


def floors(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Return the rooms floor by floor, the lowest first; a floor is the longest way down."""
    height: dict[str, int] = {}

    def floor(room: str) -> int:
        if room not in height:
            height[room] = 1 + max(map(floor, arrows[room]), default=-1)
        return height[room]

    for room in arrows:
        floor(room)
    return [sorted(room for room in arrows if height[room] == level)
            for level in range(max(height.values()) + 1)]


def lines_of(room: str) -> int:
    """Return the lines of Python (and GLSL) in a room."""
    root = Path(__file__).parent.parent / PACKAGE
    files = [root / f'{room}.py'] if (root / f'{room}.py').is_file() else [
        path for path in (root / room).rglob('*')
        if path.suffix in ('.py', '.glsl', '.vert', '.frag')]
    return sum(len(path.read_text(encoding='utf-8').splitlines()) for path in files)


def with_bends(rows: list[list[str]], arrows: dict[str, set[str]]) \
        -> tuple[list[list[str]], dict[str, set[str]]]:
    """Return rows and arrows with a bend on every floor that an arrow passes.

    A bend is named `room>target@floor`. All arrows of the result lead one floor down.
    """
    level = {room: k for k, row in enumerate(rows) for room in row}
    rows = [list(row) for row in rows]
    steps: dict[str, set[str]] = {room: set() for room in arrows}
    for room, targets in sorted(arrows.items()):
        for target in sorted(targets):
            above = room
            for floor in range(level[room] - 1, level[target], -1):
                bend = f'{room}>{target}@{floor}'
                rows[floor].append(bend)
                steps[above].add(bend)
                steps[bend] = set()
                above = bend
            steps[above].add(target)
    return rows, steps


def ordered(rows: list[list[str]], steps: dict[str, set[str]]) -> list[list[str]]:
    """Return the rows in an order with few crossings: sweeps of barycentres (Sugiyama, 1981)."""
    above: dict[str, set[str]] = {item: set() for row in rows for item in row}
    for item, targets in steps.items():
        for target in targets:
            above[target].add(item)
    for sweep in range(24):
        neighbours, order = (steps, rows) if sweep % 2 == 0 else (above, rows[::-1])
        place: dict[str, float] = {}
        for row in order:
            means = {}
            for k, item in enumerate(row):
                ends = [place[end] for end in neighbours[item] if end in place]
                means[item] = sum(ends) / len(ends) if ends else (k + 0.5) / len(row)
            row.sort(key=means.__getitem__)
            place.update({item: (k + 0.5) / len(row) for k, item in enumerate(row)})
    return rows


def placed(rows: list[list[str]]) -> tuple[dict[str, tuple[float, float]], float]:
    """Return item → centre of its box or bend [px], and the width of the picture."""
    widths = [sum(BEND_W if '>' in item else BOX_W + GAP_X for item in row) for row in rows]
    place: dict[str, tuple[float, float]] = {}
    for level, row in enumerate(rows):
        y = MARGIN + (len(rows) - 1 - level) * (BOX_H + GAP_Y) + BOX_H / 2
        x = MARGIN + (max(widths) - widths[level]) / 2
        for item in row:
            width = BEND_W if '>' in item else BOX_W + GAP_X
            place[item] = (x + width / 2, y)
            x += width
    return place, max(widths) + 2 * MARGIN


def arrow(points: list[tuple[float, float]]) -> str:
    """Return a smooth line down through points, from the foot of a box to the head of another."""
    (x, y), *rest = points
    y += BOX_H / 2
    path = f'M{x:.0f},{y:.0f}'
    for k, (x1, y1) in enumerate(rest):
        top, bottom = y1 - BOX_H / 2, y1 + BOX_H / 2
        bend = (top - y) / 2
        path += f' C{x:.0f},{y + bend:.0f} {x1:.0f},{top - bend:.0f} {x1:.0f},{top:.0f}'
        if k < len(rest) - 1:
            path += f' L{x1:.0f},{bottom:.0f}'
        x, y = x1, bottom
    return (f'<path d="{path}" fill="none" stroke="#6b7280" stroke-width="1.3" '
            'marker-end="url(#tip)"/>')


def svg() -> str:
    """Return the picture."""
    order = contract()
    everything = imports()
    arrows = {room: {target for target in targets if order[target] < order[room]}
              for room, targets in everything.items()}
    drawn = reduced(arrows)
    rows, steps = with_bends(floors(arrows), drawn)
    place, width = placed(ordered(rows, steps))
    height = 2 * MARGIN + len(rows) * BOX_H + (len(rows) - 1) * GAP_Y
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif" font-size="15">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0,0 L8,4 L0,8 z" fill="#6b7280"/></marker>'
        '</defs>',
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>']
    for room, targets in sorted(drawn.items()):
        for target in sorted(targets):
            bends = [place[item] for row in reversed(rows) for item in row
                     if item.startswith(f'{room}>{target}@')]
            parts.append(arrow([place[room], *bends, place[target]]))
    for room, targets in sorted(everything.items()):
        for target in sorted(targets - arrows[room]):
            (x0, y0), (x1, y1) = place[room], place[target]
            parts.append(f'<path d="M{x0:.0f},{y0:.0f} L{x1:.0f},{y1:.0f}" fill="none" '
                         'stroke="#dc2626" stroke-width="2"/>')
    for room in sorted(everything):
        x, y = place[room]
        parts.append(
            f'<rect x="{x - BOX_W / 2:.0f}" y="{y - BOX_H / 2:.0f}" width="{BOX_W}" '
            f'height="{BOX_H}" rx="6" fill="#eef2f7" stroke="#374151"/>'
            f'<text x="{x:.0f}" y="{y - 3:.0f}" text-anchor="middle" fill="#111827">{room}</text>'
            f'<text x="{x:.0f}" y="{y + 15:.0f}" text-anchor="middle" font-size="11" '
            f'fill="#4b5563">{lines_of(room):,} lines</text>')
    return '\n'.join([*parts, '</svg>', ''])


def table() -> str:
    """Return the subjects of the rooms as a table, the lowest first: first lines of docstrings."""
    root = Path(__file__).parent.parent / PACKAGE
    lines = ['| room | subject |', '|---|---|']
    for room, _ in sorted(contract().items(), key=lambda item: item[1]):
        path = root / room / '__init__.py'
        text = (path if path.is_file() else root / f'{room}.py').read_text(encoding='utf-8')
        subject = (ast.get_docstring(ast.parse(text)) or '').partition('\n')[0]
        lines.append(f'| `{room}` | {subject} |')
    return '\n'.join([*lines, ''])


if __name__ == '__main__':
    Path(sys.argv[1]).write_text(svg(), encoding='utf-8')
