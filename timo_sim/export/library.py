# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The object file of a scene: machine code of its entry points, constants, and the C interface.

Each entry point is optimised by itself, as for `Simulator`, and only then linked with the others,
so that the code of a step, and with it every bit of a run, is the same.
"""

from typing import Any, NamedTuple

from llvmlite import binding as llvm
from llvmlite import ir
import numpy as np

from timo_sim.compiled import machine
from timo_sim.compiled.constants import pack, Packed
from timo_sim.compiled.functions import Constants, WIDTH
from timo_sim.export import instance as steps
from timo_sim.export.constants import Interface, interface_of, plant_of, simulators_of
from timo_sim.export.instance import (
    Code, FORCES, Instance, KNOWN, LOST, MAGIC, MODAL, PART, SAVED, TIP)
from timo_sim.model.functions import tips
from timo_sim.model.layout import LOADS, STEP_LOADS
from timo_sim.model.statics import impact
from timo_sim.scene.scene import Scene
from timo_sim.simulation.loads import Actuators, tip_of, unit_loads_of
from timo_sim.steps.bristles import MEMORY
from timo_sim.steps.derivatives import entry_for
from timo_sim.steps.etdrk4 import advance
from timo_sim.steps.steps import Steps

_POINTER, _WORD, _INT, _REAL = ir.PointerType(), ir.IntType(64), ir.IntType(32), ir.DoubleType()
_ALIGNMENT = 8  # of the memory of an instance [B]
TEXTS = {
    Code.OK: 'no error',
    Code.NULL_POINTER: 'a pointer is null',
    Code.BAD_MEMORY: 'the memory is too small, or its address is no multiple of 8',
    Code.NOT_CREATED: 'the memory is no instance: create it first',
    Code.UNKNOWN_NUMBER: 'there is no input, output or parameter of this number',
    Code.NOT_FINITE: 'a value is not finite',
    Code.NEGATIVE_STEPS: 'the number of steps is negative',
    Code.BAD_STATE: 'the values are no saved state',
    Code.NOT_POSITIVE: 'a limit must be > 0',
    Code.TIP_CHANGES: 'the load at the tip changes before the next step',
    Code.DIVERGED: 'the run diverged: it is at the last good step; take a smaller time step',
}


class _Model:
    """Constants of a model of the library, and its entry points for their sizes."""

    def __init__(self, simulator, number, target, interface):
        self.number, self._target = number, target
        self.modules, self._functions = [], {}
        scene, model = simulator.scene, simulator.model
        # The loads at the tip in turn, each with tables and propagators of each linear part.
        self.sectors = range(model.sectors) if model.sectors else [None]
        tips = [simulator.integration, *(
            Steps(scene.build(tip, tip_of(scene)), scene.step, scene.bristles)
            for _, *tip in scene.payloads)]
        self.parts = [*zip(*(each.part(sector) for each in tips for sector in self.sectors))]
        self._tips, self.step = tips, scene.step
        self.tables, self.beyond, self.seen = zip(*(
            (each.model.packed, each.model.beyond.packed, each.model.seen.packed)
            for each in tips))
        self.bristles = tuple(each.bristles for each in tips)
        plant = plant_of(simulator, interface)
        self.plant = tuple(pack(plant._replace(linear=each.model.linear)) for each in tips)
        self.loads, self.actuators = (
            pack(scene.load.rows(scene.step)), Actuators(scene.values).packed)
        self.root, self.outline = pack(model.root), pack(model.outline)
        self.errors = scene.sensor_errors
        # The finer run has no sensors.
        self.senses = number == 0 and scene.has_sensor_errors
        self.delay = int(max(self.errors.delay))
        # What steps are differentiated by.
        self.differentiate, self.places = entry_for(model), model.free_places
        self.units = unit_loads_of(scene.values, [each.column for each in interface.inputs])
        self.instance = pack(Instance._make([
            np.zeros(1 + TIP), *3 * [np.zeros(LOADS)], *2 * [np.zeros(MEMORY)], *2 * [np.zeros(1)],
            *2 * [np.zeros(len(model.linear))], np.zeros((1, STEP_LOADS, LOADS)),
            np.zeros(WIDTH), *2 * [np.zeros(model.size)], *2 * [np.zeros(3)],
            np.zeros(len(interface.outputs)),
            np.zeros((self.senses * (1 + self.delay), len(self.errors.delay)))]))

    @property
    def blocks(self):
        """All constants, in an order that does not depend on their values."""
        return [*self.plant, self.loads, *self.tables, *self.beyond, *self.seen, self.actuators,
                self.root, self.outline, self.errors, *self.bristles,
                *(each for parts in self.parts for each in parts)]

    @property
    def linear(self):
        """What each propagator is made of, as `etdrk4.propagator` takes it."""
        return [each.model.in_sector(sector)[1].T
                for each in self._tips for sector in self.sectors]

    @property
    def length(self):
        """Length of an instance in memory, which its actuators follow [B]."""
        return self.instance.length + self.actuators.length

    @property
    def saved(self):
        """Count of numbers of a saved state."""
        return SAVED + self.instance.sizes['state'] + self.instance.late.size

    def specialise(self, entry, *constants):
        """Return the name of an entry point for constants of these sizes."""
        name = f'{entry.__name__}.{self.number}'
        if name not in self._functions:
            self.modules.append(machine.module_for_target(
                entry, constants, self._target, name,
                # The finer run is too large for the short registers of WebAssembly.
                compact=self.number > 0 and self._target.startswith('wasm')))
            self._functions[name] = entry
        return name


class _Body:
    """
    Writes LLVM's code of the library's functions.

    `models` are the scene's own and, if the error is estimated, the finer one; the memory of the
    second instance follows that of the first. In WebAssembly (`wasm`) a size_t has 32 bits, and
    constants are symbols, so that a page can put those of another scene in their place.
    """

    def __init__(self, models: list[_Model], interface: Interface, name: str,
                 wasm: bool) -> None:
        self.module, self.wasm = ir.Module(), wasm
        self.models, self.interface, self.name = models, interface, name
        self.builder: Any = None
        self.offsets = [0, models[0].length]
        self.size = sum(model.length for model in models)
        self._keys: dict[Any, int] = {}  # numbers of constants; packed ones are keys themselves

    @property
    def symbols(self):
        """Constants by the names of their symbols."""
        return {f'{self.name}_constants_{number}': key for key, number in self._keys.items()
                if isinstance(key, tuple)}

    # Pieces of code.

    def word(self, value):
        return ir.Constant(_WORD, value)

    def constant(self, name, kind, content, align=None):
        """Return the place of a constant, which is made once."""
        if name not in self.module.globals:
            made = ir.GlobalVariable(self.module, kind, name)
            made.initializer, made.align = ir.Constant(kind, content), align
            made.global_constant = not self.wasm
            made.linkage = '' if name.startswith(f'{self.name}_') else 'internal'
        return self.module.globals[name]

    def content(self, key, content, align=None):
        """Return the place of bytes; equal keys have the same place."""
        number = self._keys.setdefault(key, len(self._keys))
        name = (f'{self.name}_constants_{number}' if self.wasm and isinstance(key, tuple) else
                f'bytes.{number}')
        return self.constant(name, ir.ArrayType(ir.IntType(8), len(content)),
                             bytearray(content), align)

    def data(self, *packed: Packed) -> Any:
        """Return the place of constants; several of one kind stand one after another."""
        return self.content(packed, b''.join(
            bytes(each.memory[:each.length]) for each in packed), align=64)

    def text(self, value):
        """Return the place of a text."""
        return self.content(value, value.encode() + b'\0')

    def element(self, name, kind, values, place):
        """Return one of some constant values."""
        table = self.constant(name, ir.ArrayType(kind, len(values)), values)
        return self.builder.load(self.builder.gep(table, [
            ir.Constant(_INT, 0), self.builder.zext(place, _WORD)]), typ=kind)

    def at(self, pointer, offset):
        """Return a pointer moved by some bytes."""
        offset = self.word(offset) if isinstance(offset, int) else offset
        return self.builder.gep(pointer, [offset], source_etype=ir.IntType(8))

    def field(self, model, instance, name):
        return self.at(instance, model.instance.offsets[name])

    def mark(self, instance, number):
        return self.at(instance, 8 * number + self.models[0].instance.offsets['mark'])

    def read_mark(self, instance, number):
        return self.builder.load(self.mark(instance, number), typ=_WORD)

    def constants(self, model, instance, name):
        """Return constants of a model and an instance by name, and their place."""
        if name == 'instance':
            return model.instance, instance
        packed = getattr(model, name)
        if isinstance(packed, tuple):  # one for each load at the tip
            return self.one_of(packed, self.read_mark(instance, TIP) if len(packed) > 1 else 0)
        return packed, (self.at(instance, model.instance.length) if name == 'actuators' else
                        self.data(packed))

    def one_of(self, packed, number):
        """Return one of several constants of a kind, by its number, and its place."""
        place = self.data(*packed)
        return packed[0], place if isinstance(number, int) else self.at(
            place, self.builder.mul(number, self.word(packed[0].length)))

    def call(self, model, instance, entry, *arguments, **others):
        """Call an entry point with the constants of a model and an instance, or with `others`."""
        constants = [others.get(name) or self.constants(model, instance, name)
                     for name, kind in entry.arguments.items() if isinstance(kind, Constants)]
        name = model.specialise(entry, *(each for each, _ in constants))
        values = [*(place for _, place in constants), *arguments]
        if name not in self.module.globals:
            ir.Function(self.module, ir.FunctionType(_WORD, [each.type for each in values]), name)
        return self.builder.call(self.module.globals[name], values)

    def return_if(self, condition, value):
        with self.builder.if_then(condition):
            self.builder.ret(value)

    def equal(self, value, other):
        return self.builder.icmp_signed('==', value, ir.Constant(value.type, other))

    def function(self, name, result, *kinds):
        """Begin a function and return its arguments."""
        made = ir.Function(self.module, ir.FunctionType(result, kinds), name)
        self.builder = ir.IRBuilder(made.append_basic_block())
        return made.args

    # What each model does.

    def emit_choice_of_part(self, model, instance):
        """
        Emit a loop that looks for the linear part that is valid now, from the last one on.

        Return its tables and propagator by name, each with its place.
        """
        builder, count, number = self.builder, len(model.sectors), 0
        if len(model.tables) > 1:
            number = builder.mul(self.read_mark(instance, TIP), self.word(count))
        if count > 1:
            first_of_tip = number if len(model.tables) > 1 else self.word(0)
            part = self.read_mark(instance, PART)
            first, tries = builder.block, builder.append_basic_block()
            builder.branch(tries)
            builder.position_at_end(tries)
            sector, tried = builder.phi(_WORD), builder.phi(_WORD)
            sector.add_incoming(part, first)
            tried.add_incoming(self.word(1), first)
            number = builder.add(first_of_tip, sector)
            good = self.call(model, instance, steps.is_valid,
                             tables=self.one_of(model.parts[0], number))
            following = builder.urem(builder.add(sector, self.word(1)), self.word(count))
            sector.add_incoming(following, builder.block)
            tried.add_incoming(builder.add(tried, self.word(1)), builder.block)
            found = builder.append_basic_block()
            more = builder.icmp_signed('<', tried, self.word(count))
            builder.cbranch(builder.and_(self.equal(good, 0), more), tries, found)
            builder.position_at_end(found)
            builder.store(sector, self.mark(instance, PART))
        return {name: self.one_of(packed, number)
                for name, packed in zip(('tables', 'propagator'), model.parts)}

    def emit_advance(self, model, instance, count, every):
        memory, heat, motion, *given = (self.field(model, instance, name) for name in (
            'friction', 'heat', 'motion', 'state', 'load', 'loads'))
        given += [self.word(number) for number in (count, every, 0)]
        constants = self.emit_choice_of_part(model, instance)
        return self.call(model, instance, advance, memory, *given, motion, heat, **constants)

    def emit_change_of_tip(self, model, instance):
        """Emit the change of the load at the tip, if one is due before a step."""
        if len(model.tables) == 1:
            return
        due = self.call(model, instance, steps.tip_is_due)
        with self.builder.if_then(self.equal(due, 1)):
            self.emit_advance(model, instance, 0, 1)  # writes the motion
            added, motion = (self.field(model, instance, name) for name in ('place', 'motion'))
            rested = self.call(model, instance, steps.change_tip, added)
            with self.builder.if_then(self.equal(rested, 1)):
                self.call(model, instance, impact, added, motion)
            self.call(model, instance, steps.take_motion)

    def define_model_step(self, model):
        """Define the function that does one step of a model under commands."""
        instance, inputs = self.function(f'step.{model.number}', _WORD, _POINTER, _POINTER)
        self.call(model, instance, steps.prepare, inputs)
        self.emit_change_of_tip(model, instance)
        done = self.emit_advance(model, instance, 1, 0)
        self.builder.ret(self.call(model, instance, steps.finish, done))

    def define_model_observe(self, model):
        """Define the function that writes a model's motion and the place of its tip."""
        instance, = self.function(f'observe.{model.number}', _WORD, _POINTER)
        self.emit_advance(model, instance, 0, 1)
        self.call(model, instance, tips, self.field(model, instance, 'motion'), self.word(1),
                  self.field(model, instance, 'tip'))
        self.builder.ret(self.call(model, instance, steps.set_place))

    def define_follow(self):
        """Define the function that advances the finer run and compares the tips."""
        own, finer = self.models
        instance, = self.function('follow', _WORD, _POINTER)
        builder, other = self.builder, self.at(instance, self.offsets[1])
        place = self.field(finer, other, 'place')
        self.return_if(builder.not_(self.equal(self.read_mark(instance, LOST), 0)), self.word(0))
        for _ in range(self.interface.parts):
            code = builder.call(self.module.globals['step.1'],
                                [other, self.field(finer, other, 'inputs')])
            with builder.if_then(builder.not_(self.equal(code, 0))):
                builder.ret(self.call(own, instance, steps.compare, self.word(1), place))
        builder.call(self.module.globals['observe.0'], [instance])
        builder.call(self.module.globals['observe.1'], [other])
        builder.ret(self.call(own, instance, steps.compare, self.word(0), place))

    def define_finer(self):
        """Define what a controller of the finer run needs."""
        finer = self.models[1]
        instance, number, value = self.public('set_finer_input', _INT, _REAL)
        self.return_if_wrong(self.call(finer, self.at(instance, self.offsets[1]), steps.set_input,
                                       self.builder.sext(number, _WORD), value))
        self.emit_return()
        instance, values = self.public('get_finer', _POINTER)
        other = self.at(instance, self.offsets[1])
        self.builder.call(self.module.globals['observe.1'], [other])
        self.return_if_wrong(self.call(finer, other, steps.get_finer, values))
        self.emit_return()

    def define_refresh(self):
        """Define the function that computes outputs up to a stage of KNOWN, if they are not."""
        own = self.models[0]
        instance, stage = self.function('refresh', _WORD, _POINTER, _WORD)
        builder, known = self.builder, self.read_mark(instance, KNOWN)
        self.return_if(builder.icmp_signed('>=', known, stage), self.word(0))
        with builder.if_then(self.equal(known, 0)):
            builder.call(self.module.globals['observe.0'], [instance])
            self.call(own, instance, steps.set_outputs)
            self.emit_measurements(instance, 0, FORCES)
        with builder.if_then(self.equal(stage, 2)):
            self.call(own, instance, steps.set_forces)
            self.emit_measurements(instance, FORCES, MODAL)
        builder.ret(self.word(0))

    def emit_measurements(self, instance, begin, end):
        """Make readings of those outputs among some numbers that sensors measure."""
        if self.models[0].senses:
            self.call(self.models[0], instance, steps.measure, self.word(begin), self.word(end))

    def emit_measurement_for_later(self, instance):
        if self.models[0].senses and self.models[0].delay:
            self.builder.call(self.module.globals['refresh'], [instance, self.word(2)])

    # The functions of the interface.

    def fail_if(self, condition, code):
        self.return_if(condition, ir.Constant(_INT, int(code)))

    def is_null(self, pointer):
        return self.equal(self.builder.ptrtoint(pointer, _WORD), 0)

    def misaligned(self, pointer):
        address = self.builder.ptrtoint(pointer, _WORD)
        return self.builder.not_(self.equal(
            self.builder.and_(address, self.word(_ALIGNMENT - 1)), 0))

    def public(self, name, *kinds):
        """Begin a function of the interface, which checks its instance and other pointers."""
        instance, *arguments = self.function(f'{self.name}_{name}', _INT, _POINTER, *kinds)
        for each in (instance, *arguments):
            if each.type == _POINTER:
                self.fail_if(self.is_null(each), Code.NULL_POINTER)
        self.fail_if(self.misaligned(instance), Code.NOT_CREATED)
        self.fail_if(self.builder.not_(self.equal(self.read_mark(instance, 0), MAGIC)),
                     Code.NOT_CREATED)
        return instance, *arguments

    def emit_return(self):
        self.builder.ret(ir.Constant(_INT, 0))

    def return_if_wrong(self, code):
        self.return_if(self.builder.not_(self.equal(code, 0)), self.builder.trunc(code, _INT))

    def define(self, entries, *kinds, stage=None, models=1):
        """
        Define the function of the interface that calls entry points, the last of which names it.

        Before, outputs are computed up to a stage. Each of some models takes its part of an array.
        """
        instance, *given = self.public(entries[-1].__name__, *kinds)
        given = [self.builder.sext(each, _WORD) if each.type == _INT else each for each in given]
        if stage:
            self.builder.call(self.module.globals['refresh'], [
                instance, stage(given[0]) if callable(stage) else self.word(stage)])
        for entry in entries:
            begin = 0
            for model, each in [*self.each(instance)][:models]:
                self.return_if_wrong(self.call(model, each, entry, *(
                    self.at(one, begin) if one.type == _POINTER else one for one in given)))
                begin += 8 * model.saved
        self.emit_return()

    def stage_of(self, number):
        """Return the stage of KNOWN at which an output is known."""
        needs_forces = self.builder.icmp_unsigned(
            '<', self.builder.sub(number, self.word(FORCES)), self.word(MODAL - FORCES))
        return self.builder.select(needs_forces, self.word(2), self.word(1))

    def each(self, instance):
        """Yield the models with their instances."""
        for model, offset in zip(self.models, self.offsets):
            yield model, self.at(instance, offset)

    def reset_all(self, instance):
        for model, each in self.each(instance):
            self.call(model, each, steps.reset)
        self.emit_measurement_for_later(instance)
        self.emit_return()

    def copy(self, source, length, goal):
        for offset in range(0, length, 8):
            self.builder.store(self.builder.load(self.at(source, offset), typ=_WORD),
                               self.at(goal, offset))

    def define_memory(self):
        size_t = _INT if self.wasm else _WORD
        needed = ir.Constant(size_t, self.size)
        self.function(f'{self.name}_size', size_t)
        self.builder.ret(needed)
        memory, size = self.function(f'{self.name}_create', _INT, _POINTER, size_t)
        self.fail_if(self.is_null(memory), Code.NULL_POINTER)
        self.fail_if(self.misaligned(memory), Code.BAD_MEMORY)
        self.fail_if(self.builder.icmp_unsigned('<', size, needed), Code.BAD_MEMORY)
        for model, each in self.each(memory):  # the constants that functions change
            self.copy(self.data(model.actuators), model.actuators.length,
                      self.at(each, model.instance.length))
        self.reset_all(memory)
        instance, = self.public('reset')
        self.reset_all(instance)

    def define_step(self):
        instance, count = self.public('step', _WORD)
        own, builder = self.models[0], self.builder
        self.fail_if(builder.icmp_signed('<', count, self.word(0)), Code.NEGATIVE_STEPS)
        before, loop = builder.block, builder.append_basic_block()
        body, end = builder.append_basic_block(), builder.append_basic_block()
        builder.branch(loop)
        builder.position_at_end(loop)
        number = builder.phi(_WORD)
        number.add_incoming(self.word(0), before)
        builder.cbranch(builder.icmp_signed('<', number, count), body, end)
        builder.position_at_end(body)
        code = builder.call(self.module.globals['step.0'],
                            [instance, self.field(own, instance, 'inputs')])
        self.return_if_wrong(code)
        if len(self.models) > 1:
            builder.call(self.module.globals['follow'], [instance])
        self.emit_measurement_for_later(instance)
        number.add_incoming(builder.add(number, self.word(1)), builder.block)
        builder.branch(loop)
        builder.position_at_end(end)
        self.emit_return()

    def define_derivatives(self):
        own = self.models[0]
        instance, values = self.public('step_derivatives', _POINTER)
        if len(own.tables) > 1:
            self.fail_if(self.equal(self.call(own, instance, steps.tip_is_due), 1),
                         Code.TIP_CHANGES)
        # The step is not done, so its commands begin no lines: actuators are as before.
        _, actuators = self.constants(own, instance, 'actuators')
        kept = self.builder.alloca(_WORD, self.word(own.actuators.length // 8))
        self.copy(actuators, own.actuators.length, kept)
        self.call(own, instance, steps.prepare, self.field(own, instance, 'inputs'))
        self.copy(kept, own.actuators.length, actuators)
        places, units = (self.content(name, each.tobytes(), align=64) for name, each in (
            ('places', own.places), ('units', own.units)))
        rows = len(own.places) + len(own.units)
        slopes = [self.builder.alloca(_REAL, self.word(rows * width))
                  for width in (len(own.places), MEMORY)]
        state, memory, load, loads = (self.field(own, instance, name) for name in (
            'before', 'friction_before', 'load', 'loads'))
        self.call(own, instance, own.differentiate, places, self.word(1), state, memory, *slopes,
                  load, loads, self.word(1), units, self.word(len(own.units)), values,
                  **self.emit_choice_of_part(own, instance))
        self.emit_return()

    def define_calls(self):
        """Define the functions that are no more than calls."""
        both = len(self.models)
        self.define([steps.set_input], _INT, _REAL, models=both)
        self.define([steps.get_input], _INT, _POINTER)
        self.define([steps.set_parameter], _INT, _REAL, models=both)
        self.define([steps.get_parameter], _INT, _POINTER)
        self.define([steps.get_output], _INT, _POINTER, stage=self.stage_of)
        self.define([steps.get_outputs], _POINTER, stage=2)
        self.define([steps.get_shape], _POINTER, stage=1)
        self.define([steps.get_state], _POINTER, models=both)
        self.define([steps.check_state, steps.set_state], _POINTER, models=both)

    def define_texts(self):
        for name, texts in (
                ('error_text', [TEXTS[code] for code in Code]),
                ('input_name', [each.title for each in self.interface.inputs]),
                ('input_unit', [each.unit for each in self.interface.inputs]),
                ('output_name', [each.title for each in self.interface.outputs]),
                ('output_unit', [each.unit for each in self.interface.outputs]),
                ('parameter_name', [each.title for each in self.interface.parameters]),
                ('parameter_unit', [each.unit for each in self.interface.parameters])):
            number, = self.function(f'{self.name}_{name}', _POINTER, _INT)
            self.return_if(self.builder.icmp_unsigned(
                '>=', number, ir.Constant(_INT, len(texts))), self.text('unknown'))
            self.builder.ret(self.element(
                f'texts.{name}', _POINTER, [self.text(each) for each in texts], number))

    def write(self, derivatives: bool) -> ir.Module:
        """Return the module with all functions, those of derivatives if asked for."""
        for model in self.models:
            self.define_model_step(model)
            self.define_model_observe(model)
        if len(self.models) > 1:
            self.define_follow()
            self.define_finer()
        self.define_refresh()
        for define in (self.define_memory, self.define_calls, self.define_step,
                       *derivatives * [self.define_derivatives], self.define_texts):
            define()
        return self.module


class Library(NamedTuple):
    """An object file, and what its header says."""

    content: bytes
    interface: Interface
    size: int   # of the memory of an instance [B]
    saved: int  # count of numbers of a saved state
    motion: int  # count of numbers of a motion
    models: list[_Model]
    constants: dict[str, tuple[Packed, ...]]  # by symbol, which only WebAssembly has

    def constants_of(self, simulators: list[Any]) -> bytes:
        """
        Return the constants of other simulators of the same sizes, those of all symbols.

        In place of a propagator is its linear part, (m, m). Raises ValueError if sizes differ.
        """
        found, contents = {}, {}
        for model, simulator in zip(self.models, simulators, strict=True):
            other = _Model(simulator, model.number, '', self.interface)
            for own, each in zip(model.blocks, other.blocks, strict=True):
                if own.key != each.key:
                    raise ValueError(f'sizes of {own.kind.__name__} are others')
                if bytes(found.setdefault(id(own), each).memory) != bytes(each.memory):
                    raise ValueError(f'two of {own.kind.__name__} are not the same')
                contents[id(own)] = bytes(each.memory[:own.length])
            contents |= zip(map(id, model.parts[1]), (each.tobytes() for each in other.linear))
        return b''.join(contents[id(own)] for group in self.constants.values() for own in group)


def library(scene: Scene, estimate: bool, target: str, name: str,
            derivatives: bool = True) -> Library:
    """
    Return the object file of a scene and, to estimate its error, its finer run.

    `derivatives` says whether those of a step are there. For `target` see
    `compiled.machine.target_machine`; names of functions begin with `name`.
    """
    target_machine, interface = machine.target_machine(target), interface_of(scene, estimate)
    models = [_Model(each, number, target, interface)
              for number, each in enumerate(simulators_of(scene, estimate))]
    body = _Body(models, interface, name, target.startswith('wasm32'))
    module = llvm.parse_assembly(str(body.write(derivatives)))
    module.triple = str(target_machine.triple)
    module.data_layout = str(target_machine.target_data)
    for each in [part for model in models for part in model.modules]:
        module.link_in(each)
    for function in module.functions:
        if not function.is_declaration and not function.name.startswith(f'{name}_'):
            function.linkage = 'internal'
    return Library(content=target_machine.emit_object(module), interface=interface,
                   size=body.size, saved=sum(model.saved for model in models),
                   motion=models[0].instance.sizes['motion'], models=models,
                   constants=body.symbols)
