# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Fits to measured frequency responses, made from closed forms and linear models."""

import numpy as np
import pytest

import timo_sim

MAPPING = {'frequency': 'f', 'input': 'torque', 'outputs': {
    'shaft': {'magnitude': 'size', 'phase': 'phase', 'unit': 'dB', 'coherence': 'sure'},
    'root_strain': {'real': 're', 'imaginary': 'im'}}}
SCENE = timo_sim.load_scene({}, {
    'carrier.held': 'both', 'model.modes': 1, 'arm.damping_ratio': 0.02, 'initial.shaft': 0.0})


def written(path, frequency, shaft, strain):
    """Write responses with noise of 3 % as a table; shafts without coherence are wrong."""
    random = np.random.default_rng(3)
    shaft, strain = (each * (1.0 + 0.03 * (random.normal(size=len(each)) + 1j * random.normal(
        size=len(each)))) for each in (shaft, strain))
    sure = np.full(len(frequency), 0.9)
    sure[::7], shaft[::7] = 0.001, 10.0 * shaft[::7]
    np.savetxt(path, np.stack([
        frequency, 20.0 * np.log10(np.abs(shaft)), np.degrees(np.angle(shaft)), strain.real,
        strain.imag, sure], 1), delimiter=',', header='f,size,phase,re,im,sure', comments='')
    return path


def test_a_response_gives_the_arm_its_damping_and_a_delay(tmp_path):
    frequency = np.geomspace(0.5, 8.0, 40)
    model = timo_sim.linearize(SCENE).select(['torque_N_m'], ['shaft_rad', 'root_strain'])
    found = model.frequency_response(frequency)[..., 0] * np.exp(
        -2j * np.pi * 0.004 * frequency)[:, np.newaxis]
    truth = {'arm.young_modulus': SCENE.values['arm.young_modulus'], 'torque.delay': 0.004,
             'arm.damping_ratio[0]': 0.02}
    fit = timo_sim.fit(
        SCENE.vary({'arm.young_modulus': 1.4 * truth['arm.young_modulus'],
                    'arm.damping_ratio': 0.05}),
        written(tmp_path / 'r.csv', frequency, *found.T), [*truth], mapping=MAPPING, quick=True,
        starts=1)
    for name, value in truth.items():
        assert fit.estimates[name].low < value < fit.estimates[name].high, name
    assert fit.estimates['arm.young_modulus'].deviation < 0.01 * truth['arm.young_modulus']
    assert fit.errors['root_strain'].rms == pytest.approx(0.03, rel=0.3)
    assert len(fit.plot().axes) == 2


def test_a_stiff_arm_has_the_response_of_its_inertia_also_beside_a_record_in_time(tmp_path):
    """Below all resonances angle over torque is 1 / (J s^2 + c s), with the J of a rigid arm."""
    scene = timo_sim.load_scene({
        'arm.length': 1.0, 'arm.section.width': 0.02, 'arm.section.height': 0.02,
        'arm.density': 2700.0, 'arm.young_modulus': 7e10, 'arm.shear_modulus': 2.6e10,
        'arm.damping_ratio': [], 'model.modes': 1, 'carrier.held': 'both', 'motor.mass': 1.0,
        'motor.shaft_inertia': 0.3, 'motor.viscous_friction': 2.0, 'end_effector.mass': 0.1,
        'end_effector.inertia': 1e-4, 'initial.shaft': 0.0})
    inertia, friction, t = 0.1 + 1.08 / 3.0 + 0.1, 0.7, np.arange(100) * 0.01
    s = 2j * np.pi * np.geomspace(0.05, 1.0, 30)
    shaft = 1.0 / (inertia * s**2 + friction * s)
    table = written(tmp_path / 'r.csv', s.imag / (2.0 * np.pi), shaft, shaft)
    response = timo_sim.read_record(table, MAPPING).select('shaft')
    ramp = t - inertia / friction * (1.0 - np.exp(-friction * t / inertia))
    noise = 1e-3 * np.random.default_rng(1).normal(size=100)
    record = timo_sim.Record.of({'torque': (t, t**0)}, {'shaft': (t, ramp / friction + noise)})
    names = ['motor.shaft_inertia', 'motor.viscous_friction']
    fit = timo_sim.fit(scene, [record, response], names, quick=True, starts=1)
    assert fit.values[names[0]] == pytest.approx(0.1, abs=0.02)  # 4 % of the whole
    assert fit.values[names[1]] == pytest.approx(friction, rel=0.03)


RE_IM = {'real': 're', 'imaginary': 'im'}


@pytest.mark.parametrize('change, said', [
    ({'input': 'drive'}, 'input, one of'), ({'outputs': {'shaft': {'real': 're'}}}, 'magnitude'),
    ({'outputs': {'shaft': {'reel': 're'}}}, 'reel is not known.*did you mean real'),
    ({'outputs': {'shaft': {**RE_IM, 'scale': 'much'}}}, "scale must be a finite number, got 'mu"),
    ({'outputs': {'shaft': {**RE_IM, 'unit': 'db'}}}, "unit must be one of dB, got 'db'"),
    ({'outputs': {'shaft': {'magnitude': 'size', 'phase': 'phase'}}}, '>= 0 or .* unit: dB'),
    ({'outputs': {'shaft': 3}}, 'outputs: shaft must have some of magnitude, .*, got 3'),
    ({'frequency': 'g'}, 'g is no column of the table')])
def test_a_mapping_of_a_response_that_is_wrong_is_refused(tmp_path, change, said):
    written(tmp_path / 'r.csv', np.arange(1.0, 21.0), np.ones(20), np.ones(20))
    with pytest.raises(timo_sim.ParameterError, match=said):
        timo_sim.read_record(tmp_path / 'r.csv', {**MAPPING, **change})


def test_a_response_has_no_time_to_be_cut_and_errors_without_the_unit_of_its_output(tmp_path):
    """Its errors are of logarithms and phases; cut, it was fitted as angles in time."""
    frequency = np.geomspace(0.5, 8.0, 40)
    shaft = timo_sim.linearize(SCENE).select(['torque_N_m'], ['shaft_rad']).frequency_response(
        frequency)[:, 0, 0]
    path = written(tmp_path / 'r.csv', frequency, shaft, shaft)
    measured = timo_sim.read_record(path, {**MAPPING, 'outputs': {
        'shaft': MAPPING['outputs']['shaft']}})
    with pytest.raises(timo_sim.ParameterError, match='cannot be cut: leave out rows'):
        measured.cut(0.0, 4.0)
    fit = timo_sim.fit(SCENE, measured, ['arm.young_modulus'], hold_out=0.5, quick=True)
    assert fit.verdict.startswith('predicts what was held out with rms errors of 0.')
    assert ' of shaft (' in fit.verdict and ' rad' not in fit.verdict
