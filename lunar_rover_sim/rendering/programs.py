"""The shader programs that the renderer draws with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lunar_rover_sim.rendering.context import load_program
from lunar_rover_sim.rendering.terrain import CHUNK

if TYPE_CHECKING:
    import moderngl

_LIT = {'ROVER_SHADOW': 1}
# Passes over the pixels of the ground, by name.
GROUND_PASSES: dict[str, dict[str, int]] = {
    'ground': {**_LIT, 'SKYLINE': 1}, 'refined': {**_LIT, 'SKYLINE': 1, 'REFINE': 1},
    'unlit ground': {'UNLIT': 1}, 'unlit refined': {'UNLIT': 1, 'REFINE': 1},
    'truth ground': {'TRUTH': 1}}


def load_programs(context: moderngl.Context, levels: int,
                  lamp: bool) -> dict[str, moderngl.Program]:
    """Compile all programs for a world of so many levels; lamp: whether the rover has one."""
    lit = {**_LIT, 'LAMP': 1} if lamp else _LIT
    return {
        'inner': load_program(context, 'terrain', 'terrain'),
        'outer': load_program(context, 'terrain', 'terrain', OUTER=1),
        'inner skirt': load_program(context, 'terrain', 'terrain', SKIRT=1, CHUNK=CHUNK),
        'outer skirt': load_program(context, 'terrain', 'terrain', OUTER=1, SKIRT=1, CHUNK=CHUNK),
        **{name: load_program(context, 'screen', 'ground', LEVELS=levels,
                              **{**flags, **(lit if 'ROVER_SHADOW' in flags else {})})
           for name, flags in GROUND_PASSES.items()},
        'rock': load_program(context, 'rock', 'rock', **lit),
        'rover': load_program(context, 'rover', 'rover'),
        'truth rock': load_program(context, 'rock', 'rock', TRUTH=1),
        'truth rover': load_program(context, 'rover', 'rover', TRUTH=1),
    }
