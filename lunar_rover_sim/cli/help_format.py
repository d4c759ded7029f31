"""Layout of help; apart from the other options, since the help of the whole imports no library."""

from __future__ import annotations

import argparse
import shutil

PIPE_COLUMNS = 100      # of help, tables and parameters where there is no terminal


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Help as the parameters are shown: a line with the option, then its meaning."""

    def __init__(self, prog: str) -> None:
        columns = shutil.get_terminal_size((PIPE_COLUMNS, 24)).columns
        super().__init__(prog, max_help_position=6, width=min(columns, PIPE_COLUMNS) - 2)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Fold paragraphs; lists of one item a line stay."""
        fold = argparse.HelpFormatter._fill_text
        return '\n'.join(line if line.startswith(' ') else fold(self, line, width, indent)
                         for line in text.splitlines())
