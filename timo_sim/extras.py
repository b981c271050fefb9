# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Optional packages, and the extras of this package that install them."""

from collections.abc import Iterator
from contextlib import contextmanager
import sys

_EXTRAS = {
    'PIL': 'plot', 'control': 'control', 'cupy': 'cuda', 'distributed': 'cluster',
    'gymnasium': 'rl', 'matplotlib': 'plot', 'pandas': 'pandas', 'pyarrow': 'sweep',
    'rclpy': 'ros', 'rerun': 'view', 'rerun_cli': 'view'}


class MissingPackage(ModuleNotFoundError):
    """An optional package is not installed; the text says how to install it."""


@contextmanager
def optional() -> Iterator[None]:
    """Raise MissingPackage where an import inside of this context fails."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in _EXTRAS:
            raise
        raise MissingPackage(
            f'{error.name} is missing: in a clone of timo_sim, {sys.executable} -m pip install '
            f"-e '.[{_EXTRAS[error.name]}]'", name=error.name) from None
