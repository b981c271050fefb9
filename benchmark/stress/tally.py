# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How often a fault was tried and survived; a disk of which little is free."""

from contextlib import contextmanager
import subprocess


class Tally:
    """How often a fault was tried and survived, and what the first failure was."""

    def __init__(self, what):
        self._what, self._tried, self._survived, self._first = what, 0, 0, None

    @contextmanager
    def trial(self, which):
        """Count what is done in the context as survived unless it raises."""
        self._tried += 1
        try:
            yield
        except Exception as error:
            text = f'{which}: {type(error).__name__}: {error}'
            self._first = self._first or ' '.join(text.split())
        else:
            self._survived += 1

    def row(self, remark=''):
        """Return the row of the table."""
        return self._what, self._tried, self._survived, self._first or remark


def ensure(condition, text):
    """Raise an error if a condition does not hold."""
    if not condition:
        raise RuntimeError(text)


@contextmanager
def small_disk(folder, size):
    """Yield a folder on a disk of its own, of a size [B], or None where one may not mount."""
    mounted = folder / 'disk'
    mounted.mkdir()
    if subprocess.run(['mount', '-t', 'tmpfs', '-o', f'size={size},mode=0700', 'tmpfs', mounted],
                      capture_output=True).returncode:
        yield None
        return
    try:
        yield mounted
    finally:
        subprocess.run(['umount', '-l', mounted], check=True)
