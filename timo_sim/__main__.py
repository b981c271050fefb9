# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""`python -m timo_sim`: the command `timo_sim`."""

from timo_sim.cli import main

main(prog_name='timo_sim')
