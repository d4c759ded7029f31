"""A policy as a file: a small network in ONNX, and metadata that say all a node must know.

The metadata entry `lunar_rover_sim` is JSON; its fields are those of `PolicyCard`. A file whose
metadata do not fit its network or the package is refused with one line. onnxruntime reads and
runs it (extra `[policy]`), onnx writes it (extra `[train]`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
import importlib.util
import json
from pathlib import Path
import subprocess
import tempfile
from typing import Any

import numpy as np

from lunar_rover_sim.autonomy.learning.senses import Channel, LIMIT
from lunar_rover_sim.autonomy.learning.task import Driver, RoverTask, TaskConfig
from lunar_rover_sim.autonomy.learning.tasks import TASKS
from lunar_rover_sim.base.errors import (LearningError, LunarRoverSimError, nearest, one_line,
                                         with_extra)
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import check_regular, config_folder

KEY, FORMAT = 'lunar_rover_sim', 1
MOST_BYTES = 1 << 20
_OPSET, _IR = 17, 8         # which all runtimes since 1.18 read
_DRAWN = 64                 # observations that a network must answer with numbers
RUNNABLE = ('walk', 'gait')     # tasks whose driver needs no more than a rover senses
# What is commanded: its name, its unit, and the option that has the range of the training.
COMMANDS = (('speed', 'm/s', 'forward_mps'), ('yaw rate', 'rad/s', 'yaw_rate_radps'))


@dataclasses.dataclass(frozen=True)
class PolicyCard:
    """What a file says of its policy.

    Attributes:
        format: Version of these fields.
        task: walk, gait or reach.
        rover: Name of the rover.
        legs: Names of its legs, in their order.
        ground: It was trained on.
        observation: Channels in their order.
        action: Channels in their order.
        decision_hz: Rate of decisions.
        options: Parameters of the task; `forward_mps` and `yaw_rate_radps` are the ranges of
            commands that the policy is offered for.
        algorithm: How it was found.
        decisions: In training.
        seeds: Of the training.
        commit: Of the code that trained it.
        licence: Of the weights.
    """

    format: int
    task: str
    rover: str
    legs: tuple[str, ...]
    ground: str
    observation: tuple[Channel, ...]
    action: tuple[Channel, ...]
    decision_hz: float
    options: Mapping[str, Any]
    algorithm: str
    decisions: int
    seeds: tuple[int, ...]
    commit: str
    licence: str

    @classmethod
    def of(cls, task: RoverTask, facts: Mapping[str, Any]) -> PolicyCard:
        """Return the card of a policy that was trained on a task.

        Args:
            facts: Of the training: algorithm, decisions and seeds; licence, if it is another.
        """
        config = task.config
        return cls(FORMAT, task.name, task.rover.name, task.rover.legs.names, config.ground,
                   task.channels, task.actions, 1e9 / task.driver.decision_ns,
                   config.to_mapping(), str(facts['algorithm']), int(facts['decisions']),
                   tuple(facts['seeds']), _commit(), str(facts.get('licence', 'Apache-2.0')))

    @classmethod
    def parse(cls, text: str) -> PolicyCard:
        """Read the JSON of a file; raise LearningError that names the field that is wrong."""
        try:
            document = json.loads(text)
        except (ValueError, RecursionError):
            raise LearningError('metadata: not JSON') from None
        fields = {field.name: field for field in dataclasses.fields(cls)}
        if not isinstance(document, dict):
            raise LearningError('metadata: not a mapping')
        for name in document:
            if name not in fields:
                raise LearningError(f'metadata: {name}: no such entry; {nearest(name, fields)}')
        missing = [name for name in fields if name not in document]
        if missing:
            raise LearningError(f'metadata: {", ".join(missing)} missing')
        if document['format'] != FORMAT:
            raise LearningError(f'metadata: format: {document["format"]} is not valid; valid is '
                                f'{FORMAT}')
        try:
            for name in ('observation', 'action'):
                document[name] = tuple(Channel(str(c['name']), str(c['unit']), float(c['scale']),
                                               float(c['offset'])) for c in document[name])
            for name in ('legs', 'seeds'):
                document[name] = tuple(document[name])
            document['decision_hz'] = float(document['decision_hz'])
            return cls(**document)
        except (TypeError, KeyError, ValueError) as error:
            raise LearningError(f'metadata: not as format {FORMAT} has it: '
                                f'{one_line(error)}') from None

    def text(self) -> str:
        """Return the JSON of a file."""
        return json.dumps(dataclasses.asdict(self))


class Policy:
    """A network and its card.

    Attributes:
        card: What the file says.
        path: The file.
    """

    def __init__(self, path: str | Path) -> None:
        """Read a file, or the packaged policy of a name.

        Args:
            path: The file, or the name.

        Raises:
            LearningError: It cannot be read, is damaged, does not fit itself or the package, or
                gives no numbers for some observation; or onnxruntime is not installed.
        """
        self.path = policy_path(path)
        content = _content(self.path)
        try:
            self._run, metadata = _session(content)
            self.card = _checked_card(metadata)
            self._check_network()
        except LunarRoverSimError as error:
            raise LearningError(f'{self.path}: {error}') from None

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the action, (n,) within -1 and 1, for an observation; NaN stays NaN."""
        return np.clip(self._run(observation), -1.0, 1.0).astype(float)

    def config(self) -> TaskConfig:
        """Return the parameters of the task that the policy was trained on.

        Raises:
            LearningError: This package has other ones.
        """
        try:
            return TASKS[self.card.task][1].from_mapping(dict(self.card.options), 'options')
        except LunarRoverSimError as error:
            raise LearningError(f'{self.path}: {error}') from None

    def check(self, driver: Driver, rover: str, legs: Sequence[str]) -> None:
        """Raise LearningError where rover, legs, rates, names or scales differ from a driver's."""
        card = self.card
        if card.rover != rover or card.legs != tuple(legs):
            raise LearningError(f'{self.path}: is a policy for rover {card.rover} with legs '
                                f'{", ".join(card.legs)}; here is {rover} with '
                                f'{", ".join(legs)}')
        if abs(card.decision_hz - 1e9 / driver.decision_ns) > 1e-6:
            raise LearningError(f'{self.path}: decision_hz: {card.decision_hz:g} is not valid; '
                                f'valid is {1e9 / driver.decision_ns:g} for its options [Hz]')
        for name, given, here in (('observation', card.observation, driver.channels),
                                  ('action', card.action, driver.actions)):
            if len(given) != len(here):
                raise LearningError(f'{self.path}: {name}: {len(given)} channels; valid are '
                                    f'{len(here)}')
            for one, other in zip(given, here):
                if one != other:
                    raise LearningError(f'{self.path}: {name}: {_words(one)} is not valid; valid '
                                        f'is {_words(other)}')

    def _check_network(self) -> None:
        """Run it on zeros and on drawn observations."""
        card, rng = self.card, np.random.default_rng(0)
        count = len(card.observation)
        drawn = [np.zeros(count), *(np.clip(rng.normal(0.0, spread, count), -LIMIT, LIMIT)
                                    for spread in np.geomspace(0.1, LIMIT, _DRAWN))]
        for observation in drawn:
            try:
                action = np.asarray(self._run(observation))
            except Exception as error:      # of the runtime, whose errors have no common class
                raise LearningError(f'its network does not take {count} numbers, as its metadata '
                                    f'say: {one_line(error)[:200]}') from None
            if action.shape != (len(card.action),):
                raise LearningError(f'its network gives {action.shape} numbers; its metadata say '
                                    f'({len(card.action)},)')
            if not np.isfinite(action).all():
                raise LearningError(f'its network gives {action} for drawn observations within '
                                    f'{LIMIT:g} and -{LIMIT:g}; valid are finite numbers')


def policy_names() -> list[str]:
    """Return the names of the packaged policies."""
    return sorted(path.stem for path in (config_folder() / 'policies').glob('*.onnx'))


def policy_path(name_or_path: str | Path) -> Path:
    """Return the file of a policy, by the name of a packaged one or by its path.

    Raises:
        LearningError: There is no such packaged policy.
    """
    text = str(name_or_path)
    if not text:
        raise LearningError('policy: not given; valid is a file, or '
                            + (', '.join(policy_names()) or 'the name of a packaged policy'))
    if '/' in text or text.endswith('.onnx'):
        return Path(text)
    if text not in policy_names():
        raise LearningError(f'{text[:80]}: no such policy; {nearest(text, policy_names())}')
    return config_folder() / 'policies' / f'{text}.onnx'


def save_policy(path: Path, layers: Sequence[tuple[np.ndarray, np.ndarray]], task: RoverTask,
                facts: Mapping[str, Any]) -> None:
    """Write a policy of linear layers and its card: `PATH.onnx` and `PATH.md`.

    Args:
        path: Of the file, which ends in .onnx.
        layers: Weights (out, in) and biases (out,) of each; between them is tanh.
        task: It was trained on.
        facts: As `PolicyCard.of` takes them.

    Raises:
        LearningError: As `save_network`.
    """
    onnx = _onnx()
    nodes, weights, last = [], [], 'observation'
    for k, (weight, bias) in enumerate(layers):
        weights += [onnx.numpy_helper.from_array(weight.astype(np.float32), f'weight_{k}'),
                    onnx.numpy_helper.from_array(bias.astype(np.float32), f'bias_{k}')]
        out = 'action' if k == len(layers) - 1 else f'sum_{k}'
        nodes.append(onnx.helper.make_node('Gemm', [last, f'weight_{k}', f'bias_{k}'], [out],
                                           transB=1))
        if out != 'action':
            last = f'layer_{k}'
            nodes.append(onnx.helper.make_node('Tanh', [out], [last]))

    def numbers(name: str, count: int) -> Any:
        return onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1, count])

    graph = onnx.helper.make_graph(
        nodes, 'policy', [numbers('observation', len(task.channels))],
        [numbers('action', len(task.actions))], weights)
    save_network(path, onnx.helper.make_model(
        graph, opset_imports=[onnx.helper.make_opsetid('', _OPSET)], ir_version=_IR,
        producer_name='lunar_rover_sim').SerializeToString(), task, facts)


def save_network(path: str | Path, content: bytes, task: RoverTask,
                 facts: Mapping[str, Any]) -> None:
    """Write any ONNX network as a policy and its card: `PATH.onnx` and `PATH.md`.

    Both are written whole or not at all, and only if `Policy` takes the file.

    Args:
        path: Of the file, which ends in .onnx.
        content: An ONNX file whose input is (1, observations) and whose first output is
            (1, actions), float32, as `task.channels` and `task.actions` have them.
        task: It was trained on.
        facts: As `PolicyCard.of` takes them.

    Raises:
        LearningError: The package onnx is missing, the network is too large, no ONNX or not one
            for the task, or the file cannot be written.
    """
    onnx, path = _onnx(), Path(path)
    card = PolicyCard.of(task, facts)
    try:
        model = onnx.load_from_string(content)
    except Exception as error:          # of Protocol Buffers, whose errors have no common class
        raise LearningError(f'{path}: not ONNX: {one_line(error)[:200]}') from None
    onnx.helper.set_model_props(model, {KEY: card.text()})
    content = model.SerializeToString()
    if len(content) > MOST_BYTES:
        raise LearningError(f'{path}: {len(content)} bytes; valid is up to {MOST_BYTES}')
    with tempfile.TemporaryDirectory() as folder:
        tried = Path(folder) / path.name
        tried.write_bytes(content)
        Policy(tried)
    atomic_write(path, content, LearningError)
    atomic_write(path.with_suffix('.md'), card_text(card), LearningError)


def _onnx() -> Any:
    if importlib.util.find_spec('onnx') is None:
        raise LearningError(f'onnx: not installed; {with_extra("train")}')
    import onnx
    import onnx.helper
    import onnx.numpy_helper
    return onnx


def constant_layers(task: RoverTask, action: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the layers of a policy that gives one action whatever it sees."""
    return [(np.zeros((len(action), len(task.channels))), np.asarray(action))]


def card_text(card: PolicyCard) -> str:
    """Return the model card of a policy in Markdown."""
    lines = [f'# Policy for {card.task} of {card.rover} on {card.ground}', '',
             f'- Found by: {card.algorithm}, {card.decisions} decisions, seeds '
             f'{", ".join(map(str, card.seeds))}.',
             f'- Code: commit {card.commit}.',
             f'- Licence: {card.licence}.', f'- Decisions: {card.decision_hz:g} Hz.',
             *(f'- Trained for a {words} of {low:g} to {high:g} {unit}.'
               for words, unit, name in COMMANDS if name in card.options
               for low, high in [card.options[name]]),
             f'- Legs: {", ".join(card.legs)}.', '',
             '| observation | unit | scale |', '|---|---|---|',
             *(f'| {c.name} | {c.unit or "1"} | {c.scale:g} |' for c in card.observation), '',
             '| action | unit | value of 0 | scale |', '|---|---|---|---|',
             *(f'| {c.name} | {c.unit or "1"} | {c.offset:g} | {c.scale:g} |'
               for c in card.action), '']
    return '\n'.join(lines)


def _checked_card(metadata: Mapping[str, str]) -> PolicyCard:
    if KEY not in metadata:
        raise LearningError(f'metadata: no entry {KEY}; it is no policy of this package')
    card = PolicyCard.parse(metadata[KEY])
    if card.task not in TASKS:
        raise LearningError(f'metadata: task: {card.task!r} is not valid; '
                            f'{nearest(str(card.task), TASKS)}')
    return card


def _content(path: Path) -> bytes:
    check_regular(path, LearningError)
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise LearningError(f'{path}: {size} bytes; valid is up to {MOST_BYTES}')
        return path.read_bytes()
    except OSError as error:
        raise LearningError(f'{path}: cannot be read: {error.strerror}') from None


def _session(content: bytes) -> tuple[Callable[[np.ndarray], np.ndarray], Mapping[str, str]]:
    """Return what runs a network by onnxruntime, on one thread, and its metadata."""
    if importlib.util.find_spec('onnxruntime') is None:
        raise LearningError(f'onnxruntime: not installed; {with_extra("policy")}')
    import onnxruntime
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(content, options, ['CPUExecutionProvider'])
        name = session.get_inputs()[0].name
        metadata = session.get_modelmeta().custom_metadata_map
    except Exception as error:          # of the runtime, whose errors have no common class
        raise LearningError('is damaged, or onnxruntime cannot run it: '
                            f'{one_line(error)[:300]}') from None
    return lambda observation: session.run(
        None, {name: np.asarray(observation, np.float32)[None]})[0][0], metadata


def _words(channel: Channel) -> str:
    return f'{channel.name} [{channel.unit or "1"}], scale {channel.scale:g}'


def _commit() -> str:
    """Return the commit of the source tree, or '' in an installation."""
    try:
        found = subprocess.run(['git', 'rev-parse', '--short=12', 'HEAD'], capture_output=True,
                               text=True, cwd=Path(__file__).parent, timeout=10.0)
    except (OSError, subprocess.TimeoutExpired):
        return ''
    return found.stdout.strip() if found.returncode == 0 else ''
