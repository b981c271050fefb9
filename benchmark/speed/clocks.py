# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Where time goes: clocks around functions, to say what limits a figure."""

from contextlib import contextmanager, ExitStack
import functools
import time
from unittest import mock


@contextmanager
def clocks(**places):
    """
    Add up the time spent in functions, yield it by name [s].

    Parameters
    ----------
    **places : tuple of (object, str, ...)
        A class or module, and the names of functions there, which may call each other.

    """
    spent, depth = dict.fromkeys(places, 0.0), dict.fromkeys(places, 0)

    def clocked(name, function):
        @functools.wraps(function)
        def run(*arguments, **options):
            start = time.perf_counter()
            depth[name] += 1
            try:
                return function(*arguments, **options)
            finally:
                depth[name] -= 1
                if not depth[name]:
                    spent[name] += time.perf_counter() - start
        return run

    with ExitStack() as stack:
        for name, (owner, *functions) in places.items():
            for function in functions:
                stack.enter_context(mock.patch.object(
                    owner, function, clocked(name, getattr(owner, function))))
        yield spent
