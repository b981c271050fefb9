"""The executable `sim_node`: nothing heavy is imported before signals are taken care of."""

import sys

from timo_sim.ros.signals import StopRequest


def main(args=None):
    """
    Run the node until SIGINT, SIGTERM or the end of its duration.

    Returns
    -------
    int
        Exit code: 0 for a good end, 2 for a parameter that breaks its rule.

    """
    stop = StopRequest()
    try:
        from timo_sim.ros.process import run
        return run(stop, args)
    finally:
        stop.finished()


if __name__ == '__main__':
    sys.exit(main())
