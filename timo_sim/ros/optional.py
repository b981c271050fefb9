# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What only some scenes ask for, and not every machine has: imported when it is asked for."""

from importlib.util import find_spec

from timo_sim.scene.parameter import ParameterError, short


def arm_shape(node, model):
    """Return the outlet of ~/arm_shape; raise ParameterError if its messages are not installed."""
    try:
        from timo_sim.ros.arm_shape import ArmShape
    except ModuleNotFoundError as error:
        raise ParameterError(f'publish_arm_shape needs {error.name}, which is not installed: '
                             'apt-get install ros-jazzy-visualization-msgs, or pip install it'
                             ) from None
    return ArmShape(node, model)


def transforms(node):
    """Return the outlet of /tf; raise ParameterError if its messages are not installed."""
    try:
        from timo_sim.ros.transforms import Transforms
        return Transforms(node)
    except ModuleNotFoundError as error:
        raise ParameterError(f'publish_tf needs {error.name}, which is not installed: apt-get '
                             'install ros-jazzy-tf2-msgs') from None


def interfaces(node):
    """Offer the services of simulation_interfaces, where that is installed."""
    if find_spec('simulation_interfaces') is not None:
        from timo_sim.ros.interfaces import Interfaces
        Interfaces(node)


def live(live_feed, scene, url, name):
    """
    Return what streams a running simulation to a viewer.

    Parameters
    ----------
    live_feed : function(Scene, str, str) -> object or None
        Makes it, see `SimNode`; None: nothing does.
    scene : Scene
    url : str
        Address of the viewer; empty: none.
    name : str
        Of the node.

    Raises
    ------
    ParameterError

    """
    if not url:
        return None
    if live_feed is None:
        raise ParameterError(f'rerun_live = {short(url)} needs the executable sim_node, which '
                             'brings the stream of the viewer')
    try:
        return live_feed(scene, url, name)
    except ModuleNotFoundError as error:
        raise ParameterError(f'rerun_live needs {error.name}, which is not installed: '
                             'pip install timo_sim[view]') from None
    except ValueError as error:
        raise ParameterError('rerun_live must be the address of a viewer of rerun, got '
                             f'{short(url)}: {error}') from None
