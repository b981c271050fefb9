# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`--set NAME=VALUE` of the command line."""

import yaml

from timo_sim.scene.parameter import ParameterError


def parsed_settings(settings):
    """
    Return values by name of texts such as 'model.modes=5'; values are written as in YAML.

    Raises
    ------
    ParameterError

    """
    values = {}
    for text in settings:
        name, equals, value = text.partition('=')
        try:
            values[name.strip()] = yaml.safe_load(value)
        except yaml.YAMLError:
            equals = ''
        if not equals:
            raise ParameterError(f'--set takes NAME=VALUE, such as model.modes=5; got {text!r}')
    return values
