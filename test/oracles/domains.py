# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""DDS domains of tests and benchmarks, so that their nodes do not see each other."""

from contextlib import suppress
import fcntl
import os
from pathlib import Path
import random
import tempfile


def own_domain():
    """Return a DDS domain that no other test or benchmark uses until this process ends."""
    for domain in random.sample(range(1, 101), 100):
        path = Path(tempfile.gettempdir()) / f'timo_sim_domain_{domain}'
        with suppress(OSError):
            fcntl.flock(os.open(path, os.O_CREAT | os.O_RDWR), fcntl.LOCK_EX | fcntl.LOCK_NB)
            return domain
    raise RuntimeError('every DDS domain is in use by other tests or benchmarks')
