# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The services ~/pause, ~/reset and ~/step: those of std_srvs."""

from std_srvs.srv import SetBool, Trigger


class NotNow(Exception):
    """The simulation is in a state in which it does not do what is asked; the text says why."""


def offer_services(node):
    """Offer a node's own `pause`, `reset` and `step`, which return texts or raise NotNow."""
    _offer(node, SetBool, '~/pause', lambda request: node.pause(request.data))
    _offer(node, Trigger, '~/reset', lambda request: node.reset())
    _offer(node, Trigger, '~/step', lambda request: node.step())


def _offer(node, kind, name, operation):
    def answer(request, response):
        try:
            response.message = operation(request)
            response.success = True
        except NotNow as reason:
            response.message = str(reason)
        return response
    node.create_service(kind, name, answer)
