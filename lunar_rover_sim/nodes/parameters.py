"""Parameter sets as ROS 2 parameters: one declaration, descriptors and checks included."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast, TypeVar

from rcl_interfaces.msg import (FloatingPointRange, IntegerRange, ParameterDescriptor,
                                SetParametersResult)
from rclpy.node import Node
from rclpy.parameter import Parameter

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import NAME, nearest, ParamInfo
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.run.shared_config import NodeConfig

C = TypeVar('C', bound=NodeConfig)

_ARRAY_TYPES = {'tuple[float, ...]': Parameter.Type.DOUBLE_ARRAY,
                'tuple[int, ...]': Parameter.Type.INTEGER_ARRAY,
                'tuple[str, ...]': Parameter.Type.STRING_ARRAY}
# Parameters that rclpy itself gives every node.
_RESERVED = ('use_sim_time', 'start_type_description_service', qos.PREFIX)


def declare(node: Node, cls: type[C]) -> C:
    """Declare every parameter of `cls` on the node and return `cls` with the node's overrides.

    Args:
        node: A node made with automatically_declare_parameters_from_overrides.

    Raises:
        ConfigError: If an override has the wrong type, is out of range, or has a name that is not
            declared.
    """
    qos.check_values(node)
    defaults = cls()
    # rclpy's annotation of the result is wrong.
    declared = cast('dict[str, Parameter]', node.get_parameters_by_prefix(''))
    overrides = {name: parameter for name, parameter in declared.items()
                 if not name.startswith(_RESERVED)}
    names = [name for name, *_ in defaults.flatten()]
    # Prefixes of sets that users name, `hazard.`; `from_mapping` checks what follows the prefix.
    named = tuple({name.partition(f'{NAME}.')[0] for name, *_ in defaults.flatten(documented=True)
                   if f'.{NAME}.' in name})
    shared = {name for name, *_ in NodeConfig().flatten()}
    for name in overrides:
        if name not in names and name not in shared and not name.startswith(named):
            raise ConfigError(f'{name}: no such parameter of {node.get_name()}; '
                              f'{nearest(name, names)}')
        # It is declared again below, with its descriptor.
        node.undeclare_parameter(name)
    values = {name: _plain(parameter.value) for name, parameter in overrides.items()
              if name in names or name.startswith(named)}
    config = cls.from_mapping(values)
    for name, value, info, kind in config.flatten():
        parameter = _parameter(name, value, kind)
        node.declare_parameter(name, parameter.value if parameter.value != [] else
                               parameter.type_, _descriptor(info, kind), ignore_override=True)
        if parameter.value == []:
            node.set_parameters([parameter])
    return config


def on_change(node: Node, config: C, apply: Callable[[C], None]) -> None:
    """Let live parameters change while the node runs.

    A new set is checked and passed to `apply`; a ConfigError refuses it with its message. The
    other parameters are read-only by their descriptors.
    """
    current = [config]

    def callback(parameters: list[Parameter]) -> SetParametersResult:
        values = {name: value for name, value, *_ in current[0].flatten()}
        given = {p.name: _plain(p.value) for p in parameters if p.name in values}
        if not given:       # those that rclpy declares
            return SetParametersResult(successful=True)
        values.update(given)
        try:
            changed = type(config).from_mapping(values)
            apply(changed)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        current[0] = changed
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(callback)


def _plain(value: Any) -> Any:
    """Return the value of a ROS parameter with arrays as lists."""
    if value is None or isinstance(value, (bool, int, float, str, bytes)):
        return value
    return list(value)


def _parameter(name: str, value: Any, kind: Any) -> Parameter:
    if isinstance(value, tuple):
        return Parameter(name, _ARRAY_TYPES[str(kind)], list(value))
    return Parameter(name, value=value)


def _descriptor(info: ParamInfo, kind: Any) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=info.doc + (f' [{info.unit}]' if info.unit else ''),
        additional_constraints=f'valid: {info.valid() or "any"}', read_only=not info.live)
    # Ranges of ROS 2 are closed on both sides and hold for scalars only.
    if info.low is not None and info.high is not None:
        if kind is float:
            descriptor.floating_point_range = [FloatingPointRange(
                from_value=float(info.low), to_value=float(info.high))]
        elif kind is int:
            descriptor.integer_range = [IntegerRange(
                from_value=int(info.low), to_value=int(info.high))]
    return descriptor
