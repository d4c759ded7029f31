"""`lunar_rover_sim validate policy`: a policy file against its environment, term by term."""

from __future__ import annotations

import argparse
import dataclasses

from lunar_rover_sim.autonomy.learning.policy_file import Policy, policy_names
from lunar_rover_sim.autonomy.learning.validation import DURATION_S, TOLERANCE, validate_policy
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, print_table, Progress, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = ('Walk with a policy in its environment and as the nodes do; compare each'
                          ' number that it sees, and onnxruntime with NumPy.')
    parser.add_argument('policy', metavar='FILE',
                        help='ONNX file, or the name of a packaged policy: '
                             + ', '.join(policy_names()))
    options.add_number(parser, '--duration', 0.1, 600.0, default=DURATION_S, metavar='S',
                       unit='s', help='length of the walk')
    options.add_seed(parser, 1)
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Compare; 1 where a term differs."""
    policy = Policy(args.policy)
    with Progress('walking twice'):
        checks = validate_policy(policy, args.duration, args.seed)
    failed = [check for check in checks if not check.holds]
    if args.json:
        print_json({'policy': str(policy.path), 'tolerance': TOLERANCE, 'holds': not failed,
                    'terms': [dataclasses.asdict(check) for check in checks]})
        return int(bool(failed))
    print_table(('', 'term', 'greatest difference', 'span'), 2, (
        (check.kind, check.name, f'{check.difference:.1e}', f'{check.span:.2f}')
        for check in checks))
    card = policy.card
    say(f'{policy.path}: {card.task} of {card.rover} on {card.ground}, {card.algorithm}: '
        f'{len(checks) - len(failed)} of {len(checks)} terms agree within {TOLERANCE:g}')
    return int(bool(failed))
