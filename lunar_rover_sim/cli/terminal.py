"""Output of commands: lines, tables and JSON on stdout, progress of long work on stderr.

Tables are folded to the terminal, or to COLUMNS where it is set, and to 100 columns in a pipe or a
file: nothing is cut off.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import contextlib
import os
import sys
import threading
import time
from typing import Any

from rich import progress as rich_progress
from rich.console import Console
from rich.markdown import Markdown
from rich.table import Table
from rich.text import Text

from lunar_rover_sim.base.compilation import COMPILATION, WORDS
from lunar_rover_sim.base.errors import folded, PIPE_COLUMNS
from lunar_rover_sim.base.files.results import json_text

PIPE_FIRST_S = 3.0      # before the first line of progress in a pipe
PIPE_PERIOD_S = 10.0    # between such lines
_CUT = '…'              # what rich puts in the place of text


def say(text: object = '') -> None:
    """Print text, folded to the terminal."""
    width = console().width
    for line in str(text).split('\n'):
        print(folded(line, width), flush=True)


def console() -> Console:
    """Return a console for stdout, which prints units in brackets, as [m], as they are."""
    of_terminal = Console(markup=False, emoji=False)
    if of_terminal.is_terminal or os.environ.get('COLUMNS'):
        return of_terminal
    return Console(width=PIPE_COLUMNS, markup=False, emoji=False)


def print_table(titles: Sequence[str], left: int, rows: Iterable[Sequence[str | Text]],
                **options: Any) -> None:
    """Print a table whose first `left` columns are for text, the others for numbers.

    Args:
        titles: Titles of the columns.
        left: Number of columns that are aligned to the left.
        rows: A cell for each column.
        **options: Of `rich.table.Table`.
    """
    table = Table(**options)
    for k, title in enumerate(titles):
        table.add_column(title, justify='left' if k < left else 'right', overflow='fold')
    for row in rows:
        table.add_row(*row)
    console().print(table)


def print_markdown(text: str) -> None:
    """Print a report: formatted where its tables fit on a terminal, else as it is written."""
    to = console()
    if to.is_terminal:
        with to.capture() as capture:
            to.print(Markdown(text))
        if _CUT in text or _CUT not in capture.get():
            to.print(Markdown(text))
            return
    print(text, flush=True)


def print_json(value: Any) -> None:
    """Print plain values as JSON; numbers that JSON lacks (NaN, infinity) become null."""
    print(json_text(value), flush=True)


class Pace:
    """How long work will go on, by its steps so far; no answer rather than a wrong one.

    A pause longer than `LONG` times all other steps together is something else than the work, such
    as the first light or a compilation: the pace is taken anew from there on.
    """

    LONG = 2.0
    SHORTEST_S = 2.0    # that a pace is taken from

    def __init__(self) -> None:
        self._begin: tuple[float, float] | None = None      # time [s], work done
        self._last = 0.0, 0.0
        self._longest_s, self._steps = 0.0, 0

    def step(self, now_s: float, done: float) -> None:
        """Note how much is done at a time [s]; what is no more than before is no step."""
        if done <= self._last[1]:
            return
        if self._begin is None:
            self._begin = now_s, done
        else:
            self._steps += 1
            self._longest_s = max(self._longest_s, now_s - self._last[0])
            others_s = now_s - self._begin[0] - self._longest_s
            if self._steps > 1 and self._longest_s > self.LONG * others_s:
                self._begin, self._longest_s, self._steps = (now_s, done), 0.0, 0
        self._last = now_s, done

    def left_s(self, now_s: float, total: float) -> float | None:
        """Return the time [s] that is left at a time [s]; None where the steps do not tell."""
        if self._begin is None or self._steps < 2:
            return None
        taken_s = self._last[0] - self._begin[0]
        if taken_s < self.SHORTEST_S or now_s - self._last[0] > taken_s:
            return None
        pace = (now_s - self._begin[0]) / (self._last[1] - self._begin[1])
        return pace * max(0.0, total - self._last[1])


class Progress:
    """The progress of long work, on stderr: a bar on a terminal, else a line after 3 s,
    and every 10 s.

    A context manager. Calling it with `(done, total)` says how far the work is.

    Args:
        text: What is being done.
        total: How much there is to do; None where nobody knows.
        unit: Of `total`; '%' for shares of 1.
    """

    def __init__(self, text: str, total: float | None = None, unit: str = '') -> None:
        to = Console(stderr=True)
        self._bar: rich_progress.Progress | None = None
        if to.is_terminal:
            # A pipe behind stdout gets what is printed, and the terminal does not.
            self._bar = rich_progress.Progress(
                rich_progress.TextColumn('{task.description}', markup=False),
                rich_progress.BarColumn(bar_width=20), _Told(self), console=to, transient=True,
                redirect_stdout=sys.stdout.isatty())
        self._task: rich_progress.TaskID | None = None
        self._ended = threading.Event()
        self.start(text, total, unit)

    def start(self, text: str, total: float | None = None, unit: str = '') -> None:
        """Begin another part of the work; arguments as for the whole."""
        self._text, self._total, self._unit, self._note = text, total, unit, ''
        self._done, self._begun_s = 0.0, time.monotonic()
        self._pace = Pace()
        if self._bar is not None:
            if self._task is None:
                self._task = self._bar.add_task(text, total=total)
            else:
                self._bar.reset(self._task, description=text, total=total)

    def __call__(self, done: float, total: float | None = None, note: str | None = None) -> None:
        """Say how much is done, of how much, and a note on it; None leaves these as they are."""
        self._done = done
        self._total = self._total if total is None else total
        self._note = self._note if note is None else note
        self._pace.step(time.monotonic(), done)
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, total=self._total)

    def advance(self, count: float = 1, note: str | None = None) -> None:
        """Say that so much more is done."""
        self(self._done + count, note=note)

    def named(self, what: str, done: float | None = None) -> None:
        """Say what is being done within a part, and how much of it is done."""
        self(self._done if done is None else done, note=what)

    def told(self) -> str:
        """Return how far the work is, for how long it has gone on, and how long it will."""
        now_s, parts = time.monotonic(), []
        if self._unit == '%':
            parts.append(f'{100.0 * self._done:.0f} %')
        elif self._total is not None:
            shown = f'{self._done:.0f}' if isinstance(self._total, int) else f'{self._done:.1f}'
            parts.append(f'{shown}/{self._total:g} {self._unit}'.rstrip())
        parts += [self._note] if self._note else []
        parts += [WORDS] if COMPILATION.running else []
        parts.append(_clock(now_s - self._begun_s))
        left_s = None if self._total is None else self._pace.left_s(now_s, self._total)
        if left_s is not None:
            parts.append(f'{_clock(left_s)} left')
        return ', '.join(parts)

    def _tell(self) -> None:
        period_s = PIPE_FIRST_S
        while not self._ended.wait(period_s):
            period_s = PIPE_PERIOD_S
            with contextlib.suppress(OSError, ValueError):      # nobody reads any more
                print(folded(f'{self._text}: {self.told()}'), file=sys.stderr, flush=True)

    def __enter__(self) -> Progress:
        if self._bar is not None:
            self._bar.start()
        else:
            threading.Thread(target=self._tell, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._bar is not None:
            self._bar.stop()


class _Told(rich_progress.ProgressColumn):
    """What a progress tells, as a column."""

    def __init__(self, told: Progress) -> None:
        super().__init__()
        self._told = told

    def render(self, task: rich_progress.Task) -> Text:
        return Text(self._told.told(), no_wrap=True, overflow='ellipsis')


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f'{hours}:{minutes:02d}:{rest:02d}' if hours else f'{minutes}:{rest:02d}'
