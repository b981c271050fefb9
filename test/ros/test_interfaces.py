# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Services and actions of simulation_interfaces; conftest.py skips this file without them."""

import math
import threading

from action_msgs.msg import GoalStatus
import pytest
from rclpy.action import ActionClient
from ros_process import PATIENCE
from sensor_msgs.msg import JointState
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import Result, SimulationState, SimulatorFeatures
from simulation_interfaces.srv import (
    GetSimulationState, GetSimulatorFeatures, ResetSimulation, SetSimulationState, StepSimulation)
from std_srvs.srv import SetBool, Trigger

from timo_sim.log.tables import Recording

STOPPED, PLAYING, PAUSED, QUITTING, NO_WORLD = (
    getattr(SimulationState, f'STATE_{name}')
    for name in ('STOPPED', 'PLAYING', 'PAUSED', 'QUITTING', 'NO_WORLD'))
OK, FAILED, UNSUPPORTED = (
    Result.RESULT_OK, Result.RESULT_OPERATION_FAILED, Result.RESULT_FEATURE_UNSUPPORTED)
ALREADY = SetSimulationState.Response.ALREADY_IN_TARGET_STATE
NO_TRANSITION = SetSimulationState.Response.STATE_TRANSITION_ERROR


class Simulator:
    """A client of simulation_interfaces."""

    def __init__(self, client):
        self.client = client
        self.states = client.collect(JointState, '/joint_states')
        kinds = {'get_simulator_features': GetSimulatorFeatures, 'step_simulation': StepSimulation,
                 'get_simulation_state': GetSimulationState, 'reset_simulation': ResetSimulation,
                 'set_simulation_state': SetSimulationState}
        self._call = {name: client.service(kind, f'/timo_sim/{name}')
                      for name, kind in kinds.items()}
        self._action = ActionClient(client, SimulateSteps, '/timo_sim/simulate_steps')
        assert self._action.wait_for_server(PATIENCE)
        client.wait_until_known_to('/timo_sim')

    def close(self):
        """Destroy the action's client, which would otherwise live on with the client node."""
        self._action.destroy()

    def features(self):
        return self._call['get_simulator_features']().features

    def state(self):
        response = self._call['get_simulation_state']()
        assert response.result.result == OK
        return response.state.state

    def set(self, state):
        result = self._call['set_simulation_state'](state=SimulationState(state=state)).result
        return result.result, result.error_message

    def step(self, steps):
        result = self._call['step_simulation'](steps=steps).result
        return result.result, result.error_message

    def reset(self, scope):
        result = self._call['reset_simulation'](scope=scope).result
        return result.result, result.error_message

    def begin(self, steps, feedback=lambda message: None):
        """Start the action; return its handle."""
        return self._wait(self._action.send_goal_async(
            SimulateSteps.Goal(steps=steps), feedback_callback=feedback))

    def end(self, goal):
        """Return status, code and text of an action at its end."""
        response = self._wait(goal.get_result_async())
        return response.status, response.result.result.result, response.result.result.error_message

    def cancel(self, goal):
        self._wait(goal.cancel_goal_async())

    def at(self, step):
        """Wait until the last published state is that after a step."""
        self.client.wait(lambda: self.states and self.steps() == step, f'step {step}')

    def steps(self):
        """Return the step of the last state that was received."""
        stamp = self.states[-1].header.stamp
        return 1000 * stamp.sec + stamp.nanosec // 1000000

    @staticmethod
    def _wait(future):
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(PATIENCE), 'no answer'
        return future.result()


@pytest.fixture
def run(start, client):
    """Return a function that starts a node and returns it with a client of its interfaces."""
    simulators = []

    def run(**parameters):
        node = start(**parameters)
        simulators.append(Simulator(client))
        return node, simulators[-1]
    yield run
    for simulator in simulators:
        simulator.close()


PAUSED_NODE = {'start_paused': True, 'rate.joint_states': 1000.0, 'initial.shaft_velocity': 1.0}


def test_states_and_their_transitions(run, client):
    node, simulator = run(**PAUSED_NODE)
    features = simulator.features()
    assert set(features.features) == {
        SimulatorFeatures.SIMULATION_RESET, SimulatorFeatures.SIMULATION_RESET_STATE,
        SimulatorFeatures.SIMULATION_STATE_GETTING, SimulatorFeatures.SIMULATION_STATE_SETTING,
        SimulatorFeatures.SIMULATION_STATE_PAUSE, SimulatorFeatures.STEP_SIMULATION_SINGLE,
        SimulatorFeatures.STEP_SIMULATION_MULTIPLE, SimulatorFeatures.STEP_SIMULATION_ACTION}
    assert 'the clock goes on' in features.custom_info and not features.spawn_formats

    assert simulator.state() == PAUSED and simulator.set(PAUSED)[0] == ALREADY
    assert simulator.set(PLAYING)[0] == OK and simulator.state() == PLAYING
    client.wait(lambda: simulator.states and simulator.steps() > 0, 'a step')
    assert simulator.step(1) == (FAILED, 'a step needs a paused simulation')
    assert simulator.set(STOPPED)[0] == OK and simulator.state() == STOPPED
    assert simulator.set(STOPPED)[0] == ALREADY
    # Stopped is the initial state again; the clock has gone on.
    client.wait(lambda: simulator.states[-1].position[2] == math.pi / 4 and simulator.steps() > 0,
                'the reset')
    assert simulator.set(PAUSED)[0] == OK and simulator.state() == PAUSED
    assert simulator.set(STOPPED)[0] == OK and simulator.step(1)[0] == OK
    assert simulator.state() == PAUSED
    code, text = simulator.set(NO_WORLD)
    assert code == UNSUPPORTED and text == 'state 4 cannot be set: there are no worlds to load'
    # The other services see the same simulation.
    assert client.service(SetBool, '/timo_sim/pause')(data=False).success
    assert simulator.state() == PLAYING and simulator.set(QUITTING)[0] == OK
    code, output = node.wait()
    assert code == 0, output
    assert len(Recording(node.log).resets) == 2


def test_steps_and_resets(run, client):
    node, simulator = run(**PAUSED_NODE)
    assert simulator.step(1)[0] == OK
    simulator.at(1)
    assert simulator.step(0)[0] == OK and simulator.step(249)[0] == OK
    simulator.at(250)
    first = {state.header.stamp.nanosec // 1000000: state for state in simulator.states}
    # The default scope is SCOPE_ALL.
    for scope in (ResetSimulation.Request.SCOPE_DEFAULT, ResetSimulation.Request.SCOPE_ALL,
                  ResetSimulation.Request.SCOPE_TIME, ResetSimulation.Request.SCOPE_SPAWNED,
                  ResetSimulation.Request.SCOPE_TIME | ResetSimulation.Request.SCOPE_STATE):
        code, text = simulator.reset(scope)
        assert code == UNSUPPORTED and text.startswith(
            f'scope must be 2, SCOPE_STATE, got {scope}: the clock goes on at a reset')
    assert simulator.reset(ResetSimulation.Request.SCOPE_STATE) == (OK, '')

    # The action does one step after the other, with the same bits.
    told = []
    goal = simulator.begin(250, lambda message: told.append(
        (message.feedback.completed_steps, message.feedback.remaining_steps)))
    assert simulator.end(goal) == (GoalStatus.STATUS_SUCCEEDED, OK, '')
    simulator.at(500)
    # A client misses some if it is slower than the steps, or already has the result.
    assert told == sorted(set(told)) and {done + left for done, left in told} == {250}
    again = {1000 * state.header.stamp.sec + state.header.stamp.nanosec // 1000000: state
             for state in simulator.states}
    for step in (1, 100, 250):
        assert again[250 + step].position == first[step].position
        assert again[250 + step].velocity == first[step].velocity


def test_an_action_is_canceled_or_aborted_and_others_are_served_meanwhile(run, client):
    node, simulator = run(**PAUSED_NODE)
    goal = simulator.begin(10**9)
    client.wait(lambda: simulator.states and simulator.steps() > 20, 'steps')
    assert simulator.state() == PAUSED
    simulator.cancel(goal)
    status, code, text = simulator.end(goal)
    assert (status, code) == (GoalStatus.STATUS_CANCELED, FAILED)
    done = int(text.removeprefix('canceled after ').removesuffix(f' of {10**9} steps'))
    simulator.at(done)

    goal = simulator.begin(10**9)
    assert client.service(SetBool, '/timo_sim/pause')(data=False).success
    assert simulator.end(goal) == (
        GoalStatus.STATUS_ABORTED, FAILED, 'a step needs a paused simulation')
    # The node ends while an action goes on.
    assert client.service(SetBool, '/timo_sim/pause')(data=True).success
    simulator.begin(10**9)
    code, output = node.end()
    assert code == 0 and 'Traceback' not in output, output


def test_after_a_divergence_only_stopping_helps(run, client):
    _, simulator = run(**{
        'integrator.step': 0.01, 'model.modes': 5, 'initial.shaft_velocity': 100.0,
        'initial.modal_rates': [20.0, 0.0, 0.0, 0.0, 0.0], 'record': False})
    client.wait(lambda: simulator.state() == PAUSED, 'the divergence')
    code, text = simulator.set(PLAYING)
    assert code == NO_TRANSITION and '~/reset is needed first' in text
    code, text = simulator.step(1)
    assert code == FAILED and '~/reset is needed first' in text
    assert simulator.set(STOPPED)[0] == OK and simulator.set(PLAYING)[0] == OK
    assert client.service(Trigger, '/timo_sim/reset')().success
