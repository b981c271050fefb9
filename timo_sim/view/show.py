# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Shows tracks in rerun's viewer, a child process bound to this machine; saves or draws them."""

from contextlib import closing
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import tempfile
import time

import rerun_cli
from tqdm import tqdm

from timo_sim.scene.files import whole_file
from timo_sim.scene.parameter import Parameter, ParameterError
from timo_sim.view.convert import write
from timo_sim.view.track import FPS

_AT = Parameter('--at', 0.0, 's', 'sim time of the picture')
_LOOPBACK = '127.0.0.1'
_PATIENCE = 300.0  # [s] until a viewer must have loaded a file: a longer wait is a hang
_OBEDIENCE = 5.0  # [s] until a viewer must have ended


class ViewerError(OSError):
    """The viewer does not start or does not answer."""


def show_tracks(makers, save=None, png=None, at=None, web=False, fps=30.0):
    """
    Convert tracks, and show them unless only a file or a picture is wanted.

    Parameters
    ----------
    makers : list of function() -> Track
    save, png : str, optional
        Paths of a rerun file (*.rrd) and of a picture to write.
    at : float, optional
        Sim time of the picture [s]; by default the end.
    web : bool
        Whether to show them in the browser.
    fps : float
        See `convert.write`.

    Raises
    ------
    ParameterError
        If a path or number breaks its rule, or the time is not in the runs.
    ViewerError
        If the viewer does not start or does not answer.

    """
    at, fps = at if at is None else _AT.check(at), FPS.check(fps)
    if save and not str(save).endswith('.rrd'):
        raise ParameterError(f'the path of --save, a rerun file, must end with .rrd, got {save}')
    if png and not os.access(Path(png).absolute().parent, os.W_OK):
        raise ParameterError(f'--png {png} cannot be written: its folder is missing or read-only')
    with tempfile.TemporaryDirectory(prefix='timo_sim_') as folder:
        path = Path(save or Path(folder, 'run.rrd'))
        with tqdm(total=1000, desc='converting', bar_format='{l_bar}{bar}', delay=1.0,
                  disable=None, leave=False) as bar:
            tracks = []
            for maker in makers:
                tracks.append(maker())
                bar.update(500 // len(makers))
            begin = min(track.ns[0] for track in tracks)
            end = max(track.ns[-1] for track in tracks)
            if at is not None and not begin <= round(1e9 * at) <= end:
                raise ParameterError(f'--at = {at:g} s is not in the run, which is from '
                                     f'{1e-9 * begin:g} to {1e-9 * end:g} s')
            write(tracks, path, fps, lambda done: bar.update(round(500 * done)), at)
        if png:
            picture(path, png, at)
        if web or not (save or png):
            _show(path, web)


def _show(path, web):
    """Show a rerun file until the viewer, in a window or the browser, is closed."""
    if not web and sys.platform == 'linux' and not (
            os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY')):
        raise ViewerError('there is no screen (DISPLAY is not set): add --web for a browser, '
                          '--png OUT.png for a picture or --save OUT.rrd for a file')
    port, web_port = _free_port(), _free_port()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    process = _viewer(subprocess.Popen, '--port', str(port), *(
        ['--web-viewer', '--web-viewer-port', str(web_port)] if web else []), path)
    try:
        if web:
            print(f'http://{_LOOPBACK}:{web_port}?url=rerun%2Bhttp://{_LOOPBACK}:{port}/proxy'
                  ' shows the run; Ctrl-C ends', flush=True)
        code = process.wait()
    except KeyboardInterrupt:
        stop(process)
        return
    if code not in (0, -signal.SIGTERM):
        raise ViewerError(f'the viewer of rerun ended with code {code}')


def picture(path, png, at=None, size=(1600, 1000), view=None):
    """
    Draw a rerun file to a picture, without a screen.

    Parameters
    ----------
    path, png : str or Path
    at : float, optional
        Sim time [s]; by default the end.
    size : tuple of int
        Width and height of the window.
    view : str, optional
        Beginning of the name of the only view to draw.

    Raises
    ------
    ViewerError

    """
    from rerun.experimental import ViewerClient
    port = _free_port()
    process = _viewer(subprocess.Popen, '--headless', '--port', str(port), '--window-size',
                      f'{size[0]}x{size[1]}', path, stderr=subprocess.PIPE, text=True)
    try:
        client = _until(
            lambda: ViewerClient.connect(f'rerun+http://{_LOOPBACK}:{port}/proxy'), process)
        state = _until(lambda: _loaded(client), process)
        end = max(line.end for line in state.recordings[0].timelines if line.name == 'sim_time')
        client.set_time('sim_time', duration=end * 1e-9 if at is None else at,
                        play_state='paused')
        only = next((each.view_id for each in state.views
                     if view is not None and each.name.startswith(view)), None)
        with whole_file(png) as part:
            before, now = b'at first', b''
            while now != before:  # the viewer moves its axes to their places gradually
                time.sleep(0.5)
                client.save_screenshot(str(part.absolute()), only)
                before, now = now, part.read_bytes() if part.exists() else b''
            if now[-8:-4] != b'IEND':
                raise ViewerError(f'{png} cannot be written to its end: is the disk full?')
    finally:
        stop(process)
        process.communicate()


def stop(process):
    """End a viewer; if it does not obey, kill it."""
    process.terminate()
    try:
        process.wait(_OBEDIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _viewer(start, *arguments, **options):
    # The binary itself: its Python wrapper, when ended, would leave it running.
    return start(
        [Path(rerun_cli.__file__).with_name('rerun'), '--bind', _LOOPBACK, *arguments],
        env={'RUST_LOG': 'error', **os.environ}, **options)


def _free_port():
    with closing(socket.socket()) as sock:
        sock.bind((_LOOPBACK, 0))
        return sock.getsockname()[1]


def _loaded(client):
    state = client.get_state()
    ready = not state.loading and state.views and state.recordings and any(
        line.name == 'sim_time' for line in state.recordings[0].timelines)
    return state if ready else None


def _until(condition, process):
    """Return what a condition finds; until a viewer answers, it raises RuntimeError or OSError."""
    deadline = time.monotonic() + _PATIENCE
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise ViewerError(_reason(process.stderr.read()))
        try:
            found = condition()
        except (RuntimeError, OSError):
            found = None
        if found:
            return found
        time.sleep(0.05)
    raise ViewerError(f'the viewer of rerun did not answer within {_PATIENCE:g} s')


def _reason(text):
    if 'adapter' in text or 'render context' in text:
        return ('pictures need a driver for graphics: apt-get install mesa-vulkan-drivers '
                'libvulkan1')
    return 'the viewer of rerun ended: ' + ' '.join(text.split())[-300:]
