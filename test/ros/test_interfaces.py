# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Services and actions of simulation_interfaces; conftest.py skips this file without them."""

import math
import re
import threading

from action_msgs.msg import GoalStatus
import numpy as np
import pytest
from rclpy.action import ActionClient
from ros_process import PATIENCE, replayed
from sensor_msgs.msg import JointState
from simulation_interfaces import srv
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import (
    Bounds, EntityCategory, EntityFilters, Result, SimulationState, SimulatorFeatures, TagsFilter)
from simulation_interfaces.srv import ResetSimulation, SetSimulationState
from std_srvs.srv import SetBool, Trigger

STOPPED, PLAYING, PAUSED, QUITTING, NO_WORLD = (
    getattr(SimulationState, f'STATE_{name}')
    for name in ('STOPPED', 'PLAYING', 'PAUSED', 'QUITTING', 'NO_WORLD'))
OK, FAILED, UNSUPPORTED, NOT_FOUND = (
    getattr(Result, f'RESULT_{name}') for name in (
        'OK', 'OPERATION_FAILED', 'FEATURE_UNSUPPORTED', 'NOT_FOUND'))
ALREADY = SetSimulationState.Response.ALREADY_IN_TARGET_STATE
NO_TRANSITION = SetSimulationState.Response.STATE_TRANSITION_ERROR


class Simulator:
    """A client of simulation_interfaces."""

    def __init__(self, client):
        self.client, self._calls = client, {}
        self.states = client.collect(JointState, '/joint_states')
        self._action = ActionClient(client, SimulateSteps, '/timo_sim/simulate_steps')
        assert self._action.wait_for_server(PATIENCE)
        client.wait_until_known_to('/timo_sim')

    def close(self):
        """Destroy the action's client, which would otherwise live on with the client node."""
        self._action.destroy()

    def ask(self, name, **fields):
        """Return the response of a service by the name of its type."""
        if name not in self._calls:
            service = re.sub('(?<=.)([A-Z])', r'_\1', name).lower()
            self._calls[name] = self.client.service(getattr(srv, name), f'/timo_sim/{service}')
        return self._calls[name](**fields)

    def call(self, name, **fields):
        """Return code and text of the result of a service."""
        result = self.ask(name, **fields).result
        return result.result, result.error_message

    def features(self):
        return self.ask('GetSimulatorFeatures').features

    def state(self):
        response = self.ask('GetSimulationState')
        assert response.result.result == OK
        return response.state.state

    def set(self, state):
        return self.call('SetSimulationState', state=SimulationState(state=state))

    def step(self, steps):
        return self.call('StepSimulation', steps=steps)

    def reset(self, scope):
        return self.call('ResetSimulation', scope=scope)

    def entity(self, name):
        """Return the state of an entity."""
        response = self.ask('GetEntityState', entity=name)
        assert response.result.result == OK, response.result.error_message
        return response.state

    def begin(self, steps, feedback=lambda message: None):
        """Start the action; return its handle."""
        return self._wait(lambda: self._action.send_goal_async(
            SimulateSteps.Goal(steps=steps), feedback_callback=feedback))

    def end(self, goal):
        """Return status, code and text of an action at its end."""
        response = self._wait(goal.get_result_async)
        return response.status, response.result.result.result, response.result.result.error_message

    def cancel(self, goal):
        self._wait(goal.cancel_goal_async)

    def at(self, step):
        """Wait until the last published state is that after a step."""
        self.client.wait(lambda: self.states and self.steps() == step, f'step {step}')

    def steps(self):
        """Return the step of the last state that was received."""
        stamp = self.states[-1].header.stamp
        return 1000 * stamp.sec + stamp.nanosec // 1000000

    def _wait(self, call):
        """
        Call in the thread of the executor, and return what the future has at its end.

        rclpy drops an answer that another thread receives before the call returns.
        """
        done, task = threading.Event(), self.client.executor.create_task(call)
        task.add_done_callback(
            lambda task: task.result().add_done_callback(lambda _: done.set()))
        assert done.wait(PATIENCE), 'no answer'
        return task.result().result()


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
    assert set(features.features) == {getattr(SimulatorFeatures, name) for name in (
        'ENTITY_CATEGORIES', 'ENTITY_STATE_GETTING', 'ENTITY_INFO_GETTING', 'SIMULATION_RESET',
        'SIMULATION_RESET_STATE', 'SIMULATION_STATE_GETTING', 'SIMULATION_STATE_SETTING',
        'SIMULATION_STATE_PAUSE', 'STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE',
        'STEP_SIMULATION_ACTION')}
    assert 'the clock goes on at a reset' in features.custom_info and not features.spawn_formats

    assert simulator.state() == PAUSED and simulator.set(PAUSED)[0] == ALREADY
    assert simulator.set(PLAYING)[0] == OK and simulator.state() == PLAYING
    client.wait(lambda: simulator.states and simulator.steps() > 0, 'a step')
    assert simulator.step(1) == (FAILED, 'a step needs a paused simulation: pause it first')
    assert simulator.set(STOPPED)[0] == OK and simulator.state() == STOPPED
    assert simulator.set(STOPPED)[0] == ALREADY
    # The state is the initial one.
    client.wait(lambda: simulator.states[-1].position[2] == math.pi / 4, 'the state then')
    assert simulator.set(PAUSED)[0] == OK and simulator.state() == PAUSED
    assert simulator.set(STOPPED)[0] == OK and simulator.step(1)[0] == OK
    assert simulator.state() == PAUSED
    code, text = simulator.set(NO_WORLD)
    assert code == UNSUPPORTED and text == 'state 4 cannot be set: there is always a world'
    # The other services see the same simulation.
    assert client.service(SetBool, '/timo_sim/pause')(data=False).success
    assert simulator.state() == PLAYING and simulator.set(QUITTING)[0] == OK
    code, output = node.wait()
    assert code == 0, output
    replayed(node.log)


def test_steps_and_resets(run, client):
    node, simulator = run(**PAUSED_NODE)
    assert simulator.step(1)[0] == OK
    simulator.at(1)
    assert simulator.step(0)[0] == OK and simulator.step(249)[0] == OK
    code, text = simulator.step(2**31)
    assert code == FAILED and 'at most 100000 steps, got 2147483648' in text
    simulator.at(250)
    first = {state.header.stamp.nanosec // 1000000: state for state in simulator.states}
    scopes = ResetSimulation.Request  # the default is all
    for scope in (scopes.SCOPE_TIME, scopes.SCOPE_SPAWNED, scopes.SCOPE_DEFAULT, scopes.SCOPE_ALL,
                  scopes.SCOPE_TIME | scopes.SCOPE_STATE):
        code, text = simulator.reset(scope)
        assert code == UNSUPPORTED and 'scope must be SCOPE_STATE, 2, without' in text
    assert simulator.reset(scopes.SCOPE_STATE) == (OK, '')

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
        GoalStatus.STATUS_ABORTED, FAILED, 'a step needs a paused simulation: pause it first')
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


def vector(message, *more):
    return np.array([message.x, message.y, *more])


def test_entities_have_pose_twist_and_acceleration(run):
    """Against differences of the poses of three steps, and what is published."""
    node, simulator = run(**{**PAUSED_NODE, 'frame.world': 'map', 'sensor.tip_imu.position': 0.5,
                             'load.torque.piecewise.time': [0.0],
                             'load.torque.piecewise.value': [20.0]})
    simulator.step(200)
    poses, twists = ({'carrier': [], 'end_effector': []} for _ in range(2))
    for _ in range(3):
        response = simulator.ask('GetEntitiesStates')
        assert response.result.result == OK and response.entities == [*poses]
        for name, state in zip(response.entities, response.states):
            assert state == simulator.entity(name) and state.header.frame_id == 'map'
            at = state.pose.orientation
            poses[name].append(vector(state.pose.position, 2.0 * math.atan2(at.z, at.w)))
            twists[name].append(vector(state.twist.linear, state.twist.angular.z))
            if len(poses[name]) == 2:
                acceleration = vector(state.acceleration.linear, state.acceleration.angular.z)
                twists[name].append(acceleration)
        simulator.step(1)
    for name in poses:
        first, _, last = poses[name]
        before, now, acceleration, after = twists[name]
        # The error of a central difference is h^2/6 of the third derivative, some 1e3 m/s3.
        assert now == pytest.approx((last - first) / 0.002, abs=1e-3), name
        assert acceleration == pytest.approx((after - before) / 0.002, abs=0.02), name
        assert np.abs(acceleration[:2]).max() > 0.05
    simulator.at(203)
    # At the next step.
    state, shown = simulator.entity('carrier'), simulator.states[-1]
    assert list(vector(state.pose.position)) == shown.position[:2].tolist()
    assert list(vector(state.twist.linear)) == shown.velocity[:2].tolist()
    assert state.header.stamp == shown.header.stamp


def test_entities_are_listed_by_name_and_category(run):
    node, simulator = run(start_paused=True)
    assert simulator.ask('GetEntities').entities == ['carrier', 'end_effector']
    robot, human = (EntityCategory(category=getattr(EntityCategory, f'CATEGORY_{name}'))
                    for name in ('ROBOT', 'HUMAN'))
    for filters, names in (
            (EntityFilters(filter='end_effector'), ['end_effector']),
            (EntityFilters(categories=[human, robot], filter='carrier'), ['carrier']),
            (EntityFilters(categories=[human]), [])):
        response = simulator.ask('GetEntities', filters=filters)
        assert (response.result.result, response.entities) == (OK, names)
        assert simulator.ask('GetEntitiesStates', filters=filters).entities == names
    # The first would take Python's `re` some 25^25 steps.
    for filters in (EntityFilters(filter=25 * '(.*)' + '!'), EntityFilters(filter='ca(r|t)'),
                    EntityFilters(filter='('), EntityFilters(tags=TagsFilter(tags=['arm'])),
                    EntityFilters(bounds=Bounds(type=Bounds.TYPE_SPHERE))):
        assert simulator.call('GetEntities', filters=filters)[0] == UNSUPPORTED
        assert simulator.call('GetEntitiesStates', filters=filters)[0] == UNSUPPORTED
    info = simulator.ask('GetEntityInfo', entity='carrier').info
    assert info.category == robot and 'without turning' in info.description and not info.tags
    for name in ('GetEntityInfo', 'GetEntityState'):
        assert simulator.call(name, entity='base') == (
            NOT_FOUND, 'entity must be one of carrier, end_effector, got base')
