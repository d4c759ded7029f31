"""`lunar_rover_sim validate policy`: a policy file against its environment, term by term."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.autonomy.learning.policy_file import Policy, policy_names
from lunar_rover_sim.autonomy.learning.validation import DURATION_S, TOLERANCE, validate_policy
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, print_table, Progress, say


@options.command()
@options.argument('policy', 'ONNX file, or the name of a packaged policy: '
                  + ', '.join(policy_names()), metavar='FILE')
@options.bounded('--duration', 0.1, 600.0, default=DURATION_S, metavar='S', unit='s',
                 help='length of the walk')
@options.seed(1)
@options.as_json
def policy(policy: str, duration: float, seed: int, as_json: bool) -> int:
    """Compare what a policy sees in its environment and in the nodes.

    Walks with it in both, and compares each number that it sees. Exits with 1 where a term
    differs.
    """
    loaded = Policy(policy)
    with Progress('walking twice'):
        checks = validate_policy(loaded, duration, seed)
    failed = [check for check in checks if not check.holds]
    if as_json:
        print_json({'policy': str(loaded.path), 'tolerance': TOLERANCE, 'holds': not failed,
                    'terms': [dataclasses.asdict(check) for check in checks]})
        return int(bool(failed))
    print_table(('term', 'greatest difference', 'span'), 1, (
        (check.name, f'{check.difference:.1e}', f'{check.span:.2f}') for check in checks))
    card = loaded.card
    say(f'{loaded.path}: {card.task} of {card.rover} on {card.ground}, {card.algorithm}: '
        f'{len(checks) - len(failed)} of {len(checks)} terms agree within {TOLERANCE:g}')
    return int(bool(failed))
