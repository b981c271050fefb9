# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Export of a scene as code that needs no Python: `export_c`, `export_fmu`, ros2_control, a page.

The object file holds the machine code of the same entry points that `Simulator` calls, for the
sizes of the scene, and its constants; `prebuilt` makes code for an installation. This package may
import `control` and what is below it.
"""
