"""Curves of training, as mean and range over seeds, of the table `learning_curves.csv`.

    python docs/learning_curves.py docs/measurements/learning_curves.csv FILE.png
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np

# Recipe, ground, gait below, and title of each panel.
PANELS = (('feedback', 'rigid', 'smooth_rigid', 'feedback by CMA-ES, all randomised'),
          ('ppo', 'rigid', 'packaged', 'feedback by PPO, the relief alone random'))


def main() -> None:
    """Draw a panel for each recipe."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('table', type=Path)
    parser.add_argument('picture', type=Path)
    args = parser.parse_args()
    with args.table.open(encoding='utf-8', newline='') as file:
        rows = list(csv.DictReader(file))
    figure = Figure(figsize=(9.0, 3.4), layout='constrained')
    for axis, (*wanted, title) in zip(figure.subplots(1, len(PANELS)), PANELS):
        curves: dict[str, dict[int, float]] = {}
        for row in rows:
            if [row['recipe'], row['ground'], row['gait']] == wanted:
                # An evaluation comes with the first decision of all environments after its time.
                at = round(int(row['decisions']), -3)
                curves.setdefault(row['seed'], {})[at] = float(row['return'])
        shared = sorted(set.intersection(*map(set, curves.values())))
        values = np.array([[curve[at] for at in shared] for curve in curves.values()])
        axis.fill_between(shared, values.min(axis=0), values.max(axis=0), alpha=0.25)
        axis.plot(shared, values.mean(axis=0), lw=2)
        for curve in curves.values():
            axis.plot(list(curve), list(curve.values()), lw=0.7, color='0.4')
        axis.set_title(f'{title}; {len(curves)} seeds', fontsize=9)
        axis.set_xlabel('decisions')
        axis.set_ylabel('return of four episodes')
        axis.grid(alpha=0.3)
    figure.savefig(args.picture, dpi=100)


if __name__ == '__main__':
    main()
