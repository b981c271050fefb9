"""
Which loop drives the node: CPU and jitter of three ways to tick at 1 kHz, measured in one run.

    make benchmark-loop

Each variant is the real node with the paper's scene, log off, in a process of its own, alone and
then with another process that subscribes to every topic at 1 kHz and commands at 1 kHz. The order
is rotated over the rounds; the table shows the median of the rounds.
"""

import argparse
import json
import os
from pathlib import Path
import platform
import signal
import statistics
import subprocess
import sys
import threading
import time

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
VARIANTS = ['deadline loop, executor in a thread', 'deadline loop, EventsExecutor in a thread',
            'rclpy timer']
RATES = [f'rate.{topic}:=1000.0'
         for topic in ('joint_states', 'tip_deflection', 'tip_pose', 'carrier_pose')]


def serve(variant, seconds):
    """Run one variant in this process and print what it cost."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.experimental import EventsExecutor
    from rclpy.signals import SignalHandlerOptions
    from timo_sim.ros.node import SimNode
    from timo_sim.ros.process import SWITCH_INTERVAL

    class Stop:
        set = False

    class Timed(SimNode):
        def _tick(self):
            self.times.append(time.monotonic())
            return super()._tick()

    sys.setswitchinterval(SWITCH_INTERVAL)
    arguments = ['--ros-args', '--params-file', str(ROOT / 'config' / 'paper.yaml'),
                 '-p', 'record:=false']
    for rate in RATES:
        arguments += ['-p', rate]
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    stop = Stop()
    node = Timed(stop)
    node.times = []

    def end():
        node.times.clear()
        time.sleep(1.0)  # discovery
        node.times.clear()
        start = time.process_time()
        time.sleep(seconds)
        intervals = np.diff(node.times) * 1e6
        print(json.dumps({
            'cpu': 100 * (time.process_time() - start) / seconds,
            'hz': len(intervals) / seconds,
            'interval': np.percentile(intervals, [50, 99, 100]).tolist(),
            'overruns': node._pace.overruns}), flush=True)
        os._exit(0)  # the figures are out, and nothing here needs an end

    threading.Thread(target=end, daemon=True).start()
    node.open()
    if variant == 'rclpy timer':
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        now = time.monotonic()
        node._pace.start(0, now)
        node._reported = now, 0

        def tick():
            with node._lock:
                node._tick()

        node.create_timer(1e-3, tick)
        executor.spin()
    events = 'EventsExecutor' in variant
    executor = EventsExecutor() if events else SingleThreadedExecutor()
    executor.add_node(node)

    def spin():
        while True:  # spin() of this executor does not work in rclpy 7.1
            executor.spin_once(timeout_sec=0.1)

    threading.Thread(target=spin if events else executor.spin, daemon=True).start()
    node.run()


def listen():
    """Subscribe to everything and command at 1 kHz until a signal ends this process."""
    from geometry_msgs.msg import PoseStamped, Vector3Stamped
    import rclpy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64
    rclpy.init()
    node = rclpy.create_node('listener')
    for kind, topic in ((JointState, '/joint_states'), (PoseStamped, '/timo_sim/tip_pose'),
                        (PoseStamped, '/timo_sim/carrier_pose'),
                        (Vector3Stamped, '/timo_sim/tip_deflection')):
        node.create_subscription(kind, topic, lambda data: None, 10, raw=True)
    publisher = node.create_publisher(Float64, '/timo_sim/motor_torque', 10)
    node.create_timer(1e-3, lambda: publisher.publish(Float64(data=0.0)))
    rclpy.spin(node)


def measure(variant, listened, seconds):
    """Run a variant in a process of its own."""
    listener = None
    if listened:
        listener = subprocess.Popen([sys.executable, __file__, '--listen'],
                                    stderr=subprocess.DEVNULL)
        time.sleep(1.5)
    try:
        output = subprocess.run(
            [sys.executable, __file__, '--serve', variant, '--seconds', str(seconds)], check=True,
            capture_output=True, text=True).stdout
    finally:
        if listener:
            listener.send_signal(signal.SIGKILL)
            listener.wait()
    return json.loads(output.splitlines()[-1])


def main():
    """Measure all variants and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--serve')
    parser.add_argument('--listen', action='store_true')
    parser.add_argument('--seconds', type=float, default=5.0)
    parser.add_argument('--rounds', type=int, default=3)
    options = parser.parse_args()
    if options.serve:
        return serve(options.serve, options.seconds)
    if options.listen:
        return listen()
    print(f'{platform.processor() or platform.machine()}, Python {platform.python_version()}, '
          f'{options.rounds} rounds of {options.seconds:g} s\n')
    print('| loop | with a client | Hz | CPU % | interval p50 / p99 / max us | overruns |')
    print('|---|---|---|---|---|---|')
    for listened in (False, True):
        results = {variant: [] for variant in VARIANTS}
        for turn in range(options.rounds):
            for variant in VARIANTS[turn % 3:] + VARIANTS[:turn % 3]:
                results[variant].append(measure(variant, listened, options.seconds))
        for variant, rows in results.items():
            def median(name, rows=rows):
                return statistics.median(row[name] for row in rows)
            intervals = [statistics.median(row['interval'][k] for row in rows) for k in range(3)]
            print(f'| {variant} | {"yes" if listened else "no"} | {median("hz"):.1f} '
                  f'| {median("cpu"):.1f} | {" / ".join(f"{value:.0f}" for value in intervals)} '
                  f'| {median("overruns"):.0f} |')


if __name__ == '__main__':
    main()
