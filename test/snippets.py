"""Code blocks of the README and of the pages in docs/, and files of Python as modules."""

from collections.abc import Iterator
import dataclasses
import importlib.util
from pathlib import Path
import re
import shlex
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]
_FENCE = re.compile(r'^( *)```(\w*)\n(.*?)^\1```$', re.DOTALL | re.MULTILINE)


@dataclasses.dataclass(frozen=True)
class Snippet:
    """One code block: where it stands, its language, its text."""

    page: Path
    line: int
    language: str
    text: str

    @property
    def name(self) -> str:
        """Where it is, for the name of a test."""
        return f'{self.page.relative_to(ROOT)}:{self.line}'


def pages() -> list[Path]:
    """Return README, CONTRIBUTING and all pages of the documentation."""
    docs = [path for path in sorted((ROOT / 'docs').rglob('*.md'))
            if not path.relative_to(ROOT / 'docs').parts[0].startswith('_')]
    return [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *docs]


def snippets(language: str) -> Iterator[Snippet]:
    """Yield the code blocks of one language, page by page."""
    for page in pages():
        text = page.read_text(encoding='utf-8')
        for match in _FENCE.finditer(text):
            if match[2] == language:
                indent = match[1]
                body = re.sub(f'^{indent}', '', match[3], flags=re.MULTILINE)
                yield Snippet(page, text.count('\n', 0, match.start()) + 1, language, body)


def commands(snippet: Snippet) -> Iterator[list[str]]:
    """Yield the command lines of a shell block as words, without comments and environment."""
    for line in re.sub(r'\\\n', ' ', snippet.text).splitlines():
        words = shlex.split(line, comments=True)
        while words and re.fullmatch(r'[A-Z_]+=\S*', words[0]):
            words = words[1:]
        if words and words[-1] == '&':
            words = words[:-1]
        if words:
            yield words


def module_of(path: Path) -> ModuleType:
    """Return a file as a module, which is executed anew."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
