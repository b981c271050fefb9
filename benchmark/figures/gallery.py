# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Draws five pictures with captions: `make gallery` writes doc/gallery.md and doc/gallery/."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image
from scipy.ndimage import maximum_filter1d

from benchmark import drawing, ROOT
from benchmark.drawing import BLUE, GREEN, GREY, name_ends, RED
from benchmark.report import parser
import timo_sim
from timo_sim.view.rerun import picture, write
from timo_sim.view.track import Track

LENGTH = 2.0  # of the paper's arm [m]
FINE = {'model.modes': 5}
ABOVE = {'loc': 'lower left', 'bbox_to_anchor': (0.0, 1.0), 'frameon': False, 'fontsize': 'small',
         'borderaxespad': 0.2}


def sheet(title, ratio=1.0):
    """Return a figure, its plane of motion on the left, and its axes of time on the right."""
    figure, (plane, time) = drawing.sheet(1, 2, 4.0, width_ratios=[ratio, 1.6])
    figure.suptitle(title)
    plane.set(xlabel='x [m]', ylabel='y [m]', aspect='equal')
    time.set(xlabel='t [s]')
    for axes in plane, time:
        axes.grid(alpha=0.3)
    return figure, plane, time


def draw_arm(plane, run, sample, colour, alpha=1.0, label=None, body=True):
    """Draw carrier, bent arm and end effector of a sample."""
    length = run.scene.manipulator.arm.length
    line = run.model.world(run.values[[sample]], run.model.at(
        np.linspace(0.0, length, 41)))[0]
    plane.plot(*line.T, color=colour, alpha=alpha, lw=2.5, label=label, solid_capstyle='round')
    plane.plot(*line[-1], 'o', color=colour, alpha=alpha, ms=8)
    if body:
        plane.plot(*line[0], 's', color=colour, alpha=alpha, ms=9)


def spin_up():
    """Draw an arm that is spun up, and its centrifugal stiffening; return the caption."""
    scene = timo_sim.load_scene(ROOT / 'config/spin_up.yaml', FINE)
    run = timo_sim.simulate(scene, 20.0)  # fine samples: the path of the tip is round
    length = scene.manipulator.arm.length
    across = run.deflection(length)[:, 1]
    largest = int(np.abs(across).argmax())
    figure, plane, time = sheet('Spin-up: the shaft is driven to its final speed')
    plane.plot(*run.position(length).T, color=GREY, lw=0.5, label='path of the tip')
    for k, sample in enumerate(np.linspace(0, largest, 5).astype(int)[:4]):
        draw_arm(plane, run, sample, BLUE, 0.25 + 0.15 * k,
                 f'before, every {run.t[largest] / 4.0:.2g} s' if k == 3 else None)
    draw_arm(plane, run, largest, RED, label=f'bent most, {run.t[largest]:.1f} s')
    plane.set(xlim=(-11, 11), ylim=(-11, 11))
    plane.legend(**ABOVE)
    time.plot(run.t, across, color=BLUE, label='tip deflection w(l)')
    time.axhline(0.0, color='k', lw=0.8)
    time.set(ylabel='w(l) [m]', xlim=(0, 20))
    speed = time.twinx()
    speed.plot(run.t, run.shaft_velocity, '--', color=RED, label='shaft speed')
    speed.set(ylabel='shaft speed [rad/s]')
    speed.grid(False)
    time.legend(handles=[*time.lines[:1], *speed.lines], **ABOVE)
    drawing.save(figure, 'gallery/spin_up')
    late = np.abs(across[run.t > 16.0]).max()
    limit = scene.vary({'model.formulation': 'newton'}).build().speed_limit
    return (f'The shaft follows a given angle up to {run.shaft_velocity[-1]:.3g} rad/s. The arm '
            f'lags behind by up to {1e3 * abs(across[largest]):.0f} mm while it is accelerated; '
            'once the speed is constant, centrifugal force holds it straight: after 16 s it is '
            f'never bent by more than {1e3 * late:.2g} mm. The set `newton` of the paper loses '
            f'its stiffness above {limit:.3g} rad/s instead, and says so.')


def resonance():
    """Draw the response to a torque at and below the first frequency; return the caption."""
    rest = timo_sim.load_scene({}, {**FINE, 'initial.shaft': 0.0})
    first = timo_sim.modes(rest).frequency[0]

    def driven(ratio, damping):
        return timo_sim.simulate(rest.vary({
            'arm.damping_ratio': [damping], 'load.torque.harmonic.amplitude': [0.5],
            'load.torque.harmonic.frequency': [ratio * first]}), 20.0)

    cases = [(driven(1.0, 0.0), RED, 'undamped'),
             (driven(1.0, 0.01), BLUE, 'damping 0.01'),
             (driven(0.9, 0.0), GREEN, '10 % below it')]
    figure, plane, time = sheet(f'Resonance: 0.5 N m at the first frequency, {first:.2f} Hz')
    tops, cycle, xi = [], round(1e3 / first), np.linspace(0.0, LENGTH, 41)
    for run, colour, label in cases:
        across = run.deflection(LENGTH)[:, 1]
        tops.append(np.abs(across).max())
        # The largest deflection within a cycle.
        time.plot(run.t, 1e3 * maximum_filter1d(np.abs(across), cycle), color=colour, label=label)
        most = len(across) - cycle + np.abs(across[-cycle:]).argmax()
        shape = np.array([run.deflection(x)[most, 1] for x in xi])
        for side in 1e3, -1e3:
            plane.plot(xi, side * shape, color=colour)
    plane.set(aspect='auto', xlabel='along the arm [m]', ylabel='deflection across [mm]',
              title='extremes of the last cycle')
    time.set(ylabel='tip deflection w(l) [mm]', xlim=(0, 20), ylim=(0.0, None),
             title='largest within a cycle')
    name_ends(time)
    drawing.save(figure, 'gallery/resonance')
    return (f'The free manipulator at rest has its first frequency at {first:.3f} Hz. A torque of '
            f'0.5 N m there bends the tip further with each cycle, {1e3 * tops[0]:.0f} mm within '
            f'20 s; a modal damping ratio of 0.01 keeps it to {1e3 * tops[1]:.0f} mm, and a '
            f'frequency 10 % lower to {1e3 * tops[2]:.1f} mm.')


def disturbance():
    """Draw the response to a stroke on the end effector; return the caption."""
    force, lasting = 500.0, 0.01
    scene = timo_sim.load_scene({
        'model.modes': 7, 'initial.shaft': 0.0, 'integrator.step': 0.0005,
        'load.tip_force_y.piecewise.time': [0.0, lasting],
        'load.tip_force_y.piecewise.value': [force, 0.0]})
    run = timo_sim.simulate(scene, 2.0)
    across = run.deflection(LENGTH)[:, 1]
    largest = int(np.abs(across).argmax())
    figure, plane, time = sheet('A stroke on the end effector, 5 N s across the arm')
    for k, sample in enumerate(range(0, 401, 100)):
        draw_arm(plane, run, sample, BLUE, 0.25 + 0.18 * k,
                 f'every {100 * (run.t[1] - run.t[0]):.2g} s, light to dark' if k == 4 else None)
    plane.annotate('', (LENGTH, 0.0), (LENGTH, -0.5),
                   arrowprops={'color': RED, 'width': 4, 'headwidth': 14})
    plane.set(xlim=(-0.3, 2.4), ylim=(-0.7, 0.6))
    plane.legend(**ABOVE)
    time.plot(run.t, 1e3 * across, color=BLUE, label='tip')
    time.plot(run.t, 1e3 * run.deflection(0.5 * LENGTH)[:, 1], color=RED, label='middle')
    time.set(ylabel='deflection across [mm]', xlim=(0, 2), ylim=(-80, 80))
    name_ends(time)
    drawing.save(figure, 'gallery/disturbance')
    gained = run.momentum()[run.t > 1.5 * lasting, :2]
    return (f'Nothing is held; {force:g} N act on the end effector for {1e3 * lasting:g} ms. The '
            f'arm bends by up to {1e3 * abs(across[largest]):.0f} mm, at {run.t[largest]:.2f} s, '
            'vibrates, and drifts away with the momentum of the stroke: '
            f'{gained[0, 1]:.6f} N s after it, changed by at most '
            f'{max(np.abs(gained - gained[0]).max(), 1e-12):.1g} N s after 2 s.')


def standing():
    """Draw an arm that a torque bears in gravity until it ends; return the caption."""
    scene = timo_sim.load_scene(ROOT / 'config/standing.yaml')
    run = timo_sim.simulate(scene, 10.0)
    across, below = run.deflection(LENGTH)[:, 1], -np.degrees(run.shaft)
    turned = int(below.argmax())
    figure, plane, time = sheet('Standing in gravity: the torque on the shaft ends at 1 s')
    plane.plot(*run.position(LENGTH)[:turned].T, color=GREY, lw=1, label='path of the tip')
    for k, sample in enumerate(range(1400, turned + 100, 400)):
        draw_arm(plane, run, sample, BLUE, 0.3 + 0.2 * k, 'then every 0.4 s' if k == 3 else None)
    draw_arm(plane, run, 1000, RED, label='borne by the torque, until 1 s')
    plane.set(xlim=(-2.1, 2.1), ylim=(-2.25, 0.5))
    plane.annotate('g', (1.8, -0.4), (1.8, 0.1), ha='center', arrowprops={'arrowstyle': '->'})
    plane.legend(**ABOVE)
    time.plot(run.t, 1e3 * across, color=BLUE, label='tip deflection w(l)')
    time.set(ylabel='w(l) [mm]', xlim=(0, 10), ylim=(-80, 80))
    angle = time.twinx()
    angle.plot(run.t, -below, '--', color=RED, label='shaft angle')
    angle.set(ylabel='shaft angle [degrees]', ylim=(-160, 160))
    angle.grid(False)
    time.legend(handles=[*time.lines, *angle.lines], **ABOVE)
    drawing.save(figure, 'gallery/standing')
    swing, vibration = timo_sim.modes(scene.vary({
        'load.torque.piecewise.value': [0.0, 0.0], 'initial.shaft': -1.6})).frequency[:2]
    return (f'A torque of {run.effort[0, 2]:g} N m bears the arm at rest {below[0]:.1f} degrees '
            f'below the horizontal; the weight bends it by {-1e3 * across[0]:.1f} mm. When the '
            f'torque ends, the arm springs back to {1e3 * across.max():.0f} mm on the other side '
            f'and swings on to {below[turned]:.1f} degrees. Hanging, it would vibrate at '
            f'{vibration:.2f} Hz and swing at {swing:.3f} Hz. The damping ratio of 0.01 ends the '
            'vibration; what is left of the bend after 8 s, up to '
            f'{1e3 * np.abs(across[run.t > 8.0]).max():.1f} mm, turns the shaft.')


def pick_and_place():
    """Draw a slew with an empty gripper and back with a load; return the caption."""
    scene = timo_sim.load_scene(ROOT / 'config/pick_and_place.yaml')
    run = timo_sim.simulate(scene, 10.0)
    (picked, *_), (dropped, *_) = run.payloads
    across = run.deflection(LENGTH)[:, 1]
    figure, plane, time = sheet('Pick and place: 2 kg are carried from 60 degrees to 0')
    plane.plot(*run.position(LENGTH).T, color=GREY, lw=1, label='path of the tip')
    for samples, colour, label in (((800, 1200), BLUE, 'empty, 0.8 and 1.2 s'),
                                   ((picked, 5000, dropped), RED, 'loaded, 3, 5 and 8 s')):
        for k, sample in enumerate(samples):
            draw_arm(plane, run, sample, colour, 0.4 + 0.25 * k, label if not k else None)
    plane.set(xlim=(-0.3, 2.3), ylim=(-0.3, 2.0))
    plane.legend(**ABOVE)
    parts = {'empty': slice(0, picked + 1), 'loaded': slice(picked, dropped + 1),
             'empty again': slice(dropped, None)}
    for (label, part), colour in zip(parts.items(), (BLUE, RED, GREEN)):
        time.plot(run.t[part], 1e3 * across[part], color=colour, label=label)
    time.set(ylabel='tip deflection w(l) [mm]', xlim=(0, 10), ylim=(-40, 45))
    time.legend(ncols=3, **ABOVE)
    drawing.save(figure, 'gallery/pick_and_place')
    empty, loaded, after = (1e3 * np.abs(across[part]).max() for part in parts.values())
    left = 1e3 * np.abs(across[7000:dropped]).max()
    return ('The carrier is held, the shaft is driven. With the empty gripper of '
            f'{scene.manipulator.end_effector_mass:g} kg the arm bends by up to {empty:.0f} mm, '
            f'with the load of 2 kg by {loaded:.0f} mm. The load is at rest when it is picked up '
            'at 3 s, a plastic impact; since the arm is nearly at rest, only '
            f'{1e3 * run.stats["impact_loss_J"]:.1g} mJ are lost. The way back leaves vibrations '
            f'of up to {left:.0f} mm; without the load, which is dropped at 8 s, they are faster, '
            f'of up to {after:.0f} mm.')


def draw_window():
    """Draw what `timo_sim view` shows of the paper's run at 1.81 s, doc/view.png."""
    run = timo_sim.simulate(timo_sim.load_scene(ROOT / 'config/paper.yaml'), 10.0)
    with TemporaryDirectory() as folder:
        write([Track(run, 'paper')], Path(folder, 'run.rrd'), at=1.81)
        picture(Path(folder, 'run.rrd'), Path(folder, 'view.png'), 1.81, (1100, 840))
        # Without the viewer's menu, which says things about the machine.
        drawing.quantised(np.asarray(Image.open(Path(folder, 'view.png')).convert('RGB'))[37:],
                          'view')


def draw_log():
    """Draw what rerun itself shows of a log with a far bent arm, doc/rerun_urdf.png."""
    run = timo_sim.simulate({'initial.shaft': 0.5, 'initial.modal_coordinates': [1.2, 0.0, 0.0]},
                            0.1, 10, estimate=False)
    with TemporaryDirectory() as folder:
        picture(run.save(Path(folder, 'run.mcap')), ROOT / 'doc' / 'rerun_urdf.png', 0.0,
                (3000, 1900), '/', 'message_log_time')


def main():
    """Draw all and write the page."""
    parser(__spec__, __doc__).parse_args()
    text = ['# Gallery', '', 'Written by `make gallery` (benchmark/figures/gallery.py), '
            'numbers included. To look at a run of your own: `timo_sim view run.mcap`.']
    for draw, title in ((spin_up, 'Spin-up'), (resonance, 'Resonance'),
                        (disturbance, 'A disturbance at the tip'),
                        (standing, 'Standing in gravity'), (pick_and_place, 'Pick and place')):
        words = draw()
        print(f'{title}: {words}')
        text += ['', f'## {title}', '', f'![{title}](gallery/{draw.__name__}.png)', '', words]
    draw_window()
    draw_log()
    (ROOT / 'doc' / 'gallery.md').write_text('\n'.join(text) + '\n')


if __name__ == '__main__':
    main()
