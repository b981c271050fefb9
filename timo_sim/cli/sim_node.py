# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The executable `sim_node`: signal handlers come before large imports."""

import os
import signal
import sys

_HELP = """usage: sim_node [--help] [--ros-args ...]

The ROS 2 node timo_sim. Parameters are set by --ros-args:

  sim_node --ros-args --params-file my_scene.yaml -p name:=value

`ros2 param describe` and the file config/paper.yaml say what each parameter means."""


class StopRequest:
    """
    Turns SIGINT, SIGTERM and SIGHUP (unless ignored, by nohup) into a clean end, with code 0.

    Until the node is `running` there is nothing to clean up: the process exits at once. Then its
    loop sees `set`.
    """

    def __init__(self) -> None:
        self.set = self.running = False
        self._numbers = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            self._numbers.append(signal.SIGHUP)
        for number in self._numbers:
            signal.signal(number, self._handle)

    def finished(self) -> None:
        """Ignore signals: the interpreter's shutdown undoes Python's handlers, but not SIG_IGN."""
        for number in self._numbers:
            signal.signal(number, signal.SIG_IGN)

    def _handle(self, number, frame):
        self.set = True
        if not self.running:
            os._exit(0)


def main(args: list[str] | None = None) -> int:
    """Run the node with these arguments or the process's; return the exit code, as `run` does."""
    _open_streams()
    stop = StopRequest()
    given = sys.argv[1:] if args is None else args
    if given in (['-h'], ['--help']):
        print(_HELP)
        return 0
    try:
        from timo_sim.ros.process import run
        return run(stop, args)
    except ModuleNotFoundError as error:
        if error.name != 'rclpy':
            raise
        print('timo_sim: sim_node needs ROS 2: source an installed one, or pip install '
              'timo_sim[ros]; timo_sim simulate needs none', file=sys.stderr)
        return 1
    except ImportError as error:
        print(f'timo_sim: {error}', file=sys.stderr)
        return 1
    finally:
        stop.finished()


def _open_streams():
    # If a standard stream is closed, a file that is opened later would get its number.
    for number, name in enumerate(('stdin', 'stdout', 'stderr')):
        try:
            os.fstat(number)
        except OSError:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), 'w' if number else 'r'))


if __name__ == '__main__':
    sys.exit(main())
