"""`lunar_rover_sim completion`: the completion of commands and options in a shell."""

from __future__ import annotations

import argparse

import shtab


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Print the completion script of a shell. For bash: lunar_rover_sim completion bash > '
        '~/.local/share/bash-completion/completions/lunar_rover_sim. For zsh: write it to a file '
        '_lunar_rover_sim in a folder of $fpath.')
    parser.add_argument('shell', choices=('bash', 'zsh'))


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from lunar_rover_sim.cli.main import parser  # it imports this module

    print(shtab.complete(parser(), args.shell))
    return 0
