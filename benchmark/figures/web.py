# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Draws doc/web.png: the page of `export-web` in Chromium, after steps of its closed loop."""

from pathlib import Path
import tempfile
import time

from PIL import Image

from benchmark import ROOT
from benchmark.browser import opened
from timo_sim.export.web import export_web

_WIDTH, _HEIGHT = 1000, 1420
_SEEN = 0, 0, 985, 1195  # without the bar that scrolls, and without half a row of controls
# A step as it is, then a shaped one back, both seen.
_BEGIN = """
byId('loads').click(); byId('reset').click(); byId('unshaped').click(); byId('forth').click();
"""
_BACK = "byId('shaped').click(); byId('back').click()"


def main():
    """Draw it."""
    path = ROOT / 'doc' / 'web.png'
    with tempfile.TemporaryDirectory() as folder:
        page = export_web({'paper': 'paper'}, Path(folder, 'arm.html'))
        with opened('chromium', Path(folder, 'profile')) as window:
            window.open(page)
            window.call('POST', '/window/rect', width=_WIDTH, height=_HEIGHT)
            window.until('return scene && values.time > 0.2')
            window.run(_BEGIN)
            window.until('return values.time > 5')
            window.run(_BACK)
            window.until('return values.time > 9')
            window.run("byId('run').click()")
            time.sleep(0.5)
            window.picture(path)
    seen = Image.open(path).convert('RGB').crop(_SEEN)
    # Also the colours of thin lines.
    seen.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        path, optimize=True)


if __name__ == '__main__':
    main()
