"""A small network that finds rocks, trained from scratch on the CPU, judged on unseen worlds.

    python docs/rock_segmentation.py SHARDS [--epochs 30] [-o FOLDER]

SHARDS holds train-*.tar and test-*.tar with left.png, labels.npy and json, as those of
`docs/rock_pictures.py` and `lunar_rover_sim dataset shards`. It needs PyTorch, NumPy and OpenCV,
and nothing of the package. Printed for each scenario: the IoU of rock pixels, its 95 % interval by
a bootstrap that draws worlds and then pictures in them, precision and recall. FOLDER gets these
with the counts of pixels behind them (scores.json), the network, and pictures of what it found.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import time

import cv2
import numpy as np
from rock_masks import confusion, IGNORED, iou, load, scores_of, shown
import torch
from torch import nn

CUT = 128, 192      # rows and columns that a step of training takes of a picture


class Net(nn.Module):
    """A U-Net of three levels, at half the resolution: 2 x 2 pixels are channels."""

    def __init__(self, width=12):
        """width: channels of the first level."""
        super().__init__()

        def block(inputs, outputs):
            layers = []
            for k in range(2):
                layers += [nn.Conv2d(inputs if k == 0 else outputs, outputs, 3, padding=1,
                                     bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)]
            return nn.Sequential(*layers)

        self.fine, self.middle = block(8, width), block(width, 2 * width)
        self.coarse = nn.Sequential(block(2 * width, 4 * width), block(4 * width, 4 * width))
        self.middle_up, self.fine_up = block(6 * width, 2 * width), block(3 * width, width)
        self.last = nn.Conv2d(width, 4, 1)

    def forward(self, picture):
        """Return (n, h, w) scores of pictures (n, h, w) from 0 to 1, h and w multiples of 8."""
        # Brightness on two scales: rocks before the lamp of a dark crater are dark themselves.
        both = torch.stack([picture, torch.sqrt(picture)], dim=1) - 0.3
        fine = self.fine(nn.functional.pixel_unshuffle(both, 2))
        middle = self.middle(nn.functional.max_pool2d(fine, 2))
        coarse = self.coarse(nn.functional.max_pool2d(middle, 2))

        def up(x):
            return nn.functional.interpolate(x, scale_factor=2.0, mode='nearest')

        middle = self.middle_up(torch.cat([up(coarse), middle], dim=1))
        fine = self.fine_up(torch.cat([up(middle), fine], dim=1))
        return nn.functional.pixel_shuffle(self.last(fine), 2)[:, 0]


def loss_of(scores, targets):
    """Return cross-entropy, plus 1 less the overlap (Dice), over what is not ignored."""
    known = (targets != IGNORED).float()
    rock = (targets == 1).float()
    entropy = nn.functional.binary_cross_entropy_with_logits(scores, rock, known)
    chance = torch.sigmoid(scores) * known
    overlap = (2.0 * (chance * rock).sum() + 1.0) / (chance.sum() + rock.sum() + 1.0)
    return entropy + 1.0 - overlap


def train(pictures, targets, epochs, batch=8):
    """Return a network; pictures are cut out, mirrored, and made brighter or darker, by chance."""
    rng = np.random.default_rng(1)
    torch.manual_seed(1)
    net = Net()
    steps = epochs * -(-len(pictures) // batch)
    optimiser = torch.optim.AdamW(net.parameters(), 3e-3, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 6e-3, total_steps=steps)
    for epoch in range(epochs):
        total = 0.0
        for rows in np.array_split(rng.permutation(len(pictures)), steps // epochs):
            part = tuple(slice(start, start + size) for start, size in zip(
                rng.integers(0, np.array(pictures.shape[1:]) - CUT + 1), CUT))
            picture = torch.from_numpy(pictures[(rows, *part)]).float() / 255.0
            gain = torch.from_numpy(rng.uniform(0.6, 1.4, (len(rows), 1, 1))).float()
            picture = (picture * gain).clamp(max=1.0)
            target = torch.from_numpy(targets[(rows, *part)])
            if rng.random() < 0.5:
                picture, target = picture.flip(2), target.flip(2)
            loss = loss_of(net(picture), target)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += float(loss.detach()) * len(rows)
        print(f'epoch {epoch + 1}: loss {total / len(pictures):.3f}, '
              f'{time.process_time():.0f} s of processor', flush=True)
    return net.eval()


def masks_of(net, pictures):
    """Return the (n, h, w) masks that a network finds."""
    with torch.no_grad():
        return np.concatenate([(net(torch.from_numpy(part).float() / 255.0) > 0).numpy()
                               for part in np.array_split(pictures, -(-len(pictures) // 8))])


def main():
    """Train, judge, and write what was found."""
    parser = argparse.ArgumentParser(description='Segmentation of rocks.')
    parser.add_argument('shards', type=Path)
    parser.add_argument('--epochs', type=int, default=30)
    parser.add_argument('-o', '--output', type=Path, default=Path('rock_segmentation'))
    args = parser.parse_args()
    torch.set_num_threads(1)
    pictures, targets, told = load(args.shards, 'train')
    print(f'{len(pictures)} pictures to train on', flush=True)
    net = train(pictures, targets, args.epochs)
    unseen, truth, about = load(args.shards, 'test')
    if {world for _, world in told} & {world for _, world in about}:
        raise SystemExit('a world is in both splits')
    found = masks_of(net, unseen)
    counts = np.array([confusion(*pair) for pair in zip(found, truth)])
    scores, each = scores_of(counts, about), iou(counts)
    args.output.mkdir(parents=True, exist_ok=True)
    (args.output / 'scores.json').write_text(json.dumps(scores, indent=1) + '\n')
    torch.save(net.state_dict(), args.output / 'net.pt')
    rows = []
    for base in sorted({base for base, _ in about}):
        own = [k for k, (name, _) in enumerate(about) if name == base]
        own.sort(key=lambda k: each[k])     # a poor, a median and a good one
        chosen = [own[len(own) // 10], own[len(own) // 2], own[9 * len(own) // 10]]
        rows.append(np.hstack([shown(unseen[k], found[k], truth[k]) for k in chosen]))
    cv2.imwrite(str(args.output / 'predictions.png'), np.vstack(rows))
    for base, score in scores.items():
        print(f'{base}: IoU {score["iou"]:.3f} [{score["interval"][0]:.3f}, '
              f'{score["interval"][1]:.3f}], precision {score["precision"]:.3f}, recall '
              f'{score["recall"]:.3f}; {score["pictures"]} pictures, {score["worlds"]} worlds')


if __name__ == '__main__':
    main()
