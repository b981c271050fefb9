# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Services and action of simulation_interfaces, which pause, reset and step as ~/pause etc. do."""

from typing import Any

from rclpy.action import ActionServer, CancelResponse
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import Result, SimulationState, SimulatorFeatures
from simulation_interfaces.srv import (
    GetSimulationState, GetSimulatorFeatures, ResetSimulation, SetSimulationState, StepSimulation)

from timo_sim.ros.loop import StateError
from timo_sim.version import __version__

_CLOCK = 'the clock goes on at a reset'
_FEATURES = [getattr(SimulatorFeatures, name) for name in (
    'SIMULATION_RESET', 'SIMULATION_RESET_STATE', 'SIMULATION_STATE_GETTING',
    'SIMULATION_STATE_SETTING', 'SIMULATION_STATE_PAUSE', 'STEP_SIMULATION_SINGLE',
    'STEP_SIMULATION_MULTIPLE', 'STEP_SIMULATION_ACTION')]


class _Turn:
    """A coroutine awaits this to give the executor's other callbacks their turn."""

    def __await__(self):
        yield


class Interfaces:
    """Offers a SimNode to clients that speak simulation_interfaces."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._stopped_at: int | None = None  # step at which the simulation was stopped
        for kind, name, answer in (
                (GetSimulatorFeatures, 'get_simulator_features', self._features),
                (GetSimulationState, 'get_simulation_state', self._get_state),
                (SetSimulationState, 'set_simulation_state', self._set_state),
                (StepSimulation, 'step_simulation', self._step),
                (ResetSimulation, 'reset_simulation', self._reset)):
            node.create_service(kind, f'~/{name}', answer)
        self._action = ActionServer(
            node, SimulateSteps, '~/simulate_steps', self._simulate,
            cancel_callback=lambda goal: CancelResponse.ACCEPT)

    def _features(self, request, response):
        response.features.features = _FEATURES
        response.features.custom_info = f'timo_sim {__version__}; {_CLOCK}'
        return response

    def _state(self):
        if not self._node.paused:
            return SimulationState.STATE_PLAYING
        return (SimulationState.STATE_STOPPED if self._node.steps == self._stopped_at
                else SimulationState.STATE_PAUSED)

    def _get_state(self, request, response):
        response.state.state = self._state()
        response.result.result = Result.RESULT_OK
        return response

    def _set_state(self, request, response):
        target = request.state.state
        if target == self._state():
            response.result.result = SetSimulationState.Response.ALREADY_IN_TARGET_STATE
            return response
        response.result.result = Result.RESULT_OK
        try:
            if target == SimulationState.STATE_PLAYING:
                self._node.pause(False)
            elif target == SimulationState.STATE_PAUSED:
                self._node.pause(True)
                self._stopped_at = None
            elif target == SimulationState.STATE_STOPPED:
                self._node.pause(True)
                self._node.reset()
                self._stopped_at = self._node.steps
            elif target == SimulationState.STATE_QUITTING:
                self._node.quit()
            else:
                response.result = Result(
                    result=Result.RESULT_FEATURE_UNSUPPORTED,
                    error_message=f'state {target} cannot be set: there are no worlds to load')
        except StateError as reason:
            response.result = Result(result=SetSimulationState.Response.STATE_TRANSITION_ERROR,
                                     error_message=str(reason))
        return response

    def _step(self, request, response):
        response.result = self._stepped(request.steps)
        return response

    def _stepped(self, count):
        try:
            self._node.step(count)
        except StateError as reason:
            return Result(result=Result.RESULT_OPERATION_FAILED, error_message=str(reason))
        return Result(result=Result.RESULT_OK)

    def _reset(self, request, response):
        state = ResetSimulation.Request.SCOPE_STATE
        if request.scope != state:  # SCOPE_DEFAULT is SCOPE_ALL
            response.result = Result(
                result=Result.RESULT_FEATURE_UNSUPPORTED,
                error_message=f'scope must be {state}, SCOPE_STATE, got {request.scope}: {_CLOCK}')
            return response
        self._node.reset()
        response.result.result = Result.RESULT_OK
        return response

    async def _simulate(self, goal):
        """Do the steps of an action one by one; other callbacks are served in between."""
        total, result = goal.request.steps, Result(result=Result.RESULT_OK)
        for done in range(total):
            if goal.is_cancel_requested:
                goal.canceled()
                return SimulateSteps.Result(result=Result(
                    result=Result.RESULT_OPERATION_FAILED,
                    error_message=f'canceled after {done} of {total} steps'))
            result = self._stepped(1)
            if result.result != Result.RESULT_OK:
                goal.abort()
                return SimulateSteps.Result(result=result)
            goal.publish_feedback(SimulateSteps.Feedback(
                completed_steps=done + 1, remaining_steps=total - done - 1))
            self._node.executor.wake()
            await _Turn()
        goal.succeed()
        return SimulateSteps.Result(result=result)
