"""`lunar_rover_sim completion`: commands, options, scenarios and parameters in a shell."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import shtab

from lunar_rover_sim.base.files.paths import packaged_names

_FUNCTIONS = {
    'bash': '_lunar_rover_sim_{kind}() {{\n'
            '  compgen -W "{words}" -- "$1"; {files}\n'
            '}}\n',
    'zsh': '_lunar_rover_sim_{kind}() {{\n'
           '  local -a words=({words})\n'
           '  compadd {suffix}-a words; {files}\n'
           '}}\n'}
_FILES = {'bash': 'compgen -f -- "$1"', 'zsh': '_files'}
_SCENARIO, _PARAMETER, _SECTION = 'scenario', 'parameter', 'section'
# Names of arguments → what completes them.
_KINDS = {'scenario': _SCENARIO, 'scenarios': _SCENARIO, 'overrides': _PARAMETER,
          'section': _SECTION}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Print the completion script of a shell. For bash: lunar_rover_sim completion bash > '
        '~/.local/share/bash-completion/completions/lunar_rover_sim. For zsh: write it to a file '
        '_lunar_rover_sim in a folder of $fpath.')
    parser.add_argument('shell', choices=('bash', 'zsh'))


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    # Both take time to import, or import this module.
    from lunar_rover_sim.cli.main import parser
    from lunar_rover_sim.cli.parameters import parameter_names

    names = parameter_names()
    parts = {'.'.join(name.split('.')[:count]) for name in names
             for count in range(1, name.count('.') + 1)}
    words = {_SCENARIO: packaged_names('scenario'), _PARAMETER: [f'{name}=' for name in names],
             _SECTION: sorted(parts)}
    preamble = ''.join(_FUNCTIONS[args.shell].format(
        kind=kind, words=' '.join(of), suffix="-S '' " if kind == _PARAMETER else '',
        files=_FILES[args.shell] if kind == _SCENARIO else ':') for kind, of in words.items())
    root = parser()
    for action in _actions(root):
        if kind := _KINDS.get(action.dest):
            action.complete = dict.fromkeys(    # type: ignore[attr-defined]
                _FUNCTIONS, f'_lunar_rover_sim_{kind}')
    print(shtab.complete(root, args.shell, preamble=preamble))
    return 0


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the arguments of a parser and of the commands below it."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for child in action.choices.values():
                yield from _actions(child)
        else:
            yield action
