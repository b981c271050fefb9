# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Intermediate code of compiled functions, made by numba: the front end of the compiler.

The source is compiled for constants and arrays whose sizes are symbols, external numbers of LLVM's
code. numba infers types and writes this code; it optimises nothing and makes no machine code.
"""

import operator
import re
from typing import Any

from llvmlite import binding as llvm
from llvmlite import ir
from numba import njit  # noqa: F401  loads what the compiler needs
from numba.core import (
    cgutils, codegen, compiler, cpu, dispatcher, registry, target_extension, typed_passes, types,
    typing, untyped_passes)
from numba.core.compiler_lock import global_compiler_lock
from numba.core.imputils import lower_builtin, lower_getattr_generic
from numba.core.types import containers
from numba.core.typing.templates import AttributeTemplate, infer_getattr, signature
from numba.extending import typeof_impl

from timo_sim.compiled import duals, functions
from timo_sim.compiled.constants import fields_of, local_arrays
from timo_sim.compiled.duals import Constant, Dual, dual_of
from timo_sim.compiled.functions import (
    Array, Constants, Declaration, Function, Thread, WARP, WIDTH)
from timo_sim.compiled.lanes import (
    infer, intrinsic, Lanes, LANES, lanes_of, lower, Mask, represent, Shared, spread, THREAD)

# Sums may be reordered and fused, which vectorises the short loops; NaN and Inf keep their
# meaning, so that a diverged state is still seen ('fast' would assume them away).
FASTMATH = {'reassoc', 'contract', 'nsz'}
_OPTIONS: dict[str, Any] = {
    'error_model': 'numpy', 'no_cfunc_wrapper': True, 'no_cpython_wrapper': True, 'nopython': True,
    '_nrt': False, 'forceinline': True}
_WORD, _BYTES = ir.IntType(64), ir.IntType(8).as_pointer()


# Constants and arrays. Both are pointers; their sizes are known by type.

class View(types.Type):
    """An array: type of its elements, lengths of its axes, how far apart elements are."""

    def __init__(self, element: Any, dims: tuple[Any, ...], stride: int = 1) -> None:
        self.element, self.dims, self.stride = element, dims, stride
        super().__init__(f'View({element}, {dims})' + f'[::{stride}]' * (stride > 1))


class Block(types.Type):
    """
    Constants of a kind, or one block of them for each group of lanes.

    `number` is that of their floats: float64, Shared, Lanes, Constant.
    """

    def __init__(self, kind: type, number: Any, grouped: bool = False) -> None:
        self.kind, self.number, self.grouped = kind, number, grouped
        self.stride = getattr(number, 'stride', 1)
        self.fields = {field.name: field for field in fields_of(kind)}
        super().__init__(f'Block({kind.__module__}.{kind.__name__}, {number}, {grouped})')


def _stored(number):
    # The type of a number in memory.
    if isinstance(number, Dual):
        return ir.ArrayType(ir.DoubleType(), number.size)
    return number.vector if isinstance(number, Lanes) else (
        _WORD if number == types.int64 else ir.DoubleType())


def _loaded(number):
    # The type of a number that is loaded.
    return types.float64 if isinstance(number, Constant) else number


def _working(*numbers):
    # The type of numbers in work arrays beside others.
    return lanes_of(*numbers) or dual_of(*numbers) or types.float64


represent(View, lambda view: _stored(view.element).as_pointer())
represent(Block, lambda _: _BYTES)


def _symbol(builder, name):
    """Return the value of a symbol, or of a length that is a number."""
    if isinstance(name, int):
        return ir.Constant(_WORD, name)
    module = builder.module
    if name not in module.globals:
        ir.GlobalVariable(module, _WORD, name).global_constant = True
    return builder.load(module.globals[name])


def _length(builder, dim):
    return _symbol(builder, f'size.{dim}' if isinstance(dim, str) else dim)


def _load(builder, place, number):
    if isinstance(number, Dual):
        return duals.load(builder, place, number)
    value = builder.load(place)
    value.align = 8
    if isinstance(number, Shared):
        return spread(builder, value, number.vector)
    return value


def _number_of(block, field):
    return types.int64 if field.whole else block.number


@infer_getattr
class _BlockFields(AttributeTemplate):
    key = Block

    def generic_resolve(self, block, name):
        field = block.fields.get(name)
        if field is None:
            return None
        number = _number_of(block, field)
        return View(number, field.dims, block.stride) if field.dims else _loaded(number)


@lower_getattr_generic(Block)
def _field(context, builder, block, pointer, name):
    field = block.fields[name]
    number = _number_of(block, field)
    place = builder.gep(pointer, [_symbol(builder, f'offset.{block.kind.__name__}.{name}')],
                        inbounds=True)
    place = builder.bitcast(place, _stored(number).as_pointer())
    return place if field.dims else _load(builder, place, number)


@infer_getattr
class _ViewFields(AttributeTemplate):
    key = View

    def resolve_shape(self, view):
        return containers.UniTuple(types.intp, len(view.dims))


def _length_in_loops(builder, view, axis=0):
    # Duals need no vectors, and leave out what is padded.
    dim = view.dims[axis]
    padded = isinstance(dim, str) and dual_of(view.element)
    return _length(builder, dim.removeprefix('padded_') if padded else dim)


@lower_getattr_generic(View)
def _shape(context, builder, view, pointer, name):
    return cgutils.pack_array(builder, [
        _length_in_loops(builder, view, axis) for axis in range(len(view.dims))])


@infer(len)
def _infer_len(array):
    return signature(types.intp, array) if isinstance(array, View) else None


@lower_builtin(len, View)
def _len(context, builder, sig, arguments):
    return _length_in_loops(builder, sig.args[0])


def _indices(index):
    return tuple(index) if isinstance(index, containers.BaseTuple) else (index,)


@infer(operator.getitem)
def _infer_get_item(array, index):
    if isinstance(array, Block) and isinstance(array.number, (Lanes, Shared)):
        return signature(Block(array.kind, array.number), array, types.intp)
    if not isinstance(array, View):
        return None
    rest = array.dims[len(_indices(index)):]
    return signature(View(array.element, rest, array.stride) if rest else _loaded(array.element),
                     array, index)


@infer(operator.setitem)
def _infer_set_item(array, index, value):
    if not isinstance(array, View) or len(_indices(index)) != len(array.dims):
        return None
    return signature(types.none, array, index, array.element)


def _place(context, builder, view, pointer, kind, index):
    """Return the pointer to an element, or to the first one of a part of an array."""
    kinds = _indices(kind)
    indices = (cgutils.unpack_tuple(builder, index) if isinstance(kind, containers.BaseTuple)
               else [index])
    place = ir.Constant(_WORD, 0)
    for axis, dim in enumerate(view.dims):
        if axis:
            place = builder.mul(place, _length(builder, dim), flags=('nsw',))
        if axis < len(kinds):
            place = builder.add(place, context.cast(builder, indices[axis], kinds[axis],
                                                    types.intp), flags=('nsw',))
    if view.stride > 1:
        place = builder.mul(place, ir.Constant(_WORD, view.stride), flags=('nsw',))
    return builder.gep(pointer, [place], inbounds=True)


@lower_builtin(operator.getitem, View, types.Any)
def _get_item(context, builder, sig, arguments):
    view, index = sig.args
    place = _place(context, builder, view, arguments[0], index, arguments[1])
    return place if isinstance(sig.return_type, View) else _load(builder, place, view.element)


@lower_builtin(operator.getitem, Block, types.intp)
def _get_block(context, builder, sig, arguments):
    if not sig.args[0].grouped:  # what is shared is the same for each group of lanes
        return arguments[0]
    length = _symbol(builder, f'length.{sig.args[0].kind.__name__}')
    return builder.gep(arguments[0], [builder.mul(arguments[1], length, flags=('nsw',))],
                       inbounds=True)


@lower_builtin(operator.setitem, View, types.Any, types.Any)
def _set_item(context, builder, sig, arguments):
    view, index, _ = sig.args
    place = _place(context, builder, view, arguments[0], index, arguments[1])
    if isinstance(view.element, Dual):
        duals.store(builder, arguments[2], place)
    else:
        builder.store(arguments[2], place).align = 8


# Functions of `functions`.

@infer(functions.local)
def _infer_local(like):
    return signature(View(_working(*(view.element for view in like)),
                          tuple(view.dims[0] for view in like)), like)


@lower_builtin(functions.local, types.Any)
def _local(context, builder, sig, arguments):
    return _allocate(builder, sig.return_type)


def _allocate(builder, view):
    with builder.goto_entry_block():
        size = ir.Constant(_WORD, 1)
        for dim in view.dims:
            size = builder.mul(size, _length(builder, dim))
        place = builder.alloca(_stored(view.element), size)
        place.align = 64
    return place


@infer(local_arrays)
def _infer_local_arrays(kind, like):
    views = [View(_working(like.number), field.dims) for field in fields_of(kind.instance_class)]
    return signature(containers.BaseTuple.from_types(views, kind.instance_class), kind, like)


@lower_builtin(local_arrays, types.NamedTupleClass, Block)
def _local_arrays(context, builder, sig, arguments):
    return context.make_tuple(builder, sig.return_type,
                              [_allocate(builder, view) for view in sig.return_type.types])


def _define_intrinsic(function, name):
    """Define a function of floats and lanes as an intrinsic function of LLVM."""
    @infer(function)
    def _infer_call(value):
        if isinstance(value, Dual):  # `duals` has its code
            return signature(types.float64 if function is functions.floor else value, value)
        kind = lanes_of(value) or types.float64
        return signature(kind, kind)

    lower(function, types.Any)(lambda builder, value: intrinsic(builder, name, value))


_define_intrinsic(functions.floor, 'floor')
_define_intrinsic(functions.magnitude, 'fabs')
_define_intrinsic(functions.square_root, 'sqrt')


@infer(functions.where)
def _infer_where(condition, yes, no):
    result = lanes_of(condition, yes, no) or dual_of(yes, no) or types.float64
    return signature(result, condition, result, result)


lower(functions.where, types.Any, types.Any, types.Any)(ir.IRBuilder.select)
infer(functions.some)(lambda condition: signature(types.boolean, condition))
infer(functions.value_of)(lambda number: signature(
    types.float64 if isinstance(number, Dual) else number, number))
infer(functions.chain)(lambda value, slope, number: signature(
    dual_of(number) or value, value, slope, number))
infer(functions.with_derivatives)(lambda array: signature(
    View(types.float64, (*array.dims, array.element.size)), array))
infer(functions.without_derivatives)(lambda constants: signature(
    Block(constants.kind, types.float64), constants))


@lower_builtin(functions.value_of, types.Any)
@lower_builtin(functions.chain, types.Any, types.Any, types.Any)
@lower_builtin(functions.sum_of, types.Any, View)
def _first(context, builder, sig, arguments):
    return arguments[0]


@lower_builtin(functions.as_vectors, View)
@lower_builtin(functions.with_derivatives, View)
@lower_builtin(functions.without_derivatives, Block)
def _as_other(context, builder, sig, arguments):
    return builder.bitcast(arguments[0], context.get_value_type(sig.return_type))


@lower_builtin(functions.some, types.Any)
def _some(context, builder, sig, arguments):
    if not isinstance(sig.args[0], Mask):
        return arguments[0]
    bits = builder.bitcast(arguments[0], ir.IntType(sig.args[0].width))
    return builder.icmp_unsigned('!=', bits, ir.Constant(bits.type, 0))


def _view_of_vectors(view):
    if view.element != types.float64:
        return view
    *first, last = view.dims
    return View(LANES, (*first, f'{last}/{WIDTH}' if isinstance(last, str) else last // WIDTH))


@infer(functions.as_vectors)
def _infer_as_vectors(given):
    if isinstance(given, View):
        return signature(_view_of_vectors(given), given)
    views = [_view_of_vectors(view) if str(view.dims[-1]).startswith('padded') else view
             for view in given.types]
    return signature(containers.BaseTuple.from_types(views, given.instance_class), given)


@lower_builtin(functions.as_vectors, containers.BaseNamedTuple)
def _all_as_vectors(context, builder, sig, arguments):
    pointers = cgutils.unpack_tuple(builder, arguments[0])
    return context.make_tuple(builder, sig.return_type, [
        builder.bitcast(pointer, context.get_value_type(view))
        for pointer, view in zip(pointers, sig.return_type.types)])


@infer(functions.sum_of)
def _infer_sum_of(vector, like):
    if dual_of(like.element):
        return signature(vector, vector, like)
    lanes = lanes_of(like.element)
    return signature(lanes or types.float64, lanes or LANES, like)


@lower_builtin(functions.sum_of, Lanes, View)
def _sum_of(context, builder, sig, arguments):
    # Halves are added to each other, in an order that no optimiser changes.
    value, width, index = arguments[0], WIDTH, ir.IntType(32)
    if isinstance(sig.return_type, Lanes):
        return value
    nothing = ir.Constant(value.type, ir.Undefined)
    while width > 1:
        width //= 2
        order = ir.Constant(ir.VectorType(index, WIDTH), [
            (lane + width) % WIDTH for lane in range(WIDTH)])
        value = builder.fadd(value, builder.shuffle_vector(value, nothing, order))
    return builder.extract_element(value, ir.Constant(index, 0))


# The target: code of a processor that is not chosen yet.

class _Library(codegen.AOTCodeLibrary):
    def _optimize_functions(self, module):
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        # numba links all that a function calls to it, again for each caller.
        self._finalized = True

    def linked(self) -> Any:
        """Return the module with those of all functions that are called."""
        found, left = dict[int, Any](), [self]
        while left:
            for each in left.pop()._linking_libraries:
                if id(each) not in found:
                    found[id(each)] = each
                    left.append(each)
        for each in found.values():
            self._final_module.link_in(each._get_module_for_linking(), preserve=True)
        return self._final_module

    def get_pointer_to_function(self, name: str) -> int:
        return 0


class _Codegen(codegen.AOTCPUCodegen):
    _library_class = _Library

    def set_env(self, name: str, environment: Any) -> None:
        pass

    def magic_tuple(self) -> tuple[Any, ...]:
        return ()


class _Context(cpu.CPUContext):
    def init(self) -> None:
        super().init()
        self._internal_codegen = _Codegen('timo_sim')


class _Typing(typing.Context):
    """Finds the type of an operation on types once; numba tries all that it knows each time."""

    def __init__(self) -> None:
        super().__init__()
        self._found: dict[Any, Any] = {}

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        if kws or not isinstance(func, types.Function):
            return super().resolve_function_type(func, args, kws)
        key = func, tuple(args)
        if key not in self._found:
            found = super().resolve_function_type(func, args, kws)
            if found is None:
                return None
            self._found[key] = found, func.get_impl_key(found)
        found, implementation = self._found[key]
        # Types of functions are those of all targets: numba may have compiled it for another one.
        shared: Any = func
        shared._impl_keys[found.args] = implementation
        return found


class _Target(registry.CPUTarget):
    @property
    def _toplevel_typing_context(self):
        if '_typing' not in self.__dict__:
            self.__dict__['_typing'] = _Typing()
        return self.__dict__['_typing']

    @property
    def _toplevel_target_context(self):
        if '_context' not in self.__dict__:
            self.__dict__['_context'] = _Context(self.typing_context, self._target_name)
        return self.__dict__['_context']


class _AnyProcessor(target_extension.CPU):
    """The name of the target, for functions of numba that are compiled for it."""


target_extension.target_registry['timo_sim'] = _AnyProcessor
_TARGET = _Target('timo_sim')


# Passes for what compiled functions do not have: closures, `with`, array expressions, and such.
_UNUSED = {
    untyped_passes.DeadBranchPrune, untyped_passes.FindLiterallyCalls,
    untyped_passes.InlineClosureLikes, untyped_passes.InlineInlinables,
    untyped_passes.LiteralPropagationSubPipelinePass, untyped_passes.LiteralUnroll,
    untyped_passes.MakeFunctionToJitFunction, untyped_passes.RewriteDynamicRaises,
    untyped_passes.RewriteSemanticConstants, untyped_passes.WithLifting,
    typed_passes.AnnotateTypes, typed_passes.DumpParforDiagnostics, typed_passes.InlineOverloads,
    typed_passes.NoPythonSupportedFeatureValidation, typed_passes.NopythonRewrites}


class _Passes(compiler.CompilerBase):
    def define_pipelines(self) -> list[Any]:
        default = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes = compiler.PassManager('timo_sim')
        for each, what in default.passes:
            if each not in _UNUSED:
                passes.add_pass(each, what)
        passes.finalize()
        return [passes]


class _Compiler(dispatcher.Dispatcher):
    targetdescr = _TARGET

    def __init__(self, function: Any, targetoptions: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=targetoptions, pipeline_class=_Passes)


def _compile_for_numba(*_, **options):
    # What numba's own functions are written with, in place of `njit`.
    kept = {name: options[name] for name in ('inline', 'fastmath') if name in options}
    return lambda function: _Compiler(function, targetoptions=_OPTIONS | kept)


target_extension.dispatcher_registry[_AnyProcessor] = _Compiler
target_extension.jit_registry[_AnyProcessor] = _compile_for_numba


class _Choice(_Compiler):
    """The dispatcher of a `Declaration`: it chooses a body by the type of the first argument."""

    declaration: Declaration

    def _body(self, args):
        kind, bodies = getattr(args[0], 'kind', None), self.declaration.bodies
        if kind not in bodies:
            raise TypeError(f'{self.declaration.__name__} has no body for {args[0]}')
        of_duals = bodies.get((kind, 'duals')) if dual_of(args[0].number) else None
        return _compiler_of(of_duals or bodies[kind])

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return self._body(args).get_call_template(args, kws)

    def get_overload(self, args: Any) -> Any:
        return self._body(args).get_overload(args)


_COMPILERS: dict[Function, Any] = {}


def _compiler_of(function):
    if function not in _COMPILERS:
        options = {**_OPTIONS, 'fastmath': FASTMATH if function.fast else False,
                   'forceinline': function.merge}
        if isinstance(function, Declaration):
            _COMPILERS[function] = choice = _Choice(function.function, targetoptions=options)
            choice.declaration = function
        else:
            _COMPILERS[function] = _Compiler(function.function, targetoptions=options)
    return _COMPILERS[function]


@typeof_impl.register(Function)
def _typeof(function, _):
    return types.Dispatcher(_compiler_of(function))


def _type_of(argument, kind, lanes):
    if isinstance(argument, Constants):
        number = {'floats': types.float64, 'shared': Shared(lanes.width), 'lanes': lanes}[
            argument.form]
        return Block(kind, Constant(argument.duals) if argument.duals else number,
                     argument.form == 'lanes')
    if isinstance(argument, Array):
        number = lanes if argument.lanes else types.int64 if argument.whole else types.float64
        return View(number, argument.dims, lanes.stride if argument.lanes else 1)
    return {int: types.int64, float: types.float64, Thread: types.int64}[argument]


@global_compiler_lock
def emit(entry: Any, kinds: tuple[type, ...]) -> bytes:
    """
    Return LLVM's bitcode of an entry point; its function is called `entry`.

    `kinds` are those of its constants, in the order of arguments.
    """
    rest, lanes = list(kinds), THREAD if entry.threads else LANES
    arguments = tuple(
        _type_of(argument, rest.pop(0) if isinstance(argument, Constants) else None, lanes)
        for argument in entry.arguments.values())
    compiler = _compiler_of(entry)
    compiler.compile(arguments)
    result = compiler.overloads[arguments]
    library = result.library.codegen.create_library(entry.name)
    library.add_linking_library(result.library)
    library.add_ir_module(_entry_module(result, library, entry.threads))
    # LLVM must not turn loops into calls of the C library.
    module = llvm.parse_assembly(re.sub(
        r'^(define .*)\{$', r'\1"no-builtins" {', str(library.linked()), flags=re.MULTILINE))
    for each in [*module.functions, *module.global_variables]:
        if not each.is_declaration and each.name != 'entry':
            each.linkage = 'internal'
    machine = library.codegen._tm
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=1))
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_sroa_pass()
    # What does not depend on sizes is combined here once, not again for each size.
    passes.add_instruction_combine_pass()
    passes.add_simplify_cfg_pass()
    passes.run(module, builder)
    return module.as_bitcode()


def _entry_module(result, library, threads):
    """
    Return a module with a function `entry` of plain C that calls a compiled function.

    With threads, its last argument is the number of one, whose lane arrays of lanes begin at.
    """
    context, sig = result.target_context, result.signature
    module = context.create_module('entry')
    natives = [context.get_value_type(kind) for kind in sig.args]
    function = ir.Function(module, ir.FunctionType(_WORD, natives), 'entry')
    builder = ir.IRBuilder(function.append_basic_block())
    called = cgutils.get_or_insert_function(
        module, context.call_conv.get_function_type(sig.return_type, sig.args),
        result.fndesc.llvm_func_name)
    given = list(function.args)
    if threads:
        lane = builder.srem(given[-1], ir.Constant(_WORD, WARP))
        given = [builder.bitcast(builder.gep(
            builder.bitcast(each, ir.DoubleType().as_pointer()), [lane], inbounds=True), each.type)
            if getattr(kind, 'stride', 1) > 1 else each
            for kind, each in zip(sig.args, given)]
        given[-1] = builder.sdiv(given[-1], ir.Constant(_WORD, WARP))
    _, value = context.call_conv.call_function(
        builder, called, sig.return_type, sig.args, given)
    builder.ret(ir.Constant(_WORD, 0) if sig.return_type == types.none else value)
    return module
