# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Views show the computed motion, curves and energy; rerun itself reads and draws them."""

from dataclasses import replace
import json
import os
from pathlib import Path
import re
import resource
import signal
import subprocess
import sys
from xml.etree import ElementTree

from command_line import call
from matplotlib.figure import Figure
from matplotlib.image import imread
from mcap_ros2.reader import read_ros2_messages
import numpy as np
from PIL import Image
import pytest
from rerun.chunk import RrdReader
from ros_process import Process

import timo_sim
from timo_sim.view import plot, rerun
from timo_sim.view.plot import animate
from timo_sim.view.rerun import picture, write
from timo_sim.view.track import Track

CONFIG = Path(__file__).resolve().parents[2] / 'bringup/config'
LENGTH, AT = 2.0, 1.782
ARM, TIP, GRID = (86, 180, 233), (213, 94, 0), (50, 50, 50)


@pytest.fixture(scope='module')
def run(paper):
    return timo_sim.simulate(timo_sim.load_scene(paper), 3.0, sample_every=2)


@pytest.fixture(scope='module')
def shown(run, tmp_path_factory):
    """Return a rerun file of this run and the corners of its plane."""
    path = tmp_path_factory.mktemp('view') / 'run.rrd'
    return path, write([Track(run, 'one')], path, at=AT)


def columns(path, entity):
    """Return sim times [ns] and the flat values of the one component of an entity."""
    times, values = [], []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            times.append(batch.column('sim_time').cast('int64').to_numpy())
            values += batch.column(batch.num_columns - 1).to_pylist()
    return np.concatenate(times), np.array(values)


def pixels(image, colour):
    """Return x, y of the pixels of a colour, also where it is shaded, shape (n, 2)."""
    rgb = image[..., :3] * 255.0
    share = rgb @ np.array(colour) / np.dot(colour, colour)
    off = np.abs(rgb - share[..., np.newaxis] * np.array(colour)).max(axis=-1)
    return np.argwhere((off < 12) & (share > 0.45))[:, ::-1] + 0.5


def test_tip_and_centre_line_are_drawn_where_they_are(run, shown, tmp_path):
    path, ((left, bottom), (right, top)) = shown
    png = tmp_path / 'plane.png'
    picture(path, png, AT, view='plane')
    image = imread(png)
    height, width = image.shape[:2]
    # The picture lacks some pixels at its edges, so the scale comes from the grid of 0.5 m.
    grid = np.abs(image[..., :3] * 255.0 - GRID).max(axis=-1) < 14
    scale = np.diff(np.flatnonzero(grid.mean(axis=0) > 0.5))[[0, -1]].mean() / 0.5
    fits = min(width / (right - left), height / (top - bottom))
    assert scale == pytest.approx(fits, rel=0.01)
    sample = round(AT / (run.t[1] - run.t[0]))

    def project(xi):
        x, y = run.position(xi)[sample]
        return np.array([0.5 * width + scale * (x - 0.5 * (left + right)),
                         0.5 * height - scale * (y - 0.5 * (bottom + top))])

    disc = pixels(image, TIP)
    centre = 0.5 * (disc.min(axis=0) + disc.max(axis=0))
    assert len(disc) > 200
    assert np.linalg.norm(centre - project(LENGTH)) < 2.0

    # Between torque arc and end effector: compare points with the mean of arm pixels near them.
    drawn = pixels(image, ARM)
    middle = [drawn[np.linalg.norm(drawn - project(xi), axis=1) < 6.0].mean(axis=0) - project(xi)
              for xi in np.linspace(0.4, 1.75, 30)]
    assert np.linalg.norm(middle, axis=1).max() < 1.5
    # The straight arm is elsewhere.
    root, shaft = project(0.0), run.shaft[sample]
    straight = root + scale * LENGTH * np.array([np.cos(shaft), -np.sin(shaft)])
    assert np.linalg.norm(straight - project(LENGTH)) > 10.0


def test_the_viewer_itself_draws_a_log_with_a_bent_arm(tmp_path):
    """URDF and frames are in the log; a line that is straight is so in perspective, too."""
    scene = timo_sim.load_scene({
        'initial.shaft': 0.5, 'initial.modal_coordinates': [1.2, 0.0, 0.0]})
    run = timo_sim.simulate(scene, 0.1, sample_every=10, estimate=False)
    bend = run.deflection(LENGTH)[0]
    assert np.allclose(bend, [-0.15, 0.69], atol=0.01)  # [m]
    picture(run.save(tmp_path / 'run.mcap'), tmp_path / 'run.png', 0.0, view='/',
            timeline='message_log_time')
    red, _, blue = np.moveaxis(255.0 * imread(tmp_path / 'run.png')[..., :3], -1, 0)
    tip = np.argwhere(red > blue + 60.0).mean(axis=0)[::-1]  # x to the right, y downward
    arm = np.argwhere(blue > red + 40.0)[:, ::-1]
    assert np.linalg.norm(arm - tip, axis=1).min() < 2.0

    # Between the carrier, which covers the root, and the tip the arm hangs through.
    left = np.min(arm[:, 0]) + 0.3 * (tip[0] - np.min(arm[:, 0]))
    begin, middle = (arm[np.abs(arm[:, 0] - x) < 1.0].mean(axis=0)
                     for x in (left, 0.5 * (left + tip[0])))
    chord, way = tip - begin, middle - begin
    sag = (chord[0] * way[1] - chord[1] * way[0]) / np.hypot(*chord)
    assert 0.04 < sag / np.hypot(*chord) < 0.2


@pytest.mark.parametrize('fps', [3.0, 7.0, 15.0, 19.0, 30.0])
def test_an_animation_plays_in_real_time(run, tmp_path, fps):
    """A GIF has times in hundredths of a second: the frames are at such times."""
    animate([Track(run)], tmp_path / 'run.gif', fps)
    with Image.open(tmp_path / 'run.gif') as frames:
        total = 0
        for number in range(frames.n_frames):
            frames.seek(number)
            assert frames.info['duration'] >= 1000.0 / fps
            total += frames.info['duration']
    span = 1000.0 * (run.t[-1] - run.t[0])
    assert span < total <= span + frames.info['duration']


def test_an_animation_shows_the_arm_where_it_is(run, tmp_path):
    animate([Track(run)], tmp_path / 'run.gif', 10.0)
    frames = Image.open(tmp_path / 'run.gif')
    assert frames.n_frames == 31 and frames.info['duration'] == 100  # [ms], as in the run
    for number, k in ((0, 0), (18, 900)):
        frames.seek(number)
        # A line is fitted to the arm's pixels; the left part has no others of this colour.
        found = pixels(np.asarray(frames.convert('RGB'))[:, :360] / 255.0, (0, 114, 178))
        x, y = np.linalg.svd(found - found.mean(axis=0), full_matrices=False)[2][0]
        chord = run.position(LENGTH)[k] - run.carrier[k]
        off = np.arctan2(-y, x) - np.arctan2(*chord[::-1])
        # The bent arm lies to one side of its chord, and the pixels include a part of its path.
        assert abs((off + np.pi / 2) % np.pi - np.pi / 2) < 0.02


def test_simulate_writes_the_animation_that_view_makes_of_its_log(tmp_path):
    log, first, second = (str(tmp_path / name) for name in ('run.mcap', 'a.gif', 'b.gif'))
    for command in (['simulate', 'paper', '--duration', '0.2', '-o', log, '--gif', first],
                    ['view', log, '--gif', second]):
        assert f'{command[-1]} is written' in call(*command, '--deflection-scale', '5')
    frames = [Image.open(path) for path in (first, second)]
    assert [each.n_frames for each in frames] == [5, 5]
    assert np.array_equal(*(np.asarray(each.convert('RGB')) for each in frames))
    assert 'must end with .gif, got run.png' in call(
        'simulate', 'paper', '--gif', 'run.png', code=2)


def plane_of(figure):
    """Return the axes of the plane, and the arms that are drawn there, each (p, 2) [m]."""
    plane, = (axes for axes in figure.axes if axes.get_xlabel() == 'x [m]')
    return plane, [line.get_xydata() for line in plane.lines if line.get_linewidth() == 2.0]


@pytest.mark.parametrize('values, labels', [
    ({}, 'tip deflection [m], shaft angle [rad], carrier [m]'),
    ({'model.modes': 0}, 'shaft angle [rad], carrier [m]'),
    ({'carrier.held': 'x'},
     'tip deflection [m], shaft angle [rad], carrier [m], holding force [N]'),
    ({'carrier.held': 'both'}, 'tip deflection [m], shaft angle [rad], holding force [N]'),
    ({'carrier.held': 'both', 'motor.shaft': 'locked', 'gravity': [0.0, -9.81],
      'initial.shaft': 0.0},
     'tip deflection [m], holding force [N], holding torque [N m]')])
def test_a_plot_shows_what_moves_and_a_large_arm(paper, values, labels):
    run = timo_sim.simulate(timo_sim.load_scene(paper, values), 0.5, estimate=False)
    figure = run.plot()
    figure.draw_without_rendering()
    plane, arms = plane_of(figure)
    curves = [axes for axes in figure.axes if axes is not plane]
    assert [axes.get_ylabel() for axes in curves] == labels.split(', ')
    assert all(np.ptp(line.get_ydata()) > 0.0 for axes in curves for line in axes.lines)
    moving = [k for k in (0, 1) if not run.model.constrained[k]]
    shown = {line.get_label(): line.get_ydata() for axes in curves for line in axes.lines
             if axes.get_ylabel() == 'carrier [m]'}
    assert [*shown] == ['xy'[k] for k in moving]
    assert all(np.array_equal(shown['xy'[k]], run.carrier[:, k]) for k in moving)
    # The arm is not small in the picture, and nothing is outside of the axes. A plane in which the
    # arm is low and wide takes more than a third of the width.
    least = 0.42 if 'motor.shaft' in values else 0.3
    for arm in arms:
        pixels = plane.transData.transform(arm)
        assert np.linalg.norm(pixels[-1] - pixels[0]) > least * max(figure.bbox.size)
        assert np.all((plane.bbox.min < pixels) & (pixels < plane.bbox.max))
    # The largest deflection of all is among those drawn.
    tips = run.position()[np.abs(run.deflection()[:, 1]).argmax()]
    assert min(np.abs(arm[-1] - tips).max() for arm in arms) < 1e-12


def test_a_scale_of_the_deflection_is_drawn_and_stated(run, tmp_path, monkeypatch):
    k, figures = int(np.abs(run.deflection()[:, 1]).argmax()), []
    axis = np.array([np.cos(run.shaft[k]), np.sin(run.shaft[k])])
    across = np.array([-axis[1], axis[0]])
    along, bend = 5.0 * run.deflection()[k]
    tip = run.carrier[k] + (LENGTH + along) * axis + bend * across
    assert abs(bend) > 0.4 > 4.5 * np.abs(run.deflection()[k, 1])

    plane, arms = plane_of(run.plot(5.0))
    assert min(np.abs(arm[-1] - tip).max() for arm in arms) < 1e-12
    assert (plane.get_title(), plane_of(run.plot())[0].get_title()) == ('deflection x 5', '')

    class Recorded(Figure):
        def __init__(self, *arguments, **more):
            super().__init__(*arguments, **more)
            figures.append(self)

    monkeypatch.setattr(plot, 'Figure', Recorded)
    log = run.save(tmp_path / 'run.mcap')
    for more in [], ['--deflection-scale', '5']:
        options = ['--gif', tmp_path / 'run.gif', '--save', tmp_path / 'run.rrd', '--fps', 2,
                   '--at', run.t[k], *more]
        call('view', log, *options)
    assert [figure.axes[0].get_title() for figure in figures] == ['', 'deflection x 5']
    low, high = figures[1].axes[0].viewLim.get_points()
    assert np.all((low < tip) & (tip < high))
    _, lines = columns(tmp_path / 'run.rrd', '/plane/run/arm')
    assert np.abs(np.squeeze(lines)[:, -1] - tip).max(axis=1).min() < 1e-6  # single precision
    _, values = columns(tmp_path / 'run.rrd', '/curves/tip_deflection/run')
    assert np.allclose(values[:, 0], run.deflection()[:, 1], rtol=0.0, atol=1e-12)  # not scaled
    for wrong in 0.0, -1.0, np.nan, np.inf, 1e10, 'large':
        for draw in run.plot, lambda scale: Track(run, 'run', scale):
            with pytest.raises(ValueError, match='deflection_scale must be a finite number > 0'):
                draw(wrong)


def test_layouts_of_other_programs_name_what_is_in_a_log(run, tmp_path):
    """Foxglove names fields as the messages do, PlotJuggler's joints by their names."""
    found = {}
    for message in read_ros2_messages(str(run.save(tmp_path / 'run.mcap'))):
        found[message.channel.topic] = message.ros_msg
    layout = json.loads((CONFIG / 'foxglove.json').read_text())
    panels = re.findall('"(3D!arm|Plot![a-z]+)"', json.dumps(layout['layout']))
    assert sorted(panels) == sorted(layout['configById'])
    arm = layout['configById'].pop('3D!arm')
    assert arm['topics'] == {'/robot_description': {'visible': True}}
    assert '<robot' in found['/robot_description'].data
    frames = {f'frame:{frame.child_frame_id}' for frame in found['/tf'].transforms}
    assert len(arm['transforms']) == 11 and arm['transforms'].keys() < frames
    paths = [path['value'] for panel in layout['configById'].values() for path in panel['paths']]
    for path in paths:
        topic, *fields = re.findall(r'/[^.]+|\w+', path)
        value = found[topic]
        for field in fields:
            value = value[int(field)] if field.isdecimal() else getattr(value, field)
        assert isinstance(value, float)
    curves = [curve.get('name') for curve in ElementTree.parse(
        CONFIG / 'plotjuggler.xml').getroot().iter('curve')]
    joints = found['/joint_states'].name
    named = {'/joint_states/' + '/'.join((joints[int(number)], field)) if number else
             path.replace('.', '/') for path in paths for field, number in
             re.findall(r'\.([a-z]+)(?:\[(\d)\])?$', path)}
    assert len(curves) == len(paths) == len(named) and {*curves} == named


def test_curves_have_every_sample_and_frames_are_thinned(run, shown):
    path, _ = shown
    ns, values = columns(path, '/curves/tip_deflection/one')
    assert np.array_equal(ns, np.rint(run.t * 1e9))
    assert np.array_equal(values[:, 0], run.deflection()[:, 1])
    ns, values = columns(path, '/curves/force/one')
    expected = 5.0 * np.sin(2.0 * np.pi * run.t[:, np.newaxis] * [2.0, 3.0])
    assert np.allclose(values, expected, rtol=0.0, atol=1e-12)
    ns, lines = columns(path, '/plane/one/arm')
    assert 90 <= len(ns) <= 93 and round(AT * 1e9) in ns
    sample = np.searchsorted(run.t, 1e-9 * ns - 1e-6)
    assert np.allclose(np.squeeze(lines)[:, -1], run.position(LENGTH)[sample], atol=1e-6)


def test_two_runs_share_panels_and_have_their_difference(run, paper, tmp_path):
    heavy = timo_sim.load_scene(paper, {'end_effector.mass': 2.5})
    other, path = timo_sim.simulate(heavy, 2.0), tmp_path / 'two.rrd'
    write([Track(run, 'one'), Track(other, 'two')], path)
    ns, values = columns(path, '/curves/difference/two')
    fewer = min(run.t[run.t <= 2.0], other.t, key=len)
    first, second = (np.interp(fewer, each.t, each.deflection(LENGTH)[:, 1])
                     for each in (run, other))
    assert np.array_equal(ns, np.rint(1e9 * fewer))
    assert np.allclose(values[:, 0], second - first, atol=1e-12)
    colours = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.is_static and 'SeriesLines:colors' in batch.schema.names:
            _, _, panel, name = chunk.entity_path.split('/')
            colours.setdefault(name, set()).add(batch.column('SeriesLines:colors')[0][0].as_py())
    assert len(colours['one']) == len(colours['two']) == 1
    assert colours['one'] != colours['two']


@pytest.mark.parametrize('order', [1, -1])
def test_a_run_with_fewer_samples_does_not_differ_from_itself(run, tmp_path, order):
    """Between its samples, 50 ms apart, a straight line is off by a part of the vibration."""
    few, path = replace(run, t=run.t[::25], values=run.values[::25],
                        friction_heat=run.friction_heat[::25]), tmp_path / 'two.rrd'
    write([Track(run, 'one'), Track(few, 'two')][::order], path)
    ns, values = columns(path, f'/curves/difference/{["one", "two"][order > 0]}')
    assert len(ns) == len(few.t) and np.abs(values).max() < 1e-12


@pytest.fixture(scope='module')
def log(tmp_path_factory, paper):
    node = Process(tmp_path_factory.mktemp('log'), '--params-file', str(paper),
                   real_time_factor=0.0, duration=1.0, **{'rate.modal_state': 50.0})
    assert node.wait()[0] == 0
    return node.log


def test_a_log_of_the_node_is_shown_like_its_run(log, paper, tmp_path):
    path = tmp_path / 'out.rrd'
    call('view', log, log, '--save', path)
    run = Track(timo_sim.simulate(timo_sim.load_scene(paper), 1.0))
    for panel in ('tip_deflection', 'modal', 'force', 'torque', 'energy'):
        ns, values = columns(path, f'/curves/{panel}/{log.stem}')
        assert np.array_equal(ns, run.ns[::20])
        expected = np.column_stack([*run.curves[panel].values()])[::20]
        assert np.allclose(values, expected[:, :1] if panel == 'energy' else expected, atol=1e-12)
    _, values = columns(path, f'/curves/difference/{log.stem}_1')
    assert np.all(values == 0.0)


def test_bad_input_and_a_missing_screen_are_one_line(log, tmp_path):
    junk = tmp_path / 'junk.mcap'
    junk.write_text('junk')
    assert call('view', junk, code=2).count('\n') == 1
    screen = 'DISPLAY', 'WAYLAND_DISPLAY'
    done = subprocess.run(
        [sys.executable, '-m', 'timo_sim', 'view', log], capture_output=True, text=True,
        env={name: value for name, value in os.environ.items() if name not in screen})
    assert done.returncode == 1 and done.stderr.count('\n') == 1
    assert 'there is no screen' in done.stderr


@pytest.mark.parametrize('arguments, words', [
    (['--save', 'a.rrd', '--at', 'nan'], '--at must be a finite number, got nan'),
    (['--save', 'a.rrd', '--at', '99'], '--at = 99 s is not in the run, which is from 0 to'),
    (['--save', 'a.png'], 'the path of --save, a rerun file, must end with .rrd, got a.png'),
    (['--gif', 'a.gif', '--at', '1'], '--at is the time of a picture: it needs --png or --save'),
    (['--gif', 'a.gif', '--fps', 'nan'], '--fps must be a finite number > 0'),
    (['--gif', 'a.gif', '--deflection-scale', 'nan'], 'deflection_scale must be a finite number'),
    (['--png', 'none/a.png'], '--png none/a.png cannot be written')])
def test_invalid_views_are_refused_in_one_line(log, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    told = call('view', log, *arguments, code=2)
    assert words in told and told.count('\n') == 1
    assert not any(tmp_path.iterdir())


def test_a_viewer_that_does_not_end_is_killed(monkeypatch):
    """Seen once: rerun, told to end while it served its page, went on with one core busy."""
    monkeypatch.setattr(rerun, '_ENDING', 0.2)
    stubborn = ('import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); '
                'print(flush=True); time.sleep(300.0)')
    with subprocess.Popen([sys.executable, '-c', stubborn], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        rerun.stop(process)
        assert process.returncode == -signal.SIGKILL


@pytest.mark.parametrize('command, name, option', [
    ('view', 'run.rrd', '--save'), ('view', 'run.gif', '--gif'), ('export', 'run.parquet', '-o'),
    ('export', 'bag', '-o'), ('simulate', 'run.png', '--png')])
def test_a_full_disk_leaves_no_file_that_looks_whole(log, tmp_path, command, name, option):
    more = [str(log) if command in ('view', 'export') else 'paper']
    more += ['--duration', '0.1'] if command == 'simulate' else []
    more += ['--bag'] if name == 'bag' else []
    whole, cut = tmp_path / 'whole' / name, tmp_path / 'cut' / name
    whole.parent.mkdir()
    cut.parent.mkdir()
    call(command, *more, option, whole)
    assert [*whole.parent.iterdir()] == [whole]
    overwrites = command == 'view' or name.endswith('.png')
    if overwrites:
        cut.write_bytes(b'older')
    size = min(file.stat().st_size for file in ([whole] if whole.is_file() else whole.iterdir()))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # Rerun files differ by a per cent.
    resource.setrlimit(resource.RLIMIT_FSIZE, (size - size // 20, hard))
    try:
        told = call(command, *more, option, cut, code=1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert f'{name} is' not in told
    assert [*cut.parent.iterdir()] == ([cut] if overwrites else [])
    assert not overwrites or cut.read_bytes() == b'older'
