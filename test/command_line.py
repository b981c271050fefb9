# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The command line in this process."""

from click.testing import CliRunner

from timo_sim.cli import main


def call(*arguments, code=0):
    """Call `timo_sim` with some arguments; return what it prints."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    # An exception that nobody has caught gives code 1, too.
    assert result.exit_code == code and isinstance(result.exception, SystemExit | None), (
        result.output, result.exception)
    return result.output
