# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The node's parameters: declared, described, checked by the same rules as a YAML file."""

import math

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

from timo_sim.scene.files import FOREIGN
from timo_sim.scene.parameter import ParameterError, whole_ratio
from timo_sim.scene.parameters import check, PARAMETERS, RATES
from timo_sim.simulation.resolution import choose_resolution

_LARGEST = 1.7976931348623157e308


def declare_parameters(node):
    """
    Declare all parameters of a node; return the checked value of each by name.

    Raises
    ------
    ParameterError
        If a given name is unknown or a value breaks its rule.

    """
    # rclpy has no public way to see names that nobody declares, and these must not pass unseen.
    given = {name: parameter.value
             for name, parameter in node._parameter_overrides.items()
             if not name.startswith(FOREIGN)}
    values = {name: parameter.default for name, parameter in PARAMETERS.items()}
    values.update(check(given, 'ROS parameter'))
    for name, parameter in PARAMETERS.items():
        value = values[name]
        if value == ():  # rclpy cannot tell the type of an empty list
            value = Parameter.Type.DOUBLE_ARRAY
        elif isinstance(value, tuple):
            value = list(value)
        node.declare_parameter(name, value, _descriptor(parameter), ignore_override=True)
    return values


def on_set(node, values, apply):
    """
    Check what is set at run time, and update `values` with it.

    Before that `apply` is given the changed values; it may raise ParameterError to refuse them.
    """
    def callback(parameters):
        changed = {parameter.name: parameter.value for parameter in parameters
                   if not parameter.name.startswith(FOREIGN)}
        try:
            changed = check(changed, 'set at run time')
            apply(changed)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        values.update(changed)
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(callback)


def steps_between_messages(values, step):
    """Return how many time steps [s] lie between the messages of each rate that is in use."""
    return {rate: whole_ratio('1/integrator.step', 1.0 / step, rate, values[rate])
            for rate in RATES if values.get(f'publish_{rate.removeprefix("rate.")}', True)}


def resolved_scene(node, scene, values):
    """Return a scene with modes and step that its `model.accuracy` asks for; update values."""
    def suits(step):
        try:
            steps_between_messages(values, step)
            whole_ratio('duration', values['duration'], 'integrator.step', step)
        except ParameterError:
            return False
        return True

    logger = node.get_logger()
    logger.info('choosing modes and step for model.accuracy, compiling once for each new size')
    chosen = choose_resolution(scene, values['duration'], suits)
    logger.info(f'model.accuracy = {scene.values["model.accuracy"]:g} m: {chosen}')
    values.update(chosen.scene.values)
    return chosen.scene


def _descriptor(parameter):
    unit = f' [{parameter.unit}]' if parameter.unit else ''
    descriptor = ParameterDescriptor(
        description=parameter.meaning + unit, additional_constraints=parameter.rule,
        read_only=not parameter.runtime,
        # A whole number for a float changes the type; `check` has the last word.
        dynamic_typing=isinstance(parameter.default, float))
    if isinstance(parameter.default, float) and parameter.low > -math.inf:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=parameter.low, to_value=(
                min(parameter.high, _LARGEST) if parameter.finite else math.inf))]
    elif type(parameter.default) is int:
        descriptor.integer_range = [
            IntegerRange(from_value=int(parameter.low), to_value=int(parameter.high), step=1)]
    return descriptor
