# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The subcommand `view`, which shows recorded runs."""

from functools import partial
import itertools

import click

from timo_sim.cli.commands import main


def unique_names(names):
    """Return names with a suffix _N after repeated ones, such that all differ."""
    found = []
    for place, name in enumerate(names):
        numbered = (f'{name}_{number}' for number in itertools.count(place))
        found.append(name if name not in found else next(
            each for each in numbered if each not in {*names, *found}))
    return found


@main.command()
@click.argument('files', nargs=-1, required=True, type=click.Path(exists=True))
@click.option('--save', type=click.Path(dir_okay=False), metavar='OUT.rrd',
              help='Write a file for rerun instead of opening it.')
@click.option('--png', type=click.Path(dir_okay=False), metavar='OUT.png',
              help='Draw a picture instead, without a screen.')
@click.option('--gif', type=click.Path(dir_okay=False), metavar='OUT.gif',
              help='Draw an animation instead, without rerun.')
@click.option('--at', type=float, metavar='SECONDS',
              help='Sim time of the picture of --png, and of a frame in the file of --save [s]; '
                   'by default the end.')
@click.option('--web', is_flag=True, help='Open the browser instead of a window.')
@click.option('--fps', type=click.FloatRange(min=0.0, min_open=True), default=30.0,
              show_default=True, help='Frames per second of the arm, in an animation at most 20; '
              'curves have all samples.')
@click.option('--node', metavar='NAME', help='Full name of the node, if a bag has several.')
def view(files, save, png, gif, at, web, fps, node):
    r"""
    Show recorded runs, laid over each other, in rerun or as an animation.

    FILES are logs of the node, or bags of its topics. Everything stays on this machine.

    \b
        timo_sim view run.mcap
        timo_sim view before.mcap after.mcap --png compared.png --at 1.81
        timo_sim view run.mcap --gif run.gif
    """
    wanted = save or png or web or not gif
    if at is not None and not (png or save):
        from timo_sim.scene.parameter import ParameterError
        raise ParameterError('--at is the time of a picture: it needs --png or --save')
    if wanted:
        import rerun  # noqa: F401  # if it is missing, fail before minutes are spent on reading
    if gif:
        from timo_sim.view.animation import animate
    from timo_sim.log.recording import Recording
    from timo_sim.view.track import of_recording
    recordings = [Recording(path, node) for path in files]
    names = unique_names([recording.path.stem for recording in recordings])
    makers = [partial(of_recording, *pair) for pair in zip(recordings, names)]
    if gif:
        animate([maker() for maker in makers], gif, fps)
    if wanted:
        from timo_sim.view.show import show_tracks
        show_tracks(makers, save, png, at, web, fps)
    for path in filter(None, (save, png, gif)):
        click.echo(f'{path} is written')
