"""The command `lunar_rover_sim`: a table of commands, of which only the chosen one is imported."""

from __future__ import annotations

from collections.abc import Sequence
import importlib
import os
import sys
from typing import Any, NamedTuple

import click

from lunar_rover_sim import __version__
from lunar_rover_sim.base.errors import (ConfigError, did_you_mean, folded, LunarRoverSimError,
                                         one_line, PIPE_COLUMNS)
from lunar_rover_sim.base.process import check_open_files

NAME = 'lunar_rover_sim'
_COMPLETE = '_LUNAR_ROVER_SIM_COMPLETE'     # set by the script that `completion` prints


class Entry(NamedTuple):
    """Module and name of a command below this package, and one line of help."""

    where: str
    help: str


GROUPS = {'bag': 'look into, check, hash, recover and export recordings',
          'benchmark': 'simulate, run estimators, and judge them: tables with intervals',
          'calibrate': 'measure a map that a node uses',
          'dataset': 'look at, verify and describe a data set that `campaign` made',
          'evaluate': 'judge an estimated trajectory, a drive or its maps, or compare images',
          'rover': 'export the rover as an OpenUSD stage or URDF',
          'slam': 'run SLAM programs on bags; their settings files, sealed benchmarks, tables',
          'validate': 'compare a part of the simulator with theory or published results',
          'world': 'build, inspect, picture and export terrains; sun and Earth over them'}
# What the name of a group means without one of its members.
DEFAULTS = {'benchmark': 'drives', 'evaluate': 'trajectory'}

COMMANDS = {
    'bag check': Entry('bag:check', 'whether a bag can be trusted; exits with 1 if not'),
    'bag export': Entry('bag:export', 'write the sequence for SLAM programs or trainers, or the '
                        'drive as an OpenUSD stage'),
    'bag hash': Entry('bag:hash_', 'a hash of what the bag says, whatever its storage'),
    'bag info': Entry('bag:info', 'topics, types, counts and times'),
    'bag preview': Entry('bag:preview', 'PNG pictures: cameras, their truth, LiDAR, heading, '
                         'power, trajectory, attitude, IMU'),
    'bag recover': Entry('bag:recover', 'make a bag readable whose recording was cut off'),
    'bag video': Entry('bag:video', 'a film of the drive: the rover from outside, its left '
                       'image in a corner'),
    'bag view': Entry('bag:view', 'play the bag in a browser, without ROS, until Ctrl-C'),
    'benchmark drives': Entry('benchmark:drives', 'simulate, run SLAM, and judge: a table over '
                              'scenarios and sensors'),
    'benchmark traverse': Entry('benchmark:traverse', 'far drives over sites: wheels, odometries '
                                'and the graph on a map from orbit'),
    'calibrate gait': Entry('calibrate:gait',
                            'measure the map from velocity to gait on flat ground'),
    'campaign': Entry('campaign:campaign', 'record a data set of randomised episodes'),
    'completion': Entry('main:completion', 'print a script that completes commands in a shell'),
    'dataset card': Entry('campaign:card', 'write the data card anew: README.md, card.json, '
                          'episodes.csv, croissant.json'),
    'dataset shards': Entry('campaign:shards', 'WebDataset shards of all drives, split by world'),
    'dataset status': Entry('campaign:status', 'how many episodes are finished, failed and '
                            'missing'),
    'dataset verify': Entry('campaign:verify', 'compare the episodes with the plan, and every '
                            'file with the manifests; exits with 1 if any was changed, deleted, '
                            'added or renamed'),
    'demo': Entry('demo:demo', 'record a first drive, check it and draw pictures of it'),
    'evaluate drive': Entry('evaluate:drive', 'how a rover drove: incidents a kilometre, '
                            'unknown ground, stops'),
    'evaluate images': Entry('evaluate:images',
                             'compare the images of two renderers, cameras or worlds'),
    'evaluate map': Entry('evaluate:map_', 'judge the maps of a recorded drive against its '
                          'world'),
    'evaluate trajectory': Entry('evaluate:trajectory', 'judge an estimated trajectory against '
                                 'the truth; `evaluate` alone does it'),
    'parameters': Entry('parameters:parameters', 'list all parameters, by node and section'),
    'render': Entry('render:render', 'draw single stereo frames with all truth layers'),
    'rover export': Entry('rover:export', 'an OpenUSD stage (articulation, drives, cameras) or '
                          'URDF'),
    'run': Entry('run:run', 'simulate and record a scenario'),
    'slam run': Entry('slam:run', 'run a SLAM program on a bag and evaluate its result'),
    'slam seal': Entry('slam:seal', 'seal a benchmark, so that others make, verify and score the '
                       'same drives'),
    'slam settings': Entry('slam:settings', 'write the settings file of ORB-SLAM3 for a bag or a '
                           'scenario'),
    'slam table': Entry('slam:table', 'one table of the parts of a benchmark that ran on several '
                        'machines'),
    'validate imu': Entry('validate:imu', 'Allan deviation of the IMU at rest against its '
                          'configured noise'),
    'validate learning': Entry('validate_learning:learning', 'policies against the packaged gait '
                               'on hidden seeds'),
    'validate locomotion': Entry('validate:locomotion', 'pitch of the walk against a '
                                 'velocity interface; commands followed'),
    'validate navigation': Entry('validate:navigation', 'goals by what the rover sees, '
                                 'against the true map and a blind route'),
    'validate odometry': Entry('validate:odometry', 'wheel odometry and its covariance '
                               'against the true pose'),
    'validate policy': Entry('validate_policy:policy', 'a policy file against its environment, '
                             'term by term'),
    'validate stereo': Entry('validate:stereo', 'semi-global matching against true depth'),
    'validate terramechanics': Entry('validate:terramechanics',
                                     'walks on soft ground, slopes and against a pull'),
    'view': Entry('view:view', "physics alone in MuJoCo's viewer"),
    'world build': Entry('world:build', 'make a world folder from a scenario, an elevation model '
                         'or a mesh'),
    'world export': Entry('world_export:export', 'a mesh file (GLB, OBJ, PLY), a map (GeoTIFF, '
                          'GeoJSON), all that an orbiter knows, or an OpenUSD stage; the tracks '
                          'of a recording in a mesh file, or as heights (NPZ)'),
    'world info': Entry('world:info', 'what a world folder holds; checks its hash'),
    'world preview': Entry('world:preview', 'maps, statistics and camera views as a PNG'),
    'world sun': Entry('world:sun', 'sun, Earth and light at a place on the Moon over time'),
}


# Commands of earlier releases, and what answers their questions.
GONE = {'validate traverse': 'see validate navigation, validate locomotion, benchmark traverse'}


class Commands(click.Group):
    """The commands whose names begin with those of a group; all of them with none."""

    def __init__(self, group: str = '', **options: Any) -> None:
        super().__init__(group or NAME, no_args_is_help=False, subcommand_metavar='COMMAND ...',
                         **options)
        self.begin = f'{group} ' if group else ''

    def list_commands(self, _context: click.Context) -> list[str]:
        """Return the first words of the names."""
        return sorted({name.removeprefix(self.begin).split()[0] for name in COMMANDS
                       if name.startswith(self.begin)})

    def get_command(self, _context: click.Context, word: str) -> click.Command | None:
        """Return a group, or what help and completion say of a command without its import."""
        name = self.begin + word
        if name in GROUPS:
            return Commands(name, help=GROUPS[name], short_help=GROUPS[name])
        return click.Command(word, short_help=COMMANDS[name].help) if name in COMMANDS else None

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Show the help without arguments; put in the default member of a group."""
        if not args and not ctx.resilient_parsing:
            print(ctx.get_help(), file=sys.stderr)
            ctx.exit(2)
        default = DEFAULTS.get(self.begin.strip())
        if default and args and args[0] not in (*self.list_commands(ctx), '-h', '--help'):
            args = [default, *args]
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[
            str | None, click.Command | None, list[str]]:
        """Import the command that the first argument names.

        Raises:
            ConfigError: If there is none; it offers what replaces it, or the nearest ones.
        """
        found = self.get_command(ctx, args[0])
        name = self.begin + args[0]
        if found is None and not ctx.resilient_parsing:
            known = [self.begin + word for word in self.list_commands(ctx)]
            raise ConfigError(f'{name}: no such command; '
                              + (GONE.get(name) or did_you_mean(name, known)
                                 or f'see {ctx.command_path} --help'))
        return args[0], load(name) if name in COMMANDS else found, args[1:]


def load(name: str) -> click.Command:
    """Import a command."""
    module, _, attribute = COMMANDS[name].where.partition(':')
    found: click.Command = getattr(importlib.import_module(f'lunar_rover_sim.cli.{module}'),
                                   attribute)
    return found


def configure_logging(verbose: bool) -> None:
    """Log to stderr: the warnings of this package, or with `verbose` all, also of libraries."""
    import logging  # not for help, which is quick
    handler = logging.StreamHandler()
    if not verbose:
        handler.addFilter(logging.Filter('lunar_rover_sim'))
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, handlers=[handler],
                        format='%(levelname)s %(name)s: %(message)s')
    # An error in a callback of a library, such as that of rasterio for texts of GDAL that are not
    # UTF-8: Python would print its traceback.
    sys.unraisablehook = lambda failed: logging.getLogger('lunar_rover_sim.cli').info(
        '%s', failed.err_msg or 'in a callback', exc_info=failed.exc_value)


def root() -> Commands:
    """Return the whole command line."""
    verbose = click.Option(['-v', '--verbose'], is_flag=True, help='log what is going on')
    return click.version_option(__version__, message='%(version)s')(Commands(
        help='A spoke-leg micro rover on the Moon: walk, stereo images, rosbag2.',
        params=[verbose], callback=configure_logging, context_settings={
            'help_option_names': ['-h', '--help'], 'max_content_width': 100,
            'show_default': True}))


@click.command()
@click.argument('shell', type=click.Choice(('bash', 'zsh')))
def completion(shell: str) -> None:
    """Print the completion script of a shell.

    For bash to ~/.local/share/bash-completion/completions/lunar_rover_sim, for zsh to
    _lunar_rover_sim in a folder of $fpath.
    """
    from click.shell_completion import BashComplete, ZshComplete
    kind = {'bash': BashComplete, 'zsh': ZshComplete}[shell]
    print(kind(root(), {}, NAME, _COMPLETE).source())


def execute(argv: Sequence[str]) -> int:
    """Run one command; return its exit status. What goes wrong is raised; `main` prints it."""
    try:
        with root().make_context(NAME, list(argv)) as context:
            return context.command.invoke(context) or 0
    except click.exceptions.Exit as end:    # after --help or --version
        return end.exit_code


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns:
        The exit status: 0, 1 after an error, 2 for arguments that no command takes, 130 after
        Ctrl-C.
    """
    try:
        check_open_files()
        if instruction := os.environ.get(_COMPLETE):
            from click.shell_completion import shell_complete  # only here it is needed
            return shell_complete(root(), {}, NAME, _COMPLETE, instruction)
        return execute(sys.argv[1:] if argv is None else argv)
    except LunarRoverSimError as error:
        _complain(str(error))
        return 1
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else NAME
        text = one_line(error.format_message())
        _complain(f'{text}{"" if text[-1] in ".?" else "."} See {where} --help')
        return error.exit_code
    except KeyboardInterrupt:
        return 130
    except RuntimeError as error:
        # Ctrl-C while a class is made: before Python 3.12 it is the cause of what is raised.
        if isinstance(error.__cause__, KeyboardInterrupt):
            return 130
        raise
    except BrokenPipeError:
        # The reader of our output (head, less) has seen enough.
        sys.stderr.close()
        return 0
    except (OSError, MemoryError) as error:
        # A file or a resource of the machine, whichever part of a command needed it.
        import logging
        logging.getLogger('lunar_rover_sim.cli').info('where it was needed', exc_info=True)
        _complain(_in_words(error))
        return 1


def _complain(text: str) -> None:
    """Print an error, folded to the terminal, or to 100 columns in a pipe or a file."""
    columns = (os.get_terminal_size(sys.stderr.fileno()).columns if sys.stderr.isatty()
               else PIPE_COLUMNS)
    print(folded(f'{NAME}: {text}', columns), file=sys.stderr)


def _in_words(error: OSError | MemoryError) -> str:
    if isinstance(error, MemoryError):
        return 'the memory of this machine is not enough'
    reason = error.strerror or one_line(error)
    return f'{error.filename}: {reason}' if error.filename else reason


if __name__ == '__main__':
    raise SystemExit(main())
