"""The work of `timo_sim view`."""

from pathlib import Path
import sys
import tempfile

import click

from timo_sim.view.convert import write
from timo_sim.view.viewer import picture, show


def convert_and_show(makers, save=None, png=None, at=None, web=False, fps=30.0):
    """
    Convert tracks, and show them unless a file or picture is wanted.

    Parameters
    ----------
    makers : list of function() -> Track
    save, png : str, optional
        Files to write.
    at : float, optional
        Sim time of the picture [s]; by default the end.
    web : bool
        Whether to show it in the browser.
    fps : float
        See `write`.

    """
    with tempfile.TemporaryDirectory(prefix='timo_sim_') as folder:
        path = Path(save or Path(folder, 'run.rrd'))
        with click.progressbar(length=1000, label='converting', file=sys.stderr,
                               hidden=not sys.stderr.isatty()) as bar:
            tracks = []
            for maker in makers:
                tracks.append(maker())
                bar.update(500 // len(makers))
            write(tracks, path, fps, lambda done: bar.update(round(500 * done)), at)
        if save:
            click.echo(f'{path} is written')
        if png:
            picture(path, png, at)
            click.echo(f'{png} is drawn')
        if web or not (save or png):
            show(path, web)
