# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Services and action of simulation_interfaces, versions 1.5 (Jazzy) to 2.1.

What a service cannot do is refused by a result code of the standard and a text. Services of which
nothing can be done are not there.
"""

import asyncio
from functools import partial
import math
import re
from typing import Any

from geometry_msgs.msg import Accel, Point, Pose, Quaternion, Twist, Vector3
import numpy as np
from rclpy.action import ActionServer, CancelResponse
from simulation_interfaces import srv
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import (
    Bounds, EntityCategory, EntityState, Result, SimulationState, SimulatorFeatures)

from timo_sim.model.layout import place
from timo_sim.ros.loop import StateError
from timo_sim.version import __version__

# The features of each service, by its type.
_SERVICES = {
    'GetSimulatorFeatures': (),
    'GetSimulationState': ('SIMULATION_STATE_GETTING',),
    'SetSimulationState': ('SIMULATION_STATE_SETTING', 'SIMULATION_STATE_PAUSE'),
    'StepSimulation': ('STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE',
                       'STEP_SIMULATION_ACTION'),
    'ResetSimulation': ('SIMULATION_RESET', 'SIMULATION_RESET_STATE'),
    'GetEntities': ('ENTITY_CATEGORIES',),
    'GetEntityInfo': ('ENTITY_INFO_GETTING',),
    'GetEntityState': ('ENTITY_STATE_GETTING',),
    'GetEntitiesStates': (),
}
_CLOCK = 'the clock goes on at a reset'
_ENTITIES = {
    'carrier': 'the carrier with the motor, which moves along world x and y without turning',
    'end_effector': 'the end effector at the tip of the arm, with what it carries'}
_FAILED = Result.RESULT_OPERATION_FAILED
_TIME = 1e-6  # over which the tip's velocity is differentiated [s]


class _RefusalError(Exception):
    """A request that is refused for a reason, with the code of its result."""

    def __init__(self, reason, code=Result.RESULT_FEATURE_UNSUPPORTED):
        super().__init__(reason)
        self.code = code


class Interfaces:
    """Offers a SimNode to clients that speak simulation_interfaces."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._stopped_at: int | None = None  # step at which the simulation was stopped
        for name in _SERVICES:
            service = re.sub('(?<=.)([A-Z])', r'_\1', name).lower()
            node.create_service(getattr(srv, name), f'~/{service}',
                                partial(self._answer, getattr(self, f'_{service}')))
        self._action = ActionServer(
            node, SimulateSteps, '~/simulate_steps', self._simulate,
            cancel_callback=lambda goal: CancelResponse.ACCEPT)

    def _answer(self, handle, request, response):
        code: int = Result.RESULT_OK
        reason: Any = ''
        try:
            handle(request, response)
        except _RefusalError as error:
            code, reason = error.code, error
        except StateError as error:
            code = getattr(response, 'STATE_TRANSITION_ERROR', Result.RESULT_INCORRECT_STATE)
            reason = error
        if hasattr(response, 'result'):
            response.result = Result(result=code, error_message=str(reason))
        return response

    # The simulation.

    def _get_simulator_features(self, request, response):
        response.features.features = [getattr(SimulatorFeatures, feature)
                                      for features in _SERVICES.values() for feature in features]
        response.features.custom_info = f'timo_sim {__version__}; {_CLOCK}'

    def _state(self):
        if not self._node.paused:
            return SimulationState.STATE_PLAYING
        return (SimulationState.STATE_STOPPED if self._node.steps == self._stopped_at
                else SimulationState.STATE_PAUSED)

    def _get_simulation_state(self, request, response):
        response.state.state = self._state()

    def _set_simulation_state(self, request, response):
        target = request.state.state
        if target == self._state():
            raise _RefusalError('', response.ALREADY_IN_TARGET_STATE)
        if target in (SimulationState.STATE_PLAYING, SimulationState.STATE_PAUSED):
            self._node.pause(target == SimulationState.STATE_PAUSED)
            self._stopped_at = None
        elif target == SimulationState.STATE_STOPPED:
            self._node.pause(True)
            self._node.reset()
            self._stopped_at = self._node.steps
        elif target == SimulationState.STATE_QUITTING:
            self._node.quit()
        else:
            raise _RefusalError(f'state {target} cannot be set: there is always a world')

    def _step_simulation(self, request, response):
        try:
            self._node.step(request.steps)
        except StateError as reason:
            raise _RefusalError(reason, _FAILED) from None

    def _reset_simulation(self, request, response):
        scope = request.scope or request.SCOPE_ALL
        if scope & (request.SCOPE_STATE | request.SCOPE_TIME) != request.SCOPE_STATE:
            raise _RefusalError(f'scope must be SCOPE_STATE, {request.SCOPE_STATE}, without '
                                f'SCOPE_TIME, {request.SCOPE_TIME}: {_CLOCK}; got {scope}')
        self._node.reset()

    async def _simulate(self, goal):
        """Do the steps of an action one by one; other callbacks are served in between."""
        total = goal.request.steps
        try:
            for done in range(total):
                if goal.is_cancel_requested:
                    goal.canceled()
                    return SimulateSteps.Result(result=Result(
                        result=_FAILED, error_message=f'canceled after {done} of {total} steps'))
                self._node.step(1)
                goal.publish_feedback(SimulateSteps.Feedback(
                    completed_steps=done + 1, remaining_steps=total - done - 1))
                self._node.executor.wake()
                await asyncio.sleep(0)  # the executor's other callbacks have their turn
        except StateError as reason:
            goal.abort()
            return SimulateSteps.Result(result=Result(result=_FAILED, error_message=str(reason)))
        goal.succeed()
        return SimulateSteps.Result(result=Result(result=Result.RESULT_OK))

    # Entities.

    def _get_entities(self, request, response):
        filters = request.filters
        # A regular expression may take re, which cannot be interrupted, longer than a life.
        if (filters.tags.tags or filters.bounds.type != Bounds.TYPE_EMPTY
                or filters.filter not in ('', *_ENTITIES)):
            raise _RefusalError('entities have no tags and no bounds, and filter must be empty or '
                                f'one of {", ".join(_ENTITIES)}')
        wanted = {each.category for each in filters.categories} or {EntityCategory.CATEGORY_ROBOT}
        response.entities = [name for name in _ENTITIES if filters.filter in ('', name)
                             and EntityCategory.CATEGORY_ROBOT in wanted]

    def _get_entities_states(self, request, response):
        self._get_entities(request, response)
        response.states = self._node.with_snapshot(
            lambda snapshot: [self._state_of(name, snapshot) for name in response.entities])

    def _get_entity_info(self, request, response):
        response.info.category.category = EntityCategory.CATEGORY_ROBOT
        response.info.description = _ENTITIES[_known(request.entity)]

    def _get_entity_state(self, request, response):
        response.state = self._node.with_snapshot(partial(self._state_of, _known(request.entity)))

    def _state_of(self, name, snapshot):
        """Return the state of an entity in world axes, an EntityState."""
        model, motion = snapshot.model, snapshot.motion
        if name == 'carrier':
            position, velocity = snapshot.joint_positions[:2], snapshot.joint_velocities[:2]
            acceleration = snapshot.joints.accelerations[0, :2].tolist()
            angle = turning = turning_rate = 0.0
        else:
            x, y, theta = snapshot.joint_positions
            along, across, rotation = snapshot.tip
            position, angle = place(x, y, theta, along, across), theta + rotation
            speeds, turned = model.velocities(motion[np.newaxis], model.tip_point)
            velocity, turning = speeds[0, 0].tolist(), float(turned[0, 0])
            flow = np.append(motion[model.size // 2:], snapshot.joints.accelerations)
            ahead, behind = (model.velocities((motion + time * flow)[np.newaxis], model.tip_point)
                             for time in (_TIME, -_TIME))
            acceleration = ((ahead[0] - behind[0])[0, 0] / (2.0 * _TIME)).tolist()
            turning_rate = float(ahead[1][0, 0] - behind[1][0, 0]) / (2.0 * _TIME)
        state = EntityState()
        state.header.stamp.sec, state.header.stamp.nanosec = snapshot.time
        state.header.frame_id = self._node.frames['world']
        state.pose = Pose(position=_xy(Point, position), orientation=Quaternion(
            z=math.sin(0.5 * angle), w=math.cos(0.5 * angle)))
        state.twist = Twist(linear=_xy(Vector3, velocity), angular=Vector3(z=turning))
        state.acceleration = Accel(linear=_xy(Vector3, acceleration),
                                   angular=Vector3(z=turning_rate))
        return state


def _known(entity):
    if entity not in _ENTITIES:
        raise _RefusalError(f'entity must be one of {", ".join(_ENTITIES)}, got {entity[:60]}',
                            Result.RESULT_NOT_FOUND)
    return entity


def _xy(kind, values):
    return kind(x=values[0], y=values[1])
