"""`lunar_rover_sim evaluate drive`: what happened on a recorded drive."""

from __future__ import annotations

from pathlib import Path

from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, print_table, say
from lunar_rover_sim.judge.evaluation.drive_evaluation import evaluate_drive


@options.command()
@options.bag('recording with true odometry')
@options.world('of the drive, where it is not beside the bag or in the cache', 'FOLDER')
@options.as_json
def drive(bag: Path, world: Path | None, as_json: bool) -> int:
    """Judge how a rover drove: incidents a kilometre, unknown ground, stops.

    Incidents are by kind: tilts beyond 45 deg, roll-overs, contacts of the body with rocks that
    rise by more than its clearance, and other contacts of its lower side.
    """
    result = evaluate_drive(bag, world)
    if as_json:
        print_json(result.to_mapping())
        return 0
    print_table(('incident', 'times', 'a kilometre'), 1,
                ((kind, str(count), f'{result.per_km(kind):.1f}')
                 for kind, count in result.incidents.items()))
    unknown = '' if result.unknown_m != result.unknown_m else \
        f', {result.unknown_m:.2f} m of it over ground that its map did not know'
    say(f'{result.distance_m:.1f} m in {result.duration_s:.0f} s{unknown}')
    if result.seen_m < 0.99 * result.distance_m:
        say(f'note: contacts are known of {result.seen_m:.1f} m, where the world is found')
    if result.end:
        stops = ', '.join(f'{count} x {kind}' for kind, count in result.stops.items())
        plans = f'; plans over the map from orbit: {result.plans}' if result.plans else ''
        say(f'stops: {stops}; stood for {result.standing_s:.0f} s{plans}')
        say(f'end: {result.end}')
    return 0
