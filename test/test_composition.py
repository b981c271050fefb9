# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Each effect in one use, and each use with one effect; `make composition` tries all pairs."""

import pytest

from benchmark.composition import latin_square, try_cell


@pytest.mark.parametrize('use, effect', latin_square())
def test_an_effect_works_in_a_use(use, effect):
    found = try_cell(use, effect)
    assert found.state in ('works', 'without meaning'), found.text
