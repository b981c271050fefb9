# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The node's parameters, declared with descriptions and checked by the rules for YAML files."""

from collections.abc import Callable, Mapping
import math
from types import MappingProxyType
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.service import Service

from timo_sim.ros.private import overrides
from timo_sim.scene.files import is_for, is_of_rclpy
from timo_sim.scene.parameters import (
    check, complete, DEFAULTS, gives_arm, ParameterError, PARAMETERS, RATES, short, whole_ratio)
from timo_sim.scene.plausible import find_outdated

_SOURCE = 'set at run time'


class ParameterNode(Node):
    """A node with the parameters of timo_sim: `given` reads them, `declare` declares them."""

    def given(self, files: Mapping[str, Mapping] = MappingProxyType({})) -> dict[str, Any]:
        """
        Return the checked value of each parameter by name; raise ParameterError.

        `files` are the sections of the parameter files of the command line. If they give any
        `arm.*`, they are a scene of its own; other parameters change the paper's.
        """
        # Undeclared names must be refused.
        given = {name: parameter.value for name, parameter in overrides(self).items()
                 if not is_of_rclpy(name)}
        # ROS reads y as true, also in `ros2 param dump`, which writes it without quotes.
        if given.get('carrier.held') is True:
            given['carrier.held'] = 'y'
        name = self.get_fully_qualified_name()
        own = any(gives_arm(values) for sections in files.values()
                  for section, values in sections.items() if is_for(section, name))
        given = check(given, 'ROS parameter')
        values = complete(given, own)
        outdated = own and find_outdated(given, values)
        if outdated:
            self.get_logger().warning(outdated)
        return values

    def declare(self, values: dict[str, Any], apply: Callable[[dict[str, Any]], None]) -> None:
        """
        Declare all parameters with these values, and update `values` when some are set later.

        `apply` is called with those first, a dictionary; it may raise ParameterError to refuse
        them.
        """
        for name, rule in PARAMETERS.items():
            parameter = _of_rclpy(name, values[name])
            unit = f' [{rule.unit}]' if rule.unit else ''
            descriptor = ParameterDescriptor(
                type=parameter.type_.value, description=rule.meaning + unit,
                additional_constraints=rule.rule, read_only=not rule.runtime)
            # In three steps, because rclpy cannot infer the type of an empty list.
            self.declare_parameter(name, parameter.type_, ignore_override=True)
            self.set_parameters([parameter])
            self.set_descriptor(name, descriptor)

        def callback(parameters):
            changed = {parameter.name: parameter.value for parameter in parameters
                       if not is_of_rclpy(parameter.name)}
            try:
                changed = check(changed, _SOURCE)
                apply(changed)
            except ParameterError as error:
                return _refused(error)
            values.update(changed)
            return SetParametersResult(successful=True)

        self.add_on_set_parameters_callback(callback)

    def create_service(self, srv_type: Any, srv_name: str, callback: Callable,
                       **options: Any) -> Service:
        """Offer a service; the callbacks of rclpy's own services that set are replaced."""
        if srv_type in (SetParameters, SetParametersAtomically):
            callback = self._set
        return super().create_service(srv_type, srv_name, callback, **options)

    def set_parameters_atomically(
            self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters all at once, converted to their types; rclpy's services call this."""
        try:
            return super().set_parameters_atomically([*map(_converted, parameter_list)])
        except ParameterNotDeclaredException:
            names = [each.name for each in parameter_list if not self.has_parameter(each.name)]
            return _refused(f'{short(", ".join(names), str)} is not declared')
        except ParameterError as error:
            return _refused(error)

    def _set(self, request, response):
        # All of a call together, because lists of a load change their lengths together. What rclpy
        # cannot read would otherwise get no answer.
        try:
            result = self.set_parameters_atomically(
                [*map(Parameter.from_parameter_msg, request.parameters)])
        except ValueError as error:
            result = _refused(f'a parameter cannot be read: {error}')
        if isinstance(response, SetParametersAtomically.Response):
            response.result = result
        else:
            response.results = [result] * len(request.parameters)
        return response


def _refused(error):
    return SetParametersResult(successful=False, reason=str(error))


def _converted(parameter):
    # `ros2 param set` sends [0, 0.5] as a text and [1] as whole numbers.
    name, value = parameter.name, parameter.value
    if is_of_rclpy(name) or value is None:
        return parameter
    is_list = isinstance(DEFAULTS.get(name), tuple)
    if isinstance(value, str) and is_list and (value[:1], value[-1:]) == ('[', ']'):
        value = value[1:-1].split(',')
    return _of_rclpy(name, check({name: value}, _SOURCE).get(name, value))


def _of_rclpy(name, value):
    if isinstance(value, tuple):
        return Parameter(name, Parameter.Type.DOUBLE_ARRAY, list(value))
    return Parameter(name, value=value)


def steps_between_messages(values: dict[str, Any], step: float) -> dict[str, int]:
    """
    Return the number of time steps between messages, by name of each rate that is in use.

    `step` is in [s]. A rate that is no whole fraction of 1/step is a ParameterError, but that of a
    topic that is not published is rounded down.
    """
    return {rate: whole_ratio('1/integrator.step', 1.0 / step, rate, values[rate])
            if values.get(f'publish_{rate.removeprefix("rate.")}', True)
            else max(1, math.ceil(round(1.0 / step / values[rate], 6))) for rate in RATES}
