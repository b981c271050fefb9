# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The page of `timo_sim export-web` in real browsers, `make browser`."""

from contextlib import contextmanager
import os
from pathlib import Path

from benchmark.browser import BROWSERS, missing, opened
import pytest
from timo_sim.export.web import export_web


@pytest.fixture(scope='module')
def page(tmp_path_factory):
    """Return a page of three scenes, which notes errors."""
    path = tmp_path_factory.mktemp('page') / 'arm.html'
    export_web({name: name for name in ('paper', 'arm', 'standing')}, path)
    note = ('<script>window.errors = []; addEventListener("error", e => errors.push(e.message));'
            'addEventListener("unhandledrejection", e => errors.push(String(e.reason)));'
            'console.error = (...texts) => errors.push(texts.join(" "));</script>')
    path.write_text(path.read_text().replace('<head>', f'<head>{note}'))
    return path


@contextmanager
def shown(name, page, folder, width, dark=False):
    """Give a window that shows the page, and see that there was no error."""
    if absent := missing(name):
        pytest.skip(f'not on the PATH: {" and ".join(absent)}')
    with opened(name, folder / 'profile', dark) as window:
        window.open(page, width)
        window.until('return scene && values.time > 0.2')
        yield window
        assert window.run('return errors') == []


def picture(window, folder, name):
    window.picture(Path(os.environ.get('PICTURES', folder)) / f'{name}.png')


def choose(window, number):
    window.run("const s = document.getElementById('scene'); s.value = arguments[0]; "
               "s.dispatchEvent(new Event('change'))", number)
    return window.until('return scene && byId("scene").value == arguments[0] && '
                        'scene.name === scenes[arguments[0]].name && values.time > 0.1 && '
                        'scene.name', number)


MOVE = """
const input = document.getElementById(arguments[0]);
input.value = arguments[1];
input.dispatchEvent(new Event('input'));
"""


@pytest.mark.parametrize('name', BROWSERS)
def test_page_is_driven(name, page, tmp_path):
    """A slider moves the tip, reset and other scenes work, a step is done; no error is seen."""
    with shown(name, page, tmp_path, 1300) as window:
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
        assert 0.0 < window.run('return values.estimated_tip_error') < 1e-3
        # The curve has the torque of the first step, kp times the first part of the goal's step.
        assert window.run('return Math.max(...samples.map(each => Math.abs(each.torque))) / '
                          '(law.gains[0] * 0.2 * law.amplitudes[0])') > 0.99
        picture(window, tmp_path, f'{name}_light_1300')
        for number, wanted in (1, 'arm'), (2, 'standing'), (0, 'paper'):
            assert choose(window, number) == wanted
            assert not window.run('return loop.closed')
        assert window.run('return scenes.length') == 3
        window.open(page, 400)
        window.until('return scene && values.time > 0.2')
        picture(window, tmp_path, f'{name}_light_400')


@pytest.mark.parametrize('name', BROWSERS)
def test_keys_turn_the_arm_pause_and_reset(name, page, tmp_path):
    with shown(name, page, tmp_path, 1300) as window:
        def press(*values):
            window.act('key', *({'type': kind, 'value': value}
                                for value in values for kind in ('keyDown', 'keyUp')))

        window.run("document.getElementById('loads').click()")
        press(' ', 'r')
        assert window.run('return [running, values.time]') == [False, 0.0]
        press('.', '.')
        assert window.run('return values.time / scene.step') == pytest.approx(2.0)
        press(' ')
        for key, sign in ('\ue012', 1), ('\ue014', -1):  # arrows to the left and to the right
            window.act('key', {'type': 'keyDown', 'value': key})
            window.until('return values.shaft_torque * arguments[0] > 0.0', sign)
            window.act('key', {'type': 'keyUp', 'value': key})
            window.until('return values.shaft_torque === 0.0')
        window.act('key', {'type': 'keyDown', 'value': 'd'})
        window.until('return values.carrier_x_force > 0.0')
        window.act('key', {'type': 'keyUp', 'value': 'd'})


LUMINANCE = """
const probe = document.createElement('canvas').getContext('2d');
const luminance = colour => {
  probe.fillStyle = colour;
  probe.fillRect(0, 0, 1, 1);
  const [r, g, b] = [...probe.getImageData(0, 0, 1, 1).data].map(value => {
    const part = value / 255;
    return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const style = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
const contrast = (a, b) => {
  const [low, high] = [luminance(style(a)), luminance(style(b))].sort((x, y) => x - y);
  return (high + 0.05) / (low + 0.05);
};
return Object.fromEntries([...arguments].map(([a, b]) => [`${a} on ${b}`, contrast(a, b)]));
"""
TEXTS = [['ink', 'card'], ['soft', 'card'], ['ink', 'page'], ['soft', 'page'],
         ['warn', 'warn-back'], ['card', 'accent']]
LINES = [[name, 'card'] for name in ('arm', 'load', 'trail', 'body', 'second')]


@pytest.mark.parametrize('dark', [False, True], ids=['light', 'dark'])
@pytest.mark.parametrize('name', BROWSERS)
def test_colours_and_a_finger_on_a_phone(name, dark, page, tmp_path):
    """Texts and lines are readable (WCAG 2: 4.5 and 3), and a finger pulls the tip."""
    with shown(name, page, tmp_path, 400, dark) as window:
        assert window.run('return matchMedia("(prefers-color-scheme: dark)").matches') == dark
        back = window.run('return getComputedStyle(document.body).backgroundColor')
        assert (back == 'rgb(18, 22, 28)') == dark
        assert window.run('return colours.arm') == ('#62a8f5' if dark else '#1769c2')
        assert min(window.run(LUMINANCE, *TEXTS).values()) >= 4.5
        assert min(window.run(LUMINANCE, *LINES).values()) >= 3.0
        wide, inner = window.run('return [document.documentElement.scrollWidth, innerWidth]')
        assert wide <= inner <= (500 if name == 'firefox' else 400)  # it has no narrower windows
        window.run("document.getElementById('loads').click(); "
                   "document.getElementById('reset').click()")
        window.until('return values.time > 0.05')
        x, y = window.run(
            "const box = byId('plane').getBoundingClientRect(); return [Math.round(box.left + "
            'view.width / 2 + (values.tip_x - view.x) * view.pixels), Math.round(box.top + '
            'view.height / 2 - (values.tip_y - view.y) * view.pixels)]')
        scrolled = window.run('return scrollY')

        def move(dx, dy):
            return {'type': 'pointerMove', 'duration': 100, 'x': x + dx, 'y': y + dy}
        window.run('window.most = 0; const own = command; window.command = () => { own(); '
                   'most = Math.max(most, Math.hypot(...arm.pull)); }')
        begun = window.run('return values.shaft')
        window.act('pointer', move(0, 0), {'type': 'pointerDown', 'button': 0}, move(0, 40),
                   {'type': 'pause', 'duration': 500}, {'type': 'pointerUp', 'button': 0},
                   pointerType='touch')
        window.until('return pointer === null && most > 0.0 && '
                     'Math.abs(values.shaft - arguments[0]) > 0.01', begun)
        picture(window, tmp_path, f'{name}_{"dark" if dark else "light"}_phone')
        assert window.run('return scrollY') == scrolled
        assert choose(window, 2) == 'standing'
        if dark:
            window.open(page, 1300)
            window.until('return scene && values.time > 0.2')
            picture(window, tmp_path, f'{name}_dark_1300')
