# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command line that all modules here share: help from their docstrings, and `--quick`."""

import argparse


def parser(spec, words, quick=None):
    """
    Return a parser of the command line of a module.

    Parameters
    ----------
    spec : ModuleSpec
        `__spec__` of the module.
    words : str
        Its docstring; the first paragraph is shown.
    quick : str, optional
        Help of `--quick`, for a module that has it.

    Returns
    -------
    argparse.ArgumentParser

    """
    result = argparse.ArgumentParser(prog=f'python -m {spec.name.removesuffix(".__main__")}',
                                     description=words.strip().split('\n\n')[0])
    if quick:
        result.add_argument('--quick', action='store_true', help=quick)
    return result
