# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The node's process: starts and ends ROS, and serves callbacks in a thread of their own."""

import gc
import os
from pathlib import Path
import sys
import threading
from typing import Any

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from timo_sim.ros.node import SimNode
from timo_sim.ros.private import Executor, RCLError
from timo_sim.scene.files import is_for, read_sections
from timo_sim.scene.parameters import ParameterError, short

# A thread that is ready waits this long before it asks another for the interpreter [s].
SWITCH_INTERVAL = 2e-4
# Time between two looks of the executor's thread whether it should end [s].
_POLL = 0.1
_PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
_USE_PROFILES = 'RMW_FASTRTPS_USE_QOS_FROM_XML'


def use_profiles() -> None:
    """
    Make Fast DDS read `fastdds.xml`, unless the user has Fast DDS profiles of their own.

    The file has settings that ROS 2 cannot express; other middlewares ignore it. Call this before
    rclpy is initialised; it changes this process's environment.
    """
    users = _PROFILES, 'FASTDDS_DEFAULT_PROFILES_FILE', _USE_PROFILES
    # Fast DDS reads a file of this name in the working directory by itself.
    if not (Path('DEFAULT_FASTRTPS_PROFILES.xml').exists()
            or any(name in os.environ for name in users)):
        os.environ.update({_PROFILES: str(Path(__file__).with_name('fastdds.xml')),
                           _USE_PROFILES: '1'})


def _refuse(error, code=2):
    print('timo_sim:', ' '.join(str(error).split()), file=sys.stderr)
    rclpy.try_shutdown()
    return code


def _warn_of_unused_file(node, file, sections):
    name = node.get_fully_qualified_name()
    names = [section for section, values in sections.items() if values]
    if not any(is_for(section, name) for section in names):
        others = f'; it has those of {short(", ".join(names), str)}' if names else ''
        node.get_logger().warning(f'{file} has no parameter for {name}{others}')


def run(stop: Any, args: list[str] | None) -> int:
    """
    Start ROS, run a SimNode until a StopRequest, end ROS; return the exit code.

    The code is 0, 1 if the middleware refuses, or 2 for a parameter that breaks its rule. `args`
    is the command line, by default that of the process.
    """
    sys.setswitchinterval(SWITCH_INTERVAL)
    done = threading.Event()

    def spin():
        while not done.is_set():  # EventsExecutor.spin() does not work in rclpy 7.1
            try:
                executor.spin_once(timeout_sec=_POLL)
            except ExternalShutdownException:
                stop.set = True
                return
            except Exception as error:  # one client's request must not end the node for all
                node.count_failure(error)

    use_profiles()
    given, files = sys.argv if args is None else args, {}
    try:
        for option, file in zip(given, given[1:]):
            if option == '--params-file' and Path(file).is_file():
                # This also refuses names that are there twice, which rcl accepts.
                files[file] = read_sections(file)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        for argument in remove_ros_args(args)[args is None:]:
            raise ParameterError(f'{argument!r} must be inside of --ros-args, as in '
                                 '--ros-args -p duration:=10.0; --help says more')
    except (ParameterError, RuntimeError, UnicodeError) as error:  # arguments, or a file
        return _refuse(error)
    try:
        node = SimNode(stop, files)
    except (ParameterError, NameValidationException, ParameterException) as error:
        return _refuse(error)
    except RCLError as error:  # the middleware refuses
        return _refuse(error, code=1)
    for file, sections in files.items():
        _warn_of_unused_file(node, file, sections)
    stop.running = True
    gc.freeze()  # objects made so far last: the collector need not scan them while ticking
    executor = Executor()
    executor.add_node(node)
    thread = threading.Thread(target=spin, name='executor', daemon=True)
    try:
        node.open()
        thread.start()
        node.run()
    finally:
        done.set()
        if thread.is_alive():
            thread.join()
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0
