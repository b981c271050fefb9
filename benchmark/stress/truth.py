# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Judges the scenes of the stress test by references.

A scene is run with its step; its tip is compared with

- finer: `exact` equations with twelve modes (a rigid arm stays one), steps of a tenth (with dry
  friction of a twentieth), and an arm that stretches;
- elements: spectral elements of an arm that stretches (`test/oracles/spectral_elements.py`).

A run is

- accurate: the tip stays within a thousandth of the arm's length of the reference;
- flagged: it does not, and the run says so (`ModelWarning`);
- refused: a ParameterError or a DivergenceError says why;
- silent: none of these. There must be none;
- open: no verdict, because the reference itself is not known to a third of the distance. This is
  found by a run with fewer modes (elements with polynomials of lower order), twice its step, and a
  tip that begins 1e-9 lengths off. Where that alone, with the same modes and step, grows to 1e-5
  lengths or more, the scene is `sensitive`: no run can predict its tip.
"""

from dataclasses import replace
from functools import cached_property
import math

import numpy as np

from oracles import spectral_elements
import timo_sim
from timo_sim.runs.simulate import measure_error
from timo_sim.runs.run import run_scene

ACCURATE, SEEN = 1e-3, 1e-6  # [lengths]
VERDICTS = ['accurate', 'flagged', 'refused', 'silent', 'open']
_PUSH, _SENSITIVE = 1e-9, 1e-5  # [lengths]
# Modes in bending and axial ones of the reference, and of the run that shows its error.
_MODES, _FEWER = (12, 1), (8, 1)
_ORDER, _LOWER, _ELEMENTS = 10, 8, 2  # the same for spectral elements, by order; their number
_MOST_STEPS = 1e7  # of the spectral elements for a scene


def family(cell):
    """Return whose equations a Cell has: exact, or newton and its relatives."""
    return 'exact' if cell.values['model.formulation'] == 'exact' else 'newton'


def judge(cell):
    """
    Return what became of a Cell.

    Returns
    -------
    list of dict
        Against each reference: 'number', 'kind', 'family', 'against', 'verdict', 'error',
        'estimate', 'doubt' about the error [lengths], 'warning' or None, and 'sensitive', whether
        the scene is.

    """
    run = _run(cell, {}, looked_at=True)
    references = {'finer': _Finer(cell)}
    if cell.elements and _element_steps(cell) < _MOST_STEPS:
        references['elements'] = _Elements(cell, references['finer'])
    return [{'number': cell.number, 'kind': cell.kind, 'family': family(cell),
             'against': against, **_verdict(cell, reference, *run)}
            for against, reference in references.items()]


def _verdict(cell, reference, path, stats, warning):
    found = {'verdict': 'refused', 'error': math.nan, 'estimate': math.nan, 'doubt': 0.0,
             'warning': warning, 'sensitive': False}
    if path is None:
        return found
    error = reference.distance(path)
    doubt, sensitive = (0.0, False) if error <= SEEN else reference.doubt
    verdict = ('accurate' if error + doubt <= ACCURATE else
               'open' if sensitive or not doubt <= error / 3.0 else
               'flagged' if warning else 'silent')
    return {**found, 'verdict': verdict, 'error': error, 'doubt': doubt, 'sensitive': sensitive,
            'estimate': stats['estimated_tip_error_m'] / cell.values['arm.length']}


class _Finer:
    """The reference by more modes and smaller steps."""

    def __init__(self, cell):
        self._cell = cell
        self.parts = 20 if 'motor.coulomb_friction' in cell.values else 10  # of a step

    @cached_property
    def path(self):
        """Where the tip is, shape (n, 2) [m], or None if the reference fails."""
        return self.path_of(_MODES, self.parts)

    def distance(self, path, other=None):
        """Return the largest distance of a path, (n, 2) [m], in lengths; nan if there is none."""
        other = self.path if other is None else other
        if other is None or path is None:
            return math.nan
        return float(np.linalg.norm(path - other, axis=1).max() / self._cell.values['arm.length'])

    @cached_property
    def doubt(self):
        """How far the reference may be off [lengths], and whether the scene is sensitive."""
        doubt = self.distance(self.path_of(_FEWER, self.parts // 2, _PUSH))
        if doubt < _SENSITIVE:
            return doubt, False
        pushed = self.path_of(_MODES, self.parts, _PUSH)
        return doubt, not self.distance(pushed) < _SENSITIVE

    def path_of(self, size, parts, push=0.0):
        """Return the path with modes in bending and axial ones, begun with a push [lengths]."""
        values, (modes, axial) = self._cell.values, size
        if not values['model.modes']:
            modes = axial = 0
        rest = np.zeros(modes + axial)
        rest[:1] = values.get('initial.modal_coordinates', [0.0])[0]
        changes = {'model.formulation': 'exact', 'model.modes': modes, 'model.axial_modes': axial,
                   'initial.modal_coordinates': rest.tolist(),
                   'integrator.step': values['integrator.step'] / parts}
        if push and modes:
            reach = timo_sim.load_scene({}, {**values, **changes}).build().tip_travel[3]
            rest[0] += push * values['arm.length'] / reach
            changes['initial.modal_coordinates'] = rest.tolist()
        return _run(self._cell, changes, parts)[0]


class _Elements:
    """The reference by spectral elements; those of a lower order show its error."""

    def __init__(self, cell, finer):
        self._cell, self._finer, self.path = cell, finer, _elements(cell, _ORDER)

    def distance(self, path):
        """Return the largest distance of a path, shape (n, 2) [lengths]."""
        return self._finer.distance(path, self.path)

    @cached_property
    def doubt(self):
        """How far the reference may be off [lengths], and whether the scene is sensitive."""
        return self.distance(_elements(self._cell, _LOWER)), self._finer.doubt[1]


def _elements(cell, order):
    values = cell.values
    scene = timo_sim.load_scene({}, {**values, 'model.axial_modes': 0,
                                     'initial.modal_coordinates': []})
    return spectral_elements.simulate(
        scene, values['integrator.step'] * cell.every, cell.steps // cell.every, order=order,
        elements=_ELEMENTS)[2]


def _run(cell, changes, parts=1, looked_at=False):
    """Return the path of the tip, shape (n, 2) [m], statistics and warning; or None, None, why."""
    try:
        scene = replace(timo_sim.load_scene({}, {**cell.values, **changes}),
                        keeps_axial=not looked_at)  # a reference has its axial vibrations
        run = run_scene(scene, parts * cell.steps, parts * cell.every)
        if looked_at:  # as `simulate` does
            run = measure_error(run)
        return run.position(cell.values['arm.length']), run.stats, run.warning
    except (timo_sim.ParameterError, timo_sim.DivergenceError) as error:
        return None, None, str(error)


def _element_steps(cell):
    # A step is half the stable one: 1 over the highest frequency, which is about that of
    # sections turning in place and of the finest wave.
    scene = timo_sim.load_scene(cell.values)
    arm, section = scene.manipulator.arm, scene.manipulator.arm.section
    turning = math.sqrt(section.shear_stiffness / section.inertia_per_length)
    wave = math.sqrt(section.axial_stiffness / section.mass_per_length)
    return cell.steps * scene.step * math.hypot(turning, wave * _ORDER**2 * _ELEMENTS / arm.length)
