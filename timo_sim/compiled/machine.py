# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Machine code of entry points for given sizes, from LLVM's intermediate code.

Intermediate code has symbols in place of sizes (see `emit`). Here they get their values, LLVM
optimises the code and makes an object file of it, in which nothing refers to Python. It is kept
in the store and loaded. Code for any size gets the values at each call: it is several times
slower, and there is nothing to compile for another size.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
import functools
import gc
import hashlib
import threading
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from timo_sim.compiled import store
from timo_sim.compiled.functions import WIDTH

COMPILING = 'compiling once for a model of this size, this takes a second or two'
_TELL: ContextVar[Callable[[str], object] | None] = ContextVar('tell', default=None)
_LOCK = threading.RLock()
_ENTRY = 'entry'  # name of the function in intermediate code


@contextmanager
def telling(tell: Callable[[str], object] | None) -> Iterator[None]:
    """Call `tell` with a sentence before something is compiled in this block, once."""
    token = _TELL.set(tell)
    try:
        yield
    finally:
        _TELL.reset(token)


def symbols_of(constants: tuple[Any, ...]) -> dict[str, int]:
    """Return the values of the symbols in the code for some packed constants."""
    symbols = {}
    for each in constants:
        kind = each.kind.__name__
        found = {f'size.{name}': size for name, size in each.sizes.items()}
        found |= {f'size.{name}/{WIDTH}': size // WIDTH for name, size in each.sizes.items()}
        found |= {f'offset.{kind}.{name}': offset for name, offset in each.offsets.items()}
        found[f'length.{kind}'] = each.length
        for name, value in found.items():
            if symbols.setdefault(name, value) != value:
                raise ValueError(f'constants have {name} = {symbols[name]} and {value}')
    return symbols


def file_name(entry: Any, kinds: tuple[type, ...]) -> str:
    """Return the name of the file with the intermediate code of an entry point for some kinds."""
    names = (f'{kind.__module__.removeprefix("timo_sim.")}.{kind.__name__}' for kind in kinds)
    digest = store.digest_of_sources(entry.__module__, *(kind.__module__ for kind in kinds))
    # An older LLVM does not read the code of a newer one.
    return f'{entry.name}-{"-".join(names)}-{digest}-{llvmlite.__version__}.bc'


@functools.cache
def intermediate_code(entry: Any, kinds: tuple[type, ...]) -> bytes:
    """Return LLVM's bitcode of an entry point for constants of some kinds, of any size."""
    return store.read_or_make(file_name(entry, kinds), lambda: _emit(entry, kinds))


def _emit(entry, kinds):
    try:
        from timo_sim.compiled.emit import emit
    except Exception as error:  # of any kind: numba does not check what it reads
        raise ImportError('numba cannot be imported with its settings, NUMBA_* of the environment '
                          'or .numba_config.yaml in the working directory: '
                          + ' '.join(str(error).split())) from error
    collecting = gc.isenabled()
    gc.disable()  # while numba compiles, the collector frees little and takes a tenth of the time
    try:
        return emit(entry, kinds)
    finally:
        if collecting:
            gc.enable()


@functools.cache
def _initialise():
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


# Triple, processor and, where these are needed, features and ABI of LLVM for each target of an
# export but the host.
TARGETS = {'x86-64-v2': ('x86_64-unknown-linux-gnu', 'x86-64-v2'),
           'x86-64-v3': ('x86_64-unknown-linux-gnu', 'x86-64-v3'),
           'aarch64': ('aarch64-unknown-linux-gnu', 'generic'),
           'riscv64': ('riscv64-unknown-linux-gnu', 'generic-rv64', '+m,+a,+f,+d,+c', 'lp64d'),
           'wasm32': ('wasm32-unknown-unknown', 'generic'),
           'wasm32-simd128': ('wasm32-unknown-unknown', 'generic', '+simd128')}


def target_machine(name: str, reloc: str = 'pic', codemodel: str = 'default') -> Any:
    """
    Return LLVM's target machine of 'host', one of TARGETS or a GPU, with options of llvmlite.

    A GPU is named by its compute capability, such as sm_90.
    """
    _initialise()
    if name == 'host':
        triple, *options = (llvm.get_process_triple(), llvm.get_host_cpu_name(),
                            llvm.get_host_cpu_features().flatten())
    else:
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
        triple, *options = TARGETS.get(name, ('nvptx64-nvidia-cuda', name))
    return llvm.Target.from_triple(triple).create_target_machine(
        **dict(zip(('cpu', 'features', 'abiname'), options)), opt=3, reloc=reloc,
        codemodel=codemodel)


def _loading_machine():
    # In a process that loads it, code may be far from its constants.
    return target_machine('host', reloc='static', codemodel='large')


def specialise(code: bytes, symbols: dict[str, int], machine: Any, name: str,
               caller: str = '', compact: bool = False) -> Any:
    """
    Return a module of LLVM, optimised, whose one function has a name.

    It is made of `intermediate_code` with the values of `symbols_of`, for a target machine. Where
    all are None it is code for any size, which takes them in an array before other arguments.
    `caller` is intermediate code, as text, of a function of that name that calls `entry`. In
    `compact` code short loops alone are unrolled: it is faster where registers are few.
    """
    _initialise()
    module, any_size = llvm.parse_bitcode(code), None in symbols.values()
    module.link_in(llvm.parse_assembly(_taking(
        symbols, name, module.get_function(_ENTRY)) if any_size else ''.join(
            f'@"{symbol}" = constant i64 {value}\n' for symbol, value in symbols.items())
        + caller))
    module.triple, module.data_layout = str(machine.triple), str(machine.target_data)
    for each in [*module.functions, *module.global_variables]:
        if not each.is_declaration:
            each.linkage = 'internal'
    if not (any_size or caller):
        module.get_function(_ENTRY).name = name
    module.get_function(name).linkage = 'external'
    _optimise(module, machine, compact)
    return module


def _taking(symbols, name, entry):
    # Text of a function that sets variables to the values of symbols, and calls the entry.
    given = ', '.join(f'{each.type} %{k}' for k, each in enumerate(entry.arguments))
    return '\n'.join([
        f'declare i64 @{_ENTRY}({given})', *(f'@"{symbol}" = global i64 0' for symbol in symbols),
        f'define i64 @"{name}"(ptr %sizes, {given}) {{', *(
            f'%p{k} = getelementptr i64, ptr %sizes, i64 {k}\n%v{k} = load i64, ptr %p{k}\n'
            f'store i64 %v{k}, ptr @"{symbol}"' for k, symbol in enumerate(symbols)),
        f'%result = call i64 @{_ENTRY}({given})', 'ret i64 %result', '}'])


def module_for_target(entry: Any, constants: tuple[Any, ...], target: str, name: str,
                      compact: bool) -> Any:
    """Return the module of `specialise` for some constants' sizes; the store keeps it."""
    kinds, symbols = tuple(each.kind for each in constants), symbols_of(constants)
    own = _digest(entry, kinds, symbols, target)
    code = store.read_or_make(f'{own}{"-compact" * compact}.bc', lambda: specialise(
        intermediate_code(entry, kinds), symbols, target_machine(target), own,
        compact=compact).as_bitcode())
    _initialise()
    module = llvm.parse_bitcode(code)
    module.get_function(own).name = name
    return module


# A kernel: each of the first threads calls an entry point with its number.
KERNEL = 'arms'
_KERNEL = f"""
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
declare i64 @{_ENTRY}({{kinds}}, i64)
define ptx_kernel void @{KERNEL}({{given}}, i64 %count) {{{{
  %place = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %length = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %begin = mul i32 %block, %length
  %number = add i32 %begin, %place
  %thread = zext i32 %number to i64
  %needed = icmp slt i64 %thread, %count
  br i1 %needed, label %call, label %end
call:
  %result = call i64 @{_ENTRY}({{given}}, i64 %thread)
  br label %end
end:
  ret void
}}}}
"""


def ptx(entry: Any, constants: tuple[Any, ...], processor: str) -> bytes:
    """
    Return a kernel for GPUs, such as sm_90 or newer, as PTX, the text that their driver compiles.

    `entry` is one of threads, for some constants' sizes. The kernel, KERNEL, takes pointers for
    its arguments but the last, and then the number of threads.
    """
    kinds, symbols = tuple(each.kind for each in constants), symbols_of(constants)
    pointers = range(len(entry.arguments) - 1)
    kernel = _KERNEL.format(kinds=', '.join('ptr' for _ in pointers),
                            given=', '.join(f'ptr %a{k}' for k in pointers))

    def make():
        machine = target_machine(processor)
        return machine.emit_assembly(specialise(
            intermediate_code(entry, kinds), symbols, machine, KERNEL, kernel)).encode()
    return store.read_or_make(f'{_digest(entry, kinds, symbols, processor)}.ptx', make)


def _digest(entry, kinds, symbols, target):
    processor = (f'{llvm.get_process_triple()} {llvm.get_host_cpu_name()} '
                 f'{llvm.get_host_cpu_features().flatten()}'
                 if target == 'host' else target)
    key = f'{file_name(entry, kinds)} {sorted(symbols.items())} {processor}'
    return f'timo_{hashlib.sha256(key.encode()).hexdigest()[:24]}'


def _optimise(module, machine, compact):
    # Vectors are written in the source. Those that LLVM would make of the short loops that are
    # left are slower, and take longer to make.
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = False
    options.loop_unrolling = not compact  # then only short loops, before others grow
    builder = llvm.create_pass_builder(machine, options)
    # First sizes take the place of symbols, so that work arrays become stack slots of known
    # length; then functions become parts of their callers.
    first = llvm.create_new_module_pass_manager()
    first.add_global_opt_pass()
    first.add_sroa_pass()
    first.add_instruction_combine_pass()
    first.add_simplify_cfg_pass()
    first.add_always_inliner_pass()
    first.add_global_dead_code_eliminate_pass()
    if compact:
        first.add_loop_rotate_pass()
        first.add_loop_unroll_pass()
    first.run(module, builder)
    builder.getModulePassManager().run(module, builder)


@functools.cache
def _engine():
    return llvm.create_mcjit_compiler(llvm.parse_assembly(''), _loading_machine())


ADDRESSES: dict[str, int] = {}  # of the machine code that is loaded, by the stems of its files


def load(entry: Any, constants: tuple[Any, ...], any_size: bool = False) -> int:
    """
    Return the address of the machine code of an entry point for some constants' sizes.

    That for any size takes the sorted values of `symbols_of` before other arguments.
    """
    kinds = tuple(each.kind for each in constants)
    symbols: dict[str, Any] = symbols_of(constants)
    if any_size:
        symbols = dict.fromkeys(sorted(symbols))
    name = _digest(entry, kinds, symbols, 'host')
    with _LOCK:
        if name not in ADDRESSES:
            data = store.read_or_make(
                f'{name}.o', lambda: _compile(entry, kinds, symbols, name))
            _engine().add_object_file(llvm.ObjectFileRef.from_data(data))
            _engine().finalize_object()
            ADDRESSES[name] = _engine().get_function_address(name)
        return ADDRESSES[name]


def _compile(entry, kinds, symbols, name):
    tell = _TELL.get()
    if tell:
        tell(COMPILING)
        _TELL.set(None)
    optimised, machine = store.read(f'{name}.bc'), _loading_machine()  # that of an export
    return machine.emit_object(llvm.parse_bitcode(optimised) if optimised else specialise(
        intermediate_code(entry, kinds), symbols, machine, name))
