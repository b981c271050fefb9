# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Sections: shapes against integrals over them, measured values, materials, older names."""

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize

import timo_sim
from timo_sim.model.bodies import SHAPES

WIDTH, HEIGHT, WALL, WEB = 0.03, 0.04, 0.004, 0.006
SIZES = {'rectangle': {}, 'round': {}, 'tube': {'wall': WALL}, 'box': {'wall': WALL},
         'i': {'wall': WALL, 'web': WEB}}


def scene_of(shape, **more):
    return timo_sim.load_scene({}, {'arm': {
        'section': {'shape': shape, 'width': WIDTH, 'height': HEIGHT, **SIZES[shape]}, **more}})


def breadth(shape, z):
    """Return how much material a section has at heights z above its middle [m]."""
    inner = np.abs(z) < 0.5 * HEIGHT - WALL
    chord, hole = (2.0 * np.sqrt(np.maximum(0.25 * size**2 - z**2, 0.0))
                   for size in (HEIGHT, HEIGHT - 2.0 * WALL))
    return {'rectangle': np.full_like(z, WIDTH), 'round': chord, 'tube': chord - hole,
            'box': np.where(inner, 2.0 * WALL, WIDTH), 'i': np.where(inner, WEB, WIDTH)}[shape]


@pytest.mark.parametrize('shape', SHAPES)
def test_shapes_are_integrals_over_the_section(shape):
    scene = scene_of(shape, density=1000.0, young_modulus=2e9, shear_modulus=1e9)
    section = scene.manipulator.arm.section
    cell = HEIGHT / 200000
    z = -0.5 * HEIGHT + cell * (np.arange(200000) + 0.5)
    area, second = cell * breadth(shape, z).sum(), cell * breadth(shape, z) @ z**2
    assert [section.mass_per_length, section.inertia_per_length, section.axial_stiffness,
            section.bending_stiffness] == pytest.approx(
                [1e3 * area, 1e3 * second, 2e9 * area, 2e9 * second], rel=1e-6)


def by_displacements(shape, poisson, wall, web):
    """
    Return the shear coefficient by Cowper's definition, for thin walls, at unit V / (E I).

    With lateral contraction a section has the displacements u_x = U - nu k (x^2 - y^2) / 2 across
    and u_y = -nu k x y, with k' = V / (E I), in Saint-Venant's solution. Shear stresses follow
    from equilibrium along the walls and give the displacement w along the arm; the shear angle is
    that of the means of u_x and of the rotation, the first moment of w over I.
    """
    depth, count = HEIGHT - wall, 20000
    across, webs = (WIDTH - wall, 2.0 * wall) if shape == 'box' else (WIDTH, web)
    side = 0.5 * across * (shape == 'box')  # y of the webs
    flange, twice = across * wall, 2.0 * (1.0 + poisson)  # E / G
    area = 2.0 * flange + depth * webs
    second = 0.5 * flange * depth**2 + webs * depth**3 / 12.0
    other = 2.0 * flange * across**2 / 12.0 + depth * webs * side**2
    x = np.linspace(0.0, 0.5 * depth, count)
    stress = twice * (0.5 * flange * depth / webs + 0.5 * (0.25 * depth**2 - x**2))  # over G
    slope = stress + 0.5 * poisson * (x**2 - side**2)
    w = scipy.integrate.cumulative_simpson(slope, x=x, initial=0.0)
    y = np.linspace(0.0, 0.5 * across, count)
    stress = twice * 0.5 * depth * ((0.5 * across - y) if shape == 'i' else -y)
    edge = scipy.integrate.cumulative_simpson(
        stress + 0.5 * poisson * depth * y, x=y, initial=0.0)
    edge += w[-1] - (edge[-1] if shape == 'box' else 0.0)
    moment = (2.0 * webs * scipy.integrate.simpson(x * w, x=x)
              + 4.0 * wall * 0.5 * depth * scipy.integrate.simpson(edge, x=y))
    angle = moment / second - 0.5 * poisson * (second - other) / area
    return twice * second / (area * angle)


def test_shear_coefficients_are_those_of_cowper():
    def coefficient(shape, poisson, **sizes):
        modulus = {'young_modulus': 1e9, 'shear_modulus': 0.5e9 / (1.0 + poisson)}
        section = {'shape': shape, 'width': WIDTH, 'height': HEIGHT, **sizes}
        return timo_sim.load_scene({}, {'arm': {'section': section, **modulus}}
                                   ).manipulator.arm.section.shear_coefficient
    for nu in (0.0, 0.3):
        assert coefficient('round', nu) == pytest.approx(6.0 * (1.0 + nu) / (7.0 + 6.0 * nu))
        assert coefficient('tube', nu, wall=1e-7) == pytest.approx(
            2.0 * (1.0 + nu) / (4.0 + 3.0 * nu))
        assert coefficient('box', nu, wall=1e-9, width=HEIGHT) == pytest.approx(
            20.0 * (1.0 + nu) / (48.0 + 39.0 * nu))
        assert coefficient('i', nu, wall=1e-10, web=WEB) == pytest.approx(
            10.0 * (1.0 + nu) / (12.0 + 11.0 * nu))
        assert coefficient('box', nu, wall=WALL) == pytest.approx(
            by_displacements('box', nu, WALL, 0.0))
        assert coefficient('i', nu, wall=WALL, web=WEB) == pytest.approx(
            by_displacements('i', nu, WALL, WEB))
    assert coefficient('rectangle', 0.3, shear_correction=0.7) == 0.7


MEASURED = {'mass_per_length': 0.3, 'rotary_inertia': 2e-5, 'bending_stiffness': 12.0,
            'shear_stiffness': 3e4, 'axial_stiffness': 2e6}


def test_measured_values_take_the_place_of_shape_and_material():
    """A slender arm has its frequency of them; closed form and Galerkin agree on a thick one."""
    arm = {'length': 0.8, 'section': {**MEASURED, 'rotary_inertia': 1e-9, 'shear_stiffness': 1e9}}
    bare = {'end_effector.mass': 0.0, 'end_effector.inertia': 0.0}
    omega = timo_sim.load_scene({}, {'arm': arm, **bare}).build().modes.omega[0]
    assert omega == pytest.approx(1.8751041**2 * np.sqrt(12.0 / (0.3 * 0.8**4)), rel=1e-6)
    thick, along = ({'arm': {'length': 0.3, **each}, 'model.axial_modes': 1,
                    'end_effector.inertia': 0.001} for each in (
        {'section': MEASURED}, {'profile': {'position': [0.0, 0.3], **{
            name: [value, value] for name, value in MEASURED.items()}}}))
    uniform, varying = (timo_sim.load_scene({}, each).build().modes
                        for each in (thick, along))
    assert uniform.omega == pytest.approx(varying.omega, rel=1e-9)


BLADE = {'arm.length': 117.0, 'arm.section.bending_stiffness': 3e9,
         'arm.section.mass_per_length': 500.0, 'arm.section.height': 2.0,
         'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, 'initial.shaft': 0.0,
         'carrier.held': 'both', 'motor.shaft': 'locked', 'model.modes': 5,
         'model.static_modes': 'none'}
UNIFORM = {'arm.section.bending_stiffness': 0.0, 'arm.section.mass_per_length': 0.0,
           'arm.profile.position': [0.0, 117.0], 'arm.profile.bending_stiffness': [3e9, 3e9],
           'arm.profile.mass_per_length': [500.0, 500.0]}


@pytest.mark.parametrize('profile', [{}, UNIFORM], ids=['uniform', 'profile'])
def test_stiffness_and_mass_alone_are_a_beam_of_euler_and_bernoulli(profile):
    """The limit: frequencies differ by `(beta l)^2 / 1e12` or round-off, deflections by 3e-6."""
    scene = timo_sim.load_scene({}, {**BLADE, **profile, 'load.tip_force_y.piecewise.time': [0.0],
                                     'load.tip_force_y.piecewise.value': [1e3]})
    # cos(beta l) cosh(beta l) = -1
    wave = np.array([scipy.optimize.brentq(
        lambda x: np.cos(x) + 1.0 / np.cosh(x), near - 0.5, near + 0.5, xtol=1e-14)
        for near in np.pi * (np.arange(20) + 0.5)])
    expected = wave**2 * np.sqrt(3e9 / 500.0) / 117.0**2
    assert timo_sim.modes(scene.vary({'model.modes': 20})).omega == pytest.approx(
        expected, rel=1e-8)
    model = timo_sim.linearize(scene).select(['tip_force_y_N'], ['tip_y_m', 'root_strain'])
    gains = model.frequency_response([0.0])[0, :, 0].real
    assert gains == pytest.approx([117.0**3 / 3.0 / 3e9, 117.0 / 3e9], rel=1e-5)
    run = timo_sim.simulate(scene, 0.01)
    assert run.stats['estimated_tip_error_m'] < 1e-4 and run.message.endswith(
        'the arm has no shear deformation, no rotary inertia, no stretch, since its bending '
        'stiffness and mass are measured and these are not')


def test_what_is_measured_beside_them_counts():
    """Beside the shear stiffness a blade sags by `F l / (kappa G A)` more."""
    shear = {'arm.section.shear_stiffness': 1e6, 'arm.section.axial_stiffness': 2e9,
             'arm.section.rotary_inertia': 50.0}
    with pytest.warns(timo_sim.ModelWarning, match='a length of 117 m'):
        scene = timo_sim.load_scene({}, {**BLADE, **shear, 'model.axial_modes': 1})
    assert not scene.left_out and scene.manipulator.arm.stretches
    gain = timo_sim.linearize(scene).select(['tip_force_y_N'], ['tip_y_m']).frequency_response(
        [0.0])[0, 0, 0]
    assert gain == pytest.approx(117.0**3 / 9e9 + 117.0 / 1e6, rel=1e-6)


@pytest.mark.parametrize('values, message', [
    ({'arm.section.mass_per_length': 0.0},
     'arm.section.mass_per_length must be > 0 with arm.section.bending_stiffness = 3e.09'),
    ({'arm.section.bending_stiffness': 0.0},
     'arm.section.bending_stiffness must be > 0 with arm.section.mass_per_length = 500'),
    ({'model.axial_modes': 1}, 'model.axial_modes must be 0 where .*axial_stiffness is not')])
def test_half_a_measured_section_is_refused(values, message):
    with pytest.raises(timo_sim.ParameterError, match=message):
        timo_sim.load_scene({}, {**BLADE, **values})


def test_materials_and_what_is_given_beside_them(tmp_path):
    values = timo_sim.load_scene({}, {'arm': {'material': 'steel', 'density': 2710.0}}).values
    assert values['arm.young_modulus'] == 210e9 and values['arm.density'] == 2710.0
    assert values['arm.shear_modulus'] == pytest.approx(210e9 / 2.6)
    brass = timo_sim.load_scene({}, values).vary({'arm.material': 'brass'})
    assert brass.values['arm.density'] == 8500.0
    # What is written down of a scene gives the same one again.
    assert timo_sim.load_scene(brass.values).values == brass.values
    log = timo_sim.simulate(timo_sim.load_scene({}, values), 0.01).save(tmp_path / 'run.mcap')
    assert timo_sim.open_log(log).scene.values == values


@pytest.mark.parametrize('section, message', [
    ({'shape': 'tube'}, 'wall must be > 0 with arm.section.shape = tube, got 0'),
    ({'wall': 0.001}, 'wall must be 0 with arm.section.shape = rectangle, got 0.001'),
    ({'shape': 'tube', 'wall': 0.02}, 'wall must be at most 0.01 m for arm.section.height'),
    ({'shape': 'i', 'wall': 0.001, 'web': 0.1}, 'web must be at most 0.02 m for'),
    ({'height': 0.01}, 'height is given twice'),
    ({'shape': 'ring'}, 'shape must be one of rectangle, round, tube, box, i')])
def test_sections_that_cannot_be_are_refused(section, message):
    with pytest.raises(timo_sim.ParameterError, match=f'arm.section.{message}'):
        timo_sim.load_scene({}, {'arm.section': section, **(
            {'arm.section.height': 0.02} if section == {'height': 0.01} else {})})


def profiled(positions, heights):
    """Return the model of an arm of 1 m with heights at positions."""
    return timo_sim.load_scene({}, {'arm': {
        'length': 1.0, 'section': {'width': WIDTH, 'height': HEIGHT}, 'density': 2700.0,
        'young_modulus': 7e10, 'shear_modulus': 2.6e10, 'profile': {
            'position': positions, 'height': heights}}}).build()


# A kink and a jump, and where they are.
PLACES, HEIGHTS = np.array([0.0, 0.3, 0.6, 0.6, 1.0]), np.array([0.04, 0.03, 0.035, 0.02, 0.01])


def test_a_profile_that_is_sampled_500_times_has_the_modes_of_its_kinks_and_jumps():
    fine = np.sort(np.concatenate([np.linspace(0.0, 1.0, 495), PLACES[1:4]]))
    heights = np.interp(fine, PLACES, HEIGHTS)
    heights[np.searchsorted(fine, 0.6)] = HEIGHTS[2]
    sampled, exact = profiled(fine.tolist(), heights.tolist()), profiled(PLACES, HEIGHTS)
    # To 1e-7 of the heights and therefore of the frequencies.
    assert sampled.modes.omega == pytest.approx(exact.modes.omega, rel=1e-7)


@pytest.mark.parametrize('count', [500, 100_000])
def test_a_profile_of_many_places_is_thinned_and_says_by_how_much(count):
    """Noise of one per cent, whose mean is that of an even arm, with as many nodes as it needs."""
    noise = 0.01 * np.random.default_rng(1).standard_normal(count)
    with pytest.warns(timo_sim.ModelWarning, match=f'{count} places, of which .* within [234]'):
        model = profiled(np.linspace(0.0, 1.0, count).tolist(), (0.02 * (1.0 + noise)).tolist())
    assert len(model.quadrature.nodes) <= 4 * 49  # four in each span between 50 places
    # The mean of 500 numbers deviates by 0.01 / sqrt(500); frequencies go with the height.
    even = profiled([0.0, 1.0], [0.02, 0.02])
    assert model.modes.omega == pytest.approx(even.modes.omega, rel=3.0 * 0.01 / np.sqrt(500))
