# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Tools for compiled code: decorators, lanes, packed constants, a store of machine code on disk.

This package may import numba, NumPy and small libraries, and nothing of timo_sim.
"""

try:
    import numba  # noqa: F401
except Exception as error:  # of any kind: numba does not check what it reads
    raise ImportError('numba cannot be imported with its settings, NUMBA_* of the environment or '
                      '.numba_config.yaml in the working directory: '
                      + ' '.join(str(error).split())) from error
