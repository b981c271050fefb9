# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The page of `timo_sim export-web` in real browsers, `make browser`."""

from base64 import b64decode
from contextlib import contextmanager
import json
import os
from pathlib import Path
import shutil
import socket
import subprocess
import time
from urllib.error import URLError
from urllib.request import Request, urlopen

import pytest
from timo_sim.export.web import export_web

# Programs of a browser, its driver, and its options in the words of WebDriver.
BROWSERS = {
    'chromium': ('chromedriver', 'goog:chromeOptions', [
        '--headless=new', '--no-sandbox', '--disable-gpu', '--disable-background-networking',
        '--disable-component-update']),
    'firefox': ('geckodriver', 'moz:firefoxOptions', ['-headless'])}
BROWSERS['google-chrome'] = BROWSERS['chromium']


class Window:
    """A window of a browser, by the protocol WebDriver."""

    def __init__(self, address, capabilities):
        self._address = address
        opened = self.call('POST', '', capabilities={'alwaysMatch': capabilities})
        self._address += '/' + opened['sessionId']

    def call(self, method, path, **body):
        data = json.dumps(body).encode() if method == 'POST' else None
        with urlopen(Request(self._address + path, data, {'Content-Type': 'application/json'},
                             method=method), timeout=60.0) as answer:
            return json.load(answer)['value']

    def run(self, script, *arguments):
        # Scripts of Firefox's driver do not see what the page declares by `let` and `class`.
        text = f'(function() {{{script}}}).apply(null, {json.dumps(arguments)})'
        return self.call('POST', '/execute/sync', args=[text],
                         script='return (window.wrappedJSObject || window).eval(arguments[0])')

    def until(self, script, *arguments):
        """Return what a script returns when that is true, within a minute."""
        end = time.monotonic() + 60.0
        while not (found := self.run(script, *arguments)):
            assert time.monotonic() < end, script
            time.sleep(0.05)
        return found

    def picture(self, path, width):
        self.call('POST', '/window/rect', width=width, height=1100)
        time.sleep(0.5)
        path.write_bytes(b64decode(self.call('GET', '/screenshot')))


@contextmanager
def opened(name, folder):
    driver, options, arguments = BROWSERS[name]
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        port = free.getsockname()[1]
    own = {'args': [*arguments, *([f'--user-data-dir={folder}'] if name != 'firefox' else [])],
           'binary': shutil.which(name)}
    process = subprocess.Popen([driver, f'--port={port}'], stdout=subprocess.DEVNULL)
    window, end = None, time.monotonic() + 60.0
    try:
        while not window:
            try:
                window = Window(f'http://127.0.0.1:{port}/session', {options: own})
            except URLError:
                assert process.poll() is None and time.monotonic() < end
                time.sleep(0.1)
        yield window
    finally:
        if window:
            window.call('DELETE', '')
        process.terminate()
        process.wait()


@pytest.fixture(scope='module')
def page(tmp_path_factory):
    """Return a page of two scenes, which notes errors."""
    path = tmp_path_factory.mktemp('page') / 'arm.html'
    export_web({'paper': 'paper', 'arm': 'arm'}, path)
    note = ('<script>window.errors = []; addEventListener("error", e => errors.push(e.message));'
            'addEventListener("unhandledrejection", e => errors.push(String(e.reason)));'
            'console.error = (...texts) => errors.push(texts.join(" "));</script>')
    path.write_text(path.read_text().replace('<head>', f'<head>{note}'))
    return path


MOVE = """
const input = document.getElementById(arguments[0]);
input.value = arguments[1];
input.dispatchEvent(new Event('input'));
"""


@pytest.mark.parametrize('name', BROWSERS)
def test_page_is_driven(name, page, tmp_path):
    """A slider moves the tip, reset and the other scene work, a step is done; no error is seen."""
    missing = [each for each in (name, BROWSERS[name][0]) if not shutil.which(each)]
    if missing:
        pytest.skip(f'not on the PATH: {" and ".join(missing)}')
    with opened(name, tmp_path / 'profile') as window:
        window.call('POST', '/url', url=page.as_uri())
        window.until('return scene && values.time > 0.2')
        assert window.run('return values.estimated_tip_error') > 0.0
        window.run("document.getElementById('loads').click(); "
                   "document.getElementById('reset').click()")
        before = window.until('return values.time > 0.05 && [values.tip_x, values.tip_y]')
        window.run(MOVE, 'torque', 25)
        window.until('return Math.hypot(values.tip_x - arguments[0], values.tip_y - arguments[1])'
                     ' > 0.01', *before)
        line = window.run('return [drawnLine(1)[40], [arm.get("tip_x"), arm.get("tip_y")]]')
        assert line[0] == pytest.approx(line[1], abs=1e-12)
        window.run("document.getElementById('run').click(); "
                   "document.getElementById('reset').click()")
        assert window.run('return [values.time, values.tip_x, manual.torque]') == pytest.approx(
            [0.0, 2.0 * 0.5**0.5, 0.0])
        window.run("document.getElementById('shaped').click(); "
                   "document.getElementById('forth').click()")
        window.until('return values.time > 3 && '
                     'Math.abs(values.shaft - 0.25 * Math.PI - 0.2) < 0.02')
        for width in 1300, 400:
            window.picture(Path(os.environ.get('PICTURES', tmp_path)) / f'{name}_{width}.png',
                           width)
        window.run("const s = document.getElementById('scene'); s.value = 1; "
                   "s.dispatchEvent(new Event('change'))")
        window.until('return scene && scene.name === "arm" && values.time > 0.1')
        assert window.run('return errors') == []
