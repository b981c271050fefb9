# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Drives pages in the browsers that are installed, by the protocol WebDriver."""

from base64 import b64decode
from contextlib import contextmanager
import json
import shutil
import socket
import subprocess
import time
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

# Programs of a browser, its driver, and its options in the words of WebDriver.
BROWSERS = {
    'chromium': ('chromedriver', 'goog:chromeOptions', [
        '--headless=new', '--no-sandbox', '--disable-gpu', '--disable-background-networking',
        '--disable-component-update']),
    'firefox': ('geckodriver', 'moz:firefoxOptions', ['-headless'])}
BROWSERS['google-chrome'] = BROWSERS['chromium']
# Options by which a browser prefers dark pages.
_DARK: dict[str, dict[str, Any]] = {
    'chromium': {'args': ['--blink-settings=preferredColorScheme=0']},
    'firefox': {'prefs': {'layout.css.prefers-color-scheme.content-override': 0}}}
_DARK['google-chrome'] = _DARK['chromium']


def missing(name):
    """Return which programs of a browser are not on the PATH."""
    return [each for each in (name, BROWSERS[name][0]) if not shutil.which(each)]


class Window:
    """A window of a browser."""

    def __init__(self, address, capabilities):
        self._address = address
        opened = self.call('POST', '', capabilities={'alwaysMatch': capabilities})
        self._address += '/' + opened['sessionId']

    def call(self, method, path, **body):
        data = json.dumps(body).encode() if method == 'POST' else None
        try:
            with urlopen(Request(self._address + path, data, {'Content-Type': 'application/json'},
                                 method=method), timeout=60.0) as answer:
                return json.load(answer)['value']
        except HTTPError as error:
            raise RuntimeError(json.load(error)['value']['message']) from None

    def open(self, path, width=1300):
        self.call('POST', '/window/rect', width=width, height=1100)
        self.call('POST', '/url', url=path.as_uri())

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

    def act(self, kind, *actions, **parameters):
        """Do what a 'key' or a 'pointer' does, one action after another."""
        source = {'type': kind, 'id': kind, 'actions': actions}
        if parameters:
            source['parameters'] = parameters
        self.call('POST', '/actions', actions=[source])

    def picture(self, path):
        time.sleep(0.5)
        path.write_bytes(b64decode(self.call('GET', '/screenshot')))


@contextmanager
def opened(name, folder, dark=False):
    """Give a Window of a browser, whose profile is in a folder."""
    driver, options, arguments = BROWSERS[name]
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        port = free.getsockname()[1]
    own = {**(_DARK[name] if dark else {}), 'binary': shutil.which(name)}
    own['args'] = [*arguments, *own.get('args', []), *(
        [f'--user-data-dir={folder}'] if name != 'firefox' else [])]
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
