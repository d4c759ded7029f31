"""Mutants of the domain code, drawn at random: places, operators, what has no behaviour."""

import ast
from collections.abc import Iterator
import itertools
import random

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
import cosmic_ray.plugins
from forked import PACKAGE, ROOT
from sample import modules, Mutant

# Changes that make sense for the types at hand: a shifted float would only raise a TypeError.
ARITHMETIC, COMPARISONS = 'Add Sub Mul Div FloorDiv Mod Pow', 'Eq NotEq Lt LtE Gt GtE'
OPERATORS = {f'core/Replace{kind}Operator_{one}_{other}'
             for kind, names in (('Binary', ARITHMETIC), ('Binary', 'BitAnd BitOr BitXor'),
                                 ('Comparison', COMPARISONS), ('Comparison', 'Is IsNot'),
                                 ('Unary', 'UAdd USub'))
             for one in names.split() for other in names.split() if one != other}
OPERATORS |= {f'core/{name}' for name in (
    'AddNot', 'NumberReplacer', 'ReplaceAndWithOr', 'ReplaceBreakWithContinue',
    'ReplaceContinueWithBreak', 'ReplaceFalseWithTrue', 'ReplaceOrWithAnd',
    'ReplaceTrueWithFalse', 'ReplaceUnaryOperator_Delete_Not',
    'ReplaceUnaryOperator_Delete_USub', 'ZeroIterationForLoop')}


def places(module: str) -> Iterator[list[tuple[str, str, int]]]:
    """Yield, for every place that can be changed, its (module, operator, occurrence)."""
    code = (ROOT / PACKAGE / module).read_text(encoding='utf-8')
    nodes = list(ast_nodes(get_ast(code)))
    unseen = lines_without_behaviour(code)
    found: dict[tuple[int, int], list[tuple[str, str, int]]] = {}
    for name in sorted(OPERATORS.intersection(cosmic_ray.plugins.operator_names())):
        operator = cosmic_ray.plugins.get_operator(name)()
        positions = [start for node in nodes for start, _ in operator.mutation_positions(node)]
        for occurrence, start in enumerate(positions):
            if not any(first <= start < last for first, last in unseen):
                found.setdefault(start, []).append((module, name, occurrence))
    yield from found.values()


def change(module: str, operator: str, occurrence: int) -> Mutant | None:
    """Return a mutant; None where more than a line changes."""
    code = (ROOT / PACKAGE / module).read_text(encoding='utf-8')
    changed = mutate_code(code, cosmic_ray.plugins.get_operator(operator)(), occurrence)
    before, after = code.splitlines(), changed.splitlines()
    differ = [i for i, lines in enumerate(zip(before, after)) if lines[0] != lines[1]]
    if len(before) != len(after) or len(differ) != 1:
        return None
    return Mutant(module, differ[0] + 1, before[differ[0]], after[differ[0]])


def lines_without_behaviour(code: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return spans (from, to) of (line, column) that are not worth a change.

    Annotations are never evaluated; what stands in `raise` or in a call of the logger is text.
    """
    nodes: list[ast.AST | None] = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, (ast.AnnAssign, ast.arg)):
            nodes.append(node.annotation)
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            nodes.append(node.returns)
        elif isinstance(node, ast.Raise) or (
                isinstance(node, ast.Call) and ast.unparse(node.func).startswith('logger.')):
            nodes.append(node)
    return [((node.lineno, node.col_offset),    # type: ignore[attr-defined]
             (node.end_lineno, node.end_col_offset))     # type: ignore[attr-defined]
            for node in nodes if node is not None]


def draw(number: int, seed: int) -> list[Mutant]:
    """Return a random sample: every place is as likely, and so is every change of a place."""
    rng = random.Random(seed)
    everywhere = [place for module in modules() for place in places(module)]
    rng.shuffle(everywhere)
    mutants = (change(*rng.choice(place)) for place in everywhere)
    return list(itertools.islice(filter(None, mutants), number))
