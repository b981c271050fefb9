# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The version of the package, which is stated here and in package.xml."""

__version__ = '0.3.0'
