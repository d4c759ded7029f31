"""Where the pixels of a band of an image meet the ground, in the order in which they are lit.

Pixels lie in chunks of 128: 64 columns of two rows, so that the neighbours of each one of a block
of 2 x 2 are at hand. Loops over a chunk are compiled to vector instructions.
"""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import vectorised
from lunar_rover_sim.image.rendering.row_math import CHUNK, COLUMNS


@vectorised
def place(view, image, row, rows, depth, x, y, z, vx, vy, vz):  # type: ignore[no-untyped-def]
    """Fill in depth and place of the pixels of a band.

    Args:
        view: As `view.numbers`.
        image: (h, w) depth of the ground, 0 where there is none [m].
        row, rows: First one of the band, and their number, which is even.
        depth: (n,) [m]; 0 beyond the image, too.
        x, y, z: (n,) place; x and y in the world, z over the camera [m].
        vx, vy, vz: (n,) unit vector to the camera.
    """
    chunk, columns = CHUNK, COLUMNS
    h, w = image.shape
    one = np.float32(1.0)
    blocks = (w + columns - 1) // columns
    ax, ay, az = view[0], view[1], view[2]
    bx, by, bz = view[3], view[4], view[5]
    cx, cy, cz = view[6], view[7], view[8]
    ex, ey = view[9], view[10]
    steps = np.arange(columns).astype(np.float32)
    for c in range(rows // 2 * blocks):
        first = columns * (c % blocks)
        inside = min(columns, w - first)
        for k in range(2):
            r = row + 2 * (c // blocks) + k
            i = chunk * c + columns * k
            own = depth[i:i + columns]
            if r < h:
                source = image[r, first:first + inside]
                for j in range(inside):
                    own[j] = source[j]
                for j in range(inside, columns):
                    own[j] = np.float32(0.0)
            else:
                own[:] = np.float32(0.0)
            down = np.float32(r)
            fx, fy, fz = ax + cx * down, ay + cy * down, az + cz * down
            start = np.float32(first)
            ox, oy, oz = x[i:i + columns], y[i:i + columns], z[i:i + columns]
            for j in range(columns):
                ox[j] = (fx + bx * (start + steps[j])) * own[j] + ex
            for j in range(columns):
                oy[j] = (fy + by * (start + steps[j])) * own[j] + ey
            for j in range(columns):
                oz[j] = (fz + bz * (start + steps[j])) * own[j]
            ux, uy, uz = vx[i:i + columns], vy[i:i + columns], vz[i:i + columns]
            for j in range(columns):
                a, b, d = (fx + bx * (start + steps[j]), fy + by * (start + steps[j]),
                           fz + bz * (start + steps[j]))
                shrink = -one / np.sqrt(a * a + b * b + d * d)
                ux[j] = a * shrink
                uy[j] = b * shrink
                uz[j] = d * shrink


@vectorised
def spread(rows, row, values, image, add):  # type: ignore[no-untyped-def]
    """Write the (n,) values of a band into an (h, w) image, or add them to it."""
    chunk, columns = CHUNK, COLUMNS
    h, w = image.shape
    blocks = (w + columns - 1) // columns
    for c in range(rows // 2 * blocks):
        first = columns * (c % blocks)
        inside = min(columns, w - first)
        for k in range(2):
            r = row + 2 * (c // blocks) + k
            if r < h:
                source, out = values[chunk * c + columns * k:], image[r, first:first + inside]
                if add:
                    for j in range(inside):
                        out[j] += source[j]
                else:
                    for j in range(inside):
                        out[j] = source[j]
