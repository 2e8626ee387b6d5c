"""Compilers of numba that link kernels as a whole: less time to compile, and less code.

numba optimises every function together with all that it calls and emits machine code for each,
of which only that of the entry points is ever called. Here functions below an entry point stay as
they are lowered until an entry point links them, each once. Optimisation and emission happen once
per entry point.

A kernel hands some fifty arrays on in nested tuples. numba passes every scalar of them as an
argument of its own, 625 for a photon, and copies the whole tuple at each use of a field: that was
two thirds of all code before optimisation. Here inlined functions take tuples as they are, and
variables that are assigned once stay values.
"""

from __future__ import annotations

import copy
from typing import Any, NoReturn

import numba
from llvmlite.binding import Linkage, parse_assembly
from numba.core import codegen, compiler, ir, lowering, typed_passes
from numba.core.analysis import compute_cfg_from_blocks, compute_use_defs, must_use_alloca
from numba.core.callconv import CPUCallConv
from numba.core.compiler_machinery import register_pass
from numba.core.cpu import CPUContext
from numba.core.environment import lookup_environment
from numba.core.imputils import user_function

LINKED = numba.__version__.startswith("0.68.")
"""Whether these compilers fit the installed numba, on whose internals they rest.

Others compile in their usual way, which is slower.
"""

_ENVIRONMENT = "_ZN08NumbaEnv"  # with which names of environments start, see `_environments`


class _NoEnvironments:
    """Stand-in for the code generator of code that is not emitted."""

    def set_env(self, name: str, environment: Any) -> None:
        """Set nothing: the entry point does."""


class _Lowered(codegen.JITCodeLibrary):
    """Code that is optimised as a whole rather than function by function."""

    def add_llvm_module(self, ll_module: Any) -> None:
        """Add a module as it is, where numba would optimise it first."""
        self._final_module.link_in(ll_module)


class Part(_Lowered):
    """Code of a function below an entry point, neither optimised nor emitted."""

    def finalize(self) -> None:
        """End the code without linking: the entry point links the libraries that it calls."""
        # as numba's own method, less linking and optimisation
        self._raise_if_finalized()
        self._finalize_dynamic_globals()
        self._finalized = True

    def own_module(self) -> Any:
        """Return the code of the function alone, to be linked."""
        return super()._get_module_for_linking()

    def _get_module_for_linking(self) -> Any:
        """Return the code with all that it calls, for callers that numba compiles."""
        whole = self.own_module().clone()
        for module in _modules(self._linking_libraries):
            whole.link_in(module, preserve=True)
        return whole

    @property
    def codegen(self) -> _NoEnvironments:
        """Code generator, a stand-in: numba would set environments in emitted code."""
        return _NoEnvironments()

    def get_pointer_to_function(self, name: str) -> int:
        """Return null: nothing is emitted."""
        return 0


class Whole(_Lowered):
    """Code of an entry point with all that it calls."""

    def finalize(self) -> None:
        """Link every function below the entry point once, optimise and emit."""
        environments = set(_environments(self._final_module))
        for module in _modules(self._linking_libraries):
            self._final_module.link_in(module, preserve=True)
        self._linking_libraries = []
        for name in set(_environments(self._final_module)) - environments:
            # dropped if unused, as nearly all are: each load of the kernel would restore them
            self._final_module.get_global_variable(name).linkage = Linkage.linkonce_any
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr and not function.is_declaration:
                # nothing outside calls it: the optimiser may drop its unused arguments
                function.linkage = Linkage.internal
        # The base class optimises and emits; it asks for one module, which now has all.
        super().finalize()
        # An environment holds the constants and messages of errors that a function raises.
        generator: Any = self._codegen
        for name in _environments(self._final_module):
            environment = lookup_environment(name)
            if environment is not None:
                generator.set_env(name, environment)

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, bytes]]:
        """Return name, kind and code as numba pickles them, with stubs in place of the bitcode."""
        # numba saves the bitcode for callers that link it. Entry points have none, and numba reads
        # no more than the names that it defines.
        names = (f.name for f in self._final_module.functions if not f.is_declaration)
        stubs = "\n".join(f'@"{name}" = global i8 0' for name in names)
        return (
            self.name,
            "object",
            (self._get_compiled_object(), parse_assembly(stubs).as_bitcode()),
        )

    def _get_module_for_linking(self) -> NoReturn:
        """Refuse a call from a kernel: entry points are called from Python alone."""
        raise TypeError(f"{self.name} is an entry point, which kernels do not call")

    def _optimize_final_module(self) -> None:
        manager, builder = self._codegen._module_pass_manager()
        with self._recorded_timings.record("Module passes", builder):
            manager.run(self._final_module, builder)


def _environments(module: Any) -> list[str]:
    """Return the names of the environments, Python objects of a function, in a module."""
    names = (variable.name for variable in module.global_variables)
    return [name for name in names if name.startswith(_ENVIRONMENT)]


def _modules(libraries: list[Any]) -> list[Any]:
    """Return the modules of libraries and of all that they call, each once."""
    # a dictionary in place of a set, for the same order and the same code in every run
    modules: dict[Any, Any] = {}
    waiting = list(libraries)
    while waiting:
        library = waiting.pop()
        if library in modules:
            continue
        # numba's own functions arrive with all that they call; parts name what they call.
        if isinstance(library, Part):
            modules[library] = library.own_module()
            waiting += library._linking_libraries
        else:
            modules[library] = library._get_module_for_linking()
    return list(modules.values())


class _Values:
    """Packer that passes arguments as they are, where numba passes their scalars one by one."""

    def __init__(self, context: Any, argtypes: Any) -> None:
        self.argument_types = [context.get_value_type(argtype) for argtype in argtypes]

    def as_arguments(self, builder: Any, values: Any) -> Any:
        """Return the arguments of a call."""
        return values

    def from_arguments(self, builder: Any, args: Any) -> Any:
        """Return the values of arguments."""
        return args

    def assign_names(self, args: Any, names: Any) -> None:
        """Leave arguments without names."""


class _ByValue(CPUCallConv):
    """Convention of calls of functions that are always inlined."""

    def _get_arg_packer(self, argtypes: Any) -> _Values:
        return _Values(self.context, argtypes)


class _InlineContext(CPUContext):
    """Context in which the function itself is declared and called by the convention `_ByValue`."""

    @property
    def call_conv(self) -> _ByValue:
        """Convention of the function, not of those that it calls."""
        return _ByValue(self)


def _by_value(context: Any) -> Any:
    """Return the same context for functions that are always inlined."""
    inline = copy.copy(context)
    inline.__class__ = _InlineContext
    return inline


class _Context(CPUContext):
    """Context that registers inlined functions with their convention, for any caller."""

    def insert_user_function(self, func: Any, fndesc: Any, libs: Any = ()) -> None:
        """Register the implementation of a function."""
        call = user_function(fndesc, libs)
        if not fndesc.inline:
            self._defns[func].append(call, call.signature)
            return

        def inlined_call(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return call(_by_value(context), builder, sig, args)

        inlined_call.libs = call.libs  # type: ignore[attr-defined]
        self._defns[func].append(inlined_call, call.signature)


class _Lower(lowering.Lower):
    """Lowering of kernels to less code than numba's own."""

    def setup_function(self, fndesc: Any) -> None:
        """Declare the function."""
        if not fndesc.inline:
            return super().setup_function(fndesc)
        context, self.context = self.context, _by_value(self.context)
        super().setup_function(fndesc)
        self.context = context

    def extract_function_arguments(self) -> Any:
        """Return the values of the arguments."""
        if not self.fndesc.inline:
            return super().extract_function_arguments()
        self.fnargs = self.call_conv.get_arguments(self.function)
        return self.fnargs

    def _find_singly_assigned_variable(self) -> None:
        """Find variables that need no memory: assigned once, in a block that dominates all uses."""
        # numba finds those that one block alone assigns and uses. Those of others it deletes, and
        # counts down, in any block.
        super()._find_singly_assigned_variable()
        if self.context.enable_nrt or self.generator_info is not None:
            return
        blocks = self.func_ir.blocks
        homes: dict[str, list[int]] = {}
        for label, block in blocks.items():
            for assignment in block.find_insts(ir.Assign):
                homes.setdefault(assignment.target.name, []).append(label)
        users: dict[str, list[int]] = {}
        for label, names in compute_use_defs(blocks).usemap.items():
            for name in names:
                users.setdefault(name, []).append(label)
        dominators = compute_cfg_from_blocks(blocks).dominators()
        in_memory = must_use_alloca(blocks)
        for name, labels in homes.items():
            home = labels[0]
            # blocks are lowered in the order of their labels
            if (
                len(labels) == 1
                and name not in in_memory
                and all(home < user and home in dominators[user] for user in users.get(name, ()))
            ):
                self._singly_assigned_vars.add(name)


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(typed_passes.BaseNativeLowering):
    """Lowering of kernels."""

    _name = "kernel_lowering"  # type: ignore[assignment]

    @property
    def lowering_class(self) -> type[_Lower]:
        """Class that lowers a function."""
        return _Lower


class _Compiler(compiler.Compiler):
    """Compiler that produces `Part` or `Whole` libraries."""

    kind: type[_Lowered]

    def define_pipelines(self) -> Any:
        """Return the pipelines of numba."""
        state = self.state
        state.targetctx.__class__ = _Context  # numba copies it for each function
        # Else numba makes a library of its own kind, optimised and emitted at once.
        if state.library is None:
            state.library = self.kind(state.targetctx.codegen(), state.func_id.func_qualname)
            state.library.enable_object_caching()
        (passes,) = super().define_pipelines()
        passes.passes = [
            (_Lowering if p is typed_passes.NativeLowering else p, name)
            for p, name in passes.passes
        ]
        return [passes]


class PartCompiler(_Compiler):
    """Compiler of a function below an entry point."""

    kind = Part


class WholeCompiler(_Compiler):
    """Compiler of an entry point."""

    kind = Whole
