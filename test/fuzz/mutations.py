"""Mutations of files: bytes, text, YAML, and containers whose checksums are put right again.

Each takes a `random.Random` and the content, and returns what takes its place.
"""

import copy
import io
import json
import random
import re
import struct
from typing import Any, Callable
import zipfile

import yaml

Mutate = Callable[[random.Random, bytes], bytes]

# What has broken parsers before: sizes, types, encodings, escapes, tags, bombs.
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, -2**63, 10**400, 0.0, -0.0, 1e-300, 1e300,
    -1e308, 5e-324, float('nan'), float('inf'), float('-inf'), '', 'x', 'many', '\x00', 'a\nb',
    '\U0001f311', 'x' * 5000, '../../etc', '/dev/zero', '/', '~', '[]', [], {}, [[]], [None],
    [float('nan')], ['a'] * 500, {'a': {'b': {'c': 1}}}, [1, 2, 3], [0, 0], '1_0', '0x10', '1e3')
KEYS: tuple[Any, ...] = (
    '', '.', '..', 'a.b.c', 'x' * 3000, '\n', '\x07', '__class__', 'ros__parameters', '../x', 7,
    None, True, 1.5, 'a=b')
SNIPPETS = (
    '!!python/object/apply:os.system ["true"]', '!!binary aGk=', '!x y', '!!set {a}',
    '&a [*a]', '*a', '<<: {a: 1}', '? [a]\n: b', '{' * 60, '[' * 5000, '- ' * 500,
    '%YAML 9.9\n---\n', '---\n---\n', '\x00', '\ufeff', '\t', '"', "'", ': ', '#',
    '0x' + 'f' * 400, '1' * 5000, '1:2:3', '2001-99-99', '1_0', '.inf', '.nan', '|\n x', '\\',
    '\u2028', '\u0661', 'a: &a [x,x]\nb: &b [*a,*a]\nc: [*b,*b]\n', '-', ',' * 50, '<' * 50)
NUMBERS = ('nan', 'inf', '-inf', '-1', '0', '1e300', '-1e300', '1e-300', '1_0', '0x1f', '1' * 400,
           '9' * 19, '-9223372036854775809', '18446744073709551616', '', 'x', '1.5', '1,5', '٣')
_NUMBER = re.compile(r'[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?')
_WORDS = (*(struct.pack('<I', n) for n in (0, 1, 0x7fffffff, 0x80000000, 0xffffffff)),
          *(struct.pack('>I', n) for n in (1, 0x7fffffff, 0x80000000)),
          *(struct.pack('<Q', n) for n in (1 << 31, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)),
          *(struct.pack(f, x) for f in ('<f', '<d') for x in (float('nan'), float('inf'), -1e30)),
          b'\x00', b'\xff', b'\x7f\xff', b'\x80\x00')
MAGICS = (b'\x89MCAP0\r\n', b'SQLite format 3\x00', b'II*\x00', b'MM\x00*', b'II+\x00', b'glTF',
          b'ply\n', b'solid x\n', b'OFF\n', b'\x93NUMPY\x01\x00', b'PK\x03\x04', b'\x1f\x8b',
          b'\xff\xfe', b'\xef\xbb\xbf', b'%PDF-1.4', b'\x28\xb5\x2f\xfd')


def any_bytes(rng: random.Random, content: bytes) -> bytes:
    """Flip, overwrite, cut, repeat, swap or drop bytes anywhere, more often near the ends."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        content = rng.choice(_BYTE_MUTATIONS)(rng, content)
    return content


def none(rng: random.Random, content: bytes) -> bytes:
    """Leave the file to its reader, which changes what it knows."""
    return content


def cut(rng: random.Random, content: bytes) -> bytes:
    """Cut off the end: up to some kB of it, or anything but the beginning."""
    lost = rng.choice((rng.randrange(1, 10), rng.randrange(1, 6000),
                       rng.randrange(1, len(content))))
    return content[:-min(lost, len(content) - 1)]


def any_text(rng: random.Random, content: bytes) -> bytes:
    """Mutate text: numbers, lines, snippets of other syntax, encodings; sometimes its bytes."""
    if rng.random() < 0.2:
        return any_bytes(rng, content)
    text = content.decode('utf-8')
    for _ in range(rng.choice((1, 1, 2, 3))):
        text = rng.choice(_TEXT_MUTATIONS)(rng, text)
    encoding = rng.choice(('utf-8',) * 12 + ('utf-16', 'latin-1', 'utf-8-sig', 'cp037'))
    return text.encode(encoding, 'surrogatepass' if encoding == 'utf-8' else 'replace')


def any_yaml(rng: random.Random, content: bytes) -> bytes:
    """Mutate values and keys of a document, or its text; sometimes give a key twice."""
    if rng.random() < 0.4:
        return any_text(rng, content)
    document = mutated(rng, yaml.safe_load(content))
    return str(yaml.safe_dump(document, allow_unicode=rng.random() < 0.5)).encode(
        'utf-8', 'surrogatepass')


def any_json(rng: random.Random, content: bytes) -> bytes:
    """Mutate values and keys of a document, or its text."""
    if rng.random() < 0.4:
        return any_text(rng, content)
    document = _text_keys(mutated(rng, json.loads(content)))
    return json.dumps(document, skipkeys=True, ensure_ascii=rng.random() < 0.5).encode(
        'utf-8', 'surrogatepass')


def any_npy(rng: random.Random, content: bytes) -> bytes:
    """Mutate the header of a .npy file, its length being right, or its bytes."""
    if rng.random() < 0.5:
        return any_bytes(rng, content)
    length, = struct.unpack_from('<H', content, 8)
    header = rng.choice(_TEXT_MUTATIONS)(rng, content[10:10 + length].decode('latin-1'))
    header = re.sub("'[<|>=][a-z][0-9]+'", lambda m: rng.choice(
        (m[0], m[0], "'|O'", "'<f8'", "'<i2'", "'<c16'", "'<U4'", "'>f4'", "[('a', '<f4')]")),
        header)
    new = header.encode('latin-1', 'replace')[:65535]
    return content[:8] + struct.pack('<H', len(new)) + new + content[10 + length:]


def any_npz(rng: random.Random, content: bytes) -> bytes:
    """Mutate a member of a .npz file, its checksum being right; or drop, rename, or bytes."""
    if rng.random() < 0.25:
        return any_bytes(rng, content)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(sorted(members))
    action = rng.randrange(6)
    if action == 0:
        del members[name]
    elif action == 1:
        members[rng.choice(('../x.npy', '.npy', 'x', name.upper()))] = members.pop(name)
    elif action == 2:
        members[name] = members[rng.choice(sorted(members))]
    else:
        members[name] = any_npy(rng, members[name])
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, 'w', rng.choice((zipfile.ZIP_STORED,
                                                  zipfile.ZIP_DEFLATED))) as archive:
        for key, value in members.items():
            archive.writestr(key, value)
    return buffer.getvalue()


def any_glb(rng: random.Random, content: bytes) -> bytes:
    """Mutate the JSON chunk of a .glb file, its lengths being right; or its bytes."""
    if rng.random() < 0.4:
        return any_bytes(rng, content)
    length, = struct.unpack_from('<I', content, 12)
    rest = content[20 + length:]
    text = any_json(rng, content[20:20 + length])
    text += b' ' * (-len(text) % 4)
    return (b'glTF' + struct.pack('<III', 2, 20 + len(text) + len(rest), len(text)) + b'JSON'
            + text + rest)


def mutated(rng: random.Random, document: Any) -> Any:
    """Replace, add, drop or rename a few entries anywhere in a document."""
    document = copy.deepcopy(document)
    for _ in range(rng.randint(1, 4)):
        node = document
        for _ in range(rng.randint(0, 6)):
            below = [child for child in (node.values() if isinstance(node, dict) else node)
                     if isinstance(child, (dict, list)) and child]
            if not below:
                break
            node = rng.choice(below)
        if isinstance(node, (dict, list)) and node:
            _mutate_entry(rng, node)
    return document


def _mutate_entry(rng: random.Random, node: Any) -> None:
    value = copy.deepcopy(rng.choice(VALUES))
    key = rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
    action = rng.randrange(6)
    if action == 0 and isinstance(node, dict):
        node[rng.choice(KEYS)] = value
    elif action == 1 and isinstance(node, dict):
        node[rng.choice(KEYS)] = node.pop(key)
    elif action == 2:
        del node[key]
    elif action == 3 and isinstance(node, list):
        node.append(value)
    else:
        old = node[key]
        if isinstance(old, (int, float)) and not isinstance(old, bool) and rng.random() < 0.3:
            value = rng.choice((-old, old * 1000, old + 1, str(old), [old], old / 1000))
        node[key] = value


def _text_keys(value: Any) -> Any:
    """JSON has text keys only."""
    if isinstance(value, dict):
        return {str(k): _text_keys(v) for k, v in value.items()}
    return [_text_keys(v) for v in value] if isinstance(value, list) else value


def _place(rng: random.Random, content: bytes) -> int:
    """Return a place in the content: in its head, its tail, or anywhere."""
    size = max(len(content), 1)
    return min(rng.choice((rng.randrange(64), rng.randrange(1024), size - 1 - rng.randrange(512),
                           rng.randrange(size), rng.randrange(size))) % size, size - 1)


def _flip(rng: random.Random, content: bytes) -> bytes:
    if not content:
        return content
    at = _place(rng, content)
    return content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1:]


def _overwrite(rng: random.Random, content: bytes) -> bytes:
    at, word = _place(rng, content), rng.choice(_WORDS)
    return content[:at] + word + content[at + len(word):]


def _truncate(rng: random.Random, content: bytes) -> bytes:
    return content[:rng.choice((0, 1, 4, 84, 0, len(content) - 1, _place(rng, content)))]


def _block(rng: random.Random, content: bytes) -> bytes:
    """Drop, repeat, blank or move a block."""
    a = _place(rng, content)
    b = min(len(content), a + rng.choice((1, 4, 16, 256, 4096)))
    to = _place(rng, content)
    return rng.choice((content[:a] + content[b:], content[:b] + content[a:],
                       content[:a] + bytes(b - a) + content[b:],
                       content[:to] + content[a:b] + content[to + b - a:]))


def _append(rng: random.Random, content: bytes) -> bytes:
    return content + rng.choice((b'\x00' * 100, rng.randbytes(100), content[:2000], b'\n'))


def _magic(rng: random.Random, content: bytes) -> bytes:
    magic = rng.choice(MAGICS)
    return magic + content[len(magic):] if rng.random() < 0.7 else magic


_BYTE_MUTATIONS: tuple[Mutate, ...] = (_flip, _flip, _flip, _overwrite, _overwrite, _overwrite,
                                       _truncate, _block, _block, _append, _magic)


def _number(rng: random.Random, text: str) -> str:
    found = list(_NUMBER.finditer(text))
    if not found:
        return text
    one = rng.choice(found)
    return text[:one.start()] + rng.choice(NUMBERS) + text[one.end():]


def _line(rng: random.Random, text: str) -> str:
    """Drop, repeat, move or cut a line; a key is given twice by it."""
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    action = rng.randrange(4)
    if action == 0:
        del lines[a]
    elif action == 1:
        lines.insert(a, lines[a])
    elif action == 2:
        lines[a], lines[b] = lines[b], lines[a]
    else:
        lines[a] = lines[a][:rng.randrange(len(lines[a]))] + '\n'
    return ''.join(lines)


def _insert(rng: random.Random, text: str) -> str:
    a = rng.randint(0, len(text))
    b = min(len(text), a + rng.choice((0, 0, 1, 10, 60)))
    piece = rng.choice((*SNIPPETS, text[a:b] * 3))
    return text[:a] + piece + text[b:]


def _cut(rng: random.Random, text: str) -> str:
    return text[:rng.choice((0, 1, rng.randint(0, len(text))))]


_TEXT_MUTATIONS: tuple[Callable[[random.Random, str], str], ...] = (
    _number, _number, _number, _line, _line, _insert, _insert, _cut)
