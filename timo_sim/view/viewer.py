"""Rerun's viewer as a process of ours, bound to this machine; pictures of it."""

from contextlib import closing, contextmanager
import os
from pathlib import Path
import socket
import subprocess
import time

import rerun_cli

LOOPBACK = '127.0.0.1'
_PATIENCE = 60.0  # [s] until a viewer must have loaded a file


class ViewerError(OSError):
    """The viewer does not start or does not answer."""


def _command(*arguments):
    # The binary itself: its Python wrapper would leave it behind when ended.
    return [Path(rerun_cli.__file__).with_name('rerun'), '--bind', LOOPBACK, *arguments]


def show(path, web=False):
    """Show a rerun file until the viewer, in a window or the browser, is closed."""
    code = subprocess.call(_command('--port', 'auto', *(['--web-viewer'] if web else []), path))
    if code:
        raise ViewerError(f'the viewer of rerun ended with code {code}: without a screen, take '
                          '--png, --save or --web')


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
    with _headless(path, size) as client:
        state = _loaded(client)
        end = max(line.end for line in state.recordings[0].timelines if line.name == 'sim_time')
        client.set_time('sim_time', duration=end * 1e-9 if at is None else at,
                        play_state='paused')
        time.sleep(1.0)  # axes glide to their places
        only = next((each.view_id for each in state.views
                     if view is not None and each.name.startswith(view)), None)
        client.save_screenshot(str(Path(png).absolute()), only)


@contextmanager
def _headless(path, size):
    from rerun.experimental import ViewerClient
    port = _free_port()
    process = subprocess.Popen(
        _command('--headless', '--port', str(port), '--window-size', f'{size[0]}x{size[1]}',
                 path),
        env={**os.environ, 'RUST_LOG': 'error'}, stderr=subprocess.PIPE, text=True)
    try:
        _until(lambda: _listens(port), process)
        yield ViewerClient.connect(f'rerun+http://{LOOPBACK}:{port}/proxy')
    finally:
        process.terminate()
        process.communicate()


def _free_port():
    with closing(socket.socket()) as sock:
        sock.bind((LOOPBACK, 0))
        return sock.getsockname()[1]


def _listens(port):
    try:
        with socket.create_connection((LOOPBACK, port), 1.0):
            return True
    except OSError:
        return False


def _loaded(client):
    def state():
        found = client.get_state()
        ready = not found.loading and found.views and found.recordings and any(
            line.name == 'sim_time' for line in found.recordings[0].timelines)
        return found if ready else None
    return _until(state)


def _until(condition, process=None):
    deadline = time.monotonic() + _PATIENCE
    while time.monotonic() < deadline:
        try:
            found = condition()
        except RuntimeError:  # the viewer does not answer yet
            found = None
        if found:
            return found
        if process is not None and process.poll() is not None:
            raise ViewerError(_reason(process.stderr.read()))
        time.sleep(0.05)
    raise ViewerError(f'the viewer of rerun did not answer within {_PATIENCE:g} s')


def _reason(text):
    if 'adapter' in text or 'libvulkan' in text.lower():
        return ('pictures need a driver for graphics: apt-get install mesa-vulkan-drivers '
                'libvulkan1')
    return 'the viewer of rerun ended: ' + ' '.join(text.split())[-300:]
