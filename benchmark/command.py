"""What all commands here share: help that says what a module does, and `--quick`."""

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
        What is said about `--quick`, for a module that has it.

    Returns
    -------
    argparse.ArgumentParser

    """
    result = argparse.ArgumentParser(prog=f'python -m {spec.name.removesuffix(".__main__")}',
                                     description=words.strip().split('\n\n')[0])
    if quick:
        result.add_argument('--quick', action='store_true', help=quick)
    return result
