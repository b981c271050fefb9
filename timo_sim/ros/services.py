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
