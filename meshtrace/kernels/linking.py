"""Compilation of an entry point and all functions below it as one module.

numba optimises every function together with all that it calls and emits machine code for each,
of which only that of the entry points is ever called. Here functions below an entry point stay as
they are lowered until an entry point links them, each once. Optimisation and emission happen once
per entry point.
"""

from __future__ import annotations

from typing import Any

from llvmlite.binding import Linkage
from numba.core import codegen, compiler
from numba.core.environment import lookup_environment

_ENVIRONMENT = "_ZN08NumbaEnv"


class _NoEnvironments:
    """Stand-in of the code generator for code that is not emitted."""

    def set_env(self, name: str, environment: Any) -> None:
        """Set nothing: the entry point does."""


class _Lowered(codegen.JITCodeLibrary):
    """Code that is optimised as a whole only."""

    def add_llvm_module(self, ll_module: Any) -> None:
        """Add a module as it is."""
        self._final_module.link_in(ll_module)


class Part(_Lowered):
    """Code of a function below an entry point, neither optimised nor emitted."""

    def finalize(self) -> None:
        """Keep the libraries that the function calls for the entry point."""
        self._raise_if_finalized()
        self._finalize_dynamic_globals()
        self._finalized = True

    def own_module(self) -> Any:
        """Return the code of the function alone, to be linked."""
        return super()._get_module_for_linking()

    def _get_module_for_linking(self) -> Any:
        """Return the code with all that it calls, for callers that numba compiles."""
        own = self.own_module().clone()
        for module in _modules(self._linking_libraries):
            own.link_in(module, preserve=True)
        return own

    @property
    def codegen(self) -> _NoEnvironments:
        """Code generator, as far as it concerns emitted code."""
        return _NoEnvironments()

    def get_pointer_to_function(self, name: str) -> int:
        """Return null: nothing is emitted."""
        return 0


class Whole(_Lowered):
    """Code of an entry point with all that it calls."""

    def finalize(self) -> None:
        """Link every function below the entry point once, optimise and emit."""
        for module in _modules(self._linking_libraries):
            self._final_module.link_in(module, preserve=True)
        self._linking_libraries = []
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr and not function.is_declaration:
                function.linkage = Linkage.internal  # nothing else calls it: unused arguments go
        super().finalize()
        generator: Any = self._codegen
        for variable in self._final_module.global_variables:
            if variable.name.startswith(_ENVIRONMENT):
                environment = lookup_environment(variable.name)
                if environment is not None:
                    generator.set_env(variable.name, environment)

    def _optimize_final_module(self) -> None:
        manager, builder = self._codegen._module_pass_manager()
        with self._recorded_timings.record("Module passes", builder):
            manager.run(self._final_module, builder)


def _modules(libraries: list[Any]) -> list[Any]:
    """Return the modules of libraries and of all that they call, each once."""
    found: dict[Any, Any] = {}
    waiting = list(libraries)
    while waiting:
        library = waiting.pop()
        if library in found:
            continue
        if isinstance(library, Part):
            found[library] = library.own_module()
            waiting += library._linking_libraries
        else:
            found[library] = library._get_module_for_linking()
    return list(found.values())


class _Compiler(compiler.Compiler):
    """Compiler into a library of its own kind."""

    kind: type[_Lowered]

    def define_pipelines(self) -> Any:
        """Return the pipelines of numba."""
        state = self.state
        if state.library is None:
            state.library = self.kind(state.targetctx.codegen(), state.func_id.func_qualname)
            state.library.enable_object_caching()
        return super().define_pipelines()


class PartCompiler(_Compiler):
    """Compiler of a function below an entry point."""

    kind = Part


class WholeCompiler(_Compiler):
    """Compiler of an entry point."""

    kind = Whole
