# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What written pages share: the machine they were measured on, and Markdown tables."""

import os
import platform

import numba
import numpy as np
import scipy

import timo_sim


def machine():
    """Return what a benchmark was measured on: processor, cores and versions by name."""
    try:
        with open('/proc/cpuinfo', encoding='utf-8') as file:
            model = next(line.split(':')[1].strip() for line in file if 'model name' in line)
    except (OSError, StopIteration):
        model = platform.processor()
    return {'processor': model, 'cores': os.cpu_count(), 'machine': platform.machine(),
            'python': platform.python_version(), 'numpy': np.__version__,
            'scipy': scipy.__version__, 'numba': numba.__version__,
            'timo_sim': timo_sim.__version__}


def table(header, rows):
    """Return a Markdown table."""
    lines = [header, ['---'] * len(header), *rows]
    return '\n'.join('| ' + ' | '.join(map(str, line)) + ' |' for line in lines)
