"""What only some scenes ask for, and not every machine has: imported when it is asked for."""

from importlib.util import find_spec

from timo_sim.parameters import ParameterError, short


def arm_shape(node, formulation):
    """Return the outlet of ~/arm_shape; raise ParameterError if its messages are not installed."""
    try:
        from timo_sim.ros.arm_shape import ArmShape
    except ModuleNotFoundError as error:
        raise ParameterError(f'publish_arm_shape needs {error.name}, which is not installed: '
                             'apt-get install ros-jazzy-visualization-msgs, or pip install it'
                             ) from None
    return ArmShape(node, formulation)


def transforms(node):
    """Return the outlet of /tf; raise ParameterError if its messages are not installed."""
    try:
        from timo_sim.ros.transforms import Transforms
    except ModuleNotFoundError as error:
        raise ParameterError(f'publish_tf needs {error.name}, which is not installed: apt-get '
                             'install ros-jazzy-tf2-msgs') from None
    return Transforms(node)


def interfaces(node):
    """Offer the services of simulation_interfaces, where that is installed."""
    if find_spec('simulation_interfaces') is not None:
        from timo_sim.ros.interfaces import Interfaces
        Interfaces(node)


def live_feed(scene, url, name):
    """Return what streams to the viewer at an address, None for ''; or raise ParameterError."""
    if not url:
        return None
    try:
        from timo_sim.view.feed import Feed
        return Feed(scene, url, name)
    except ModuleNotFoundError as error:
        raise ParameterError(f'rerun_live needs {error.name}, which is not installed: '
                             'pip install timo_sim[view]') from None
    except ValueError as error:
        raise ParameterError('rerun_live must be the address of a viewer of rerun, got '
                             f'{short(url)}: {error}') from None
