"""How numba compiles here: what Python calls as a whole, what that calls only as far as a part.

Numba optimises each function together with all that it calls and makes machine code of it, and does
both again for whatever calls it. That was half of all compiling. A function called from within
another is here translated and no more; both are done once, for what Python calls.
"""

# mypy: disallow-untyped-calls=False

from __future__ import annotations

import gc
import os
from typing import Any

import numba
from llvmlite import binding
from numba.core import codegen, compiler
from numba.core.environment import lookup_environment

# What this and ``generated`` build on is private to numba: with releases on which it has not been
# tried, or where HANDCAL_PLAIN is set, all is compiled as numba does it, and products are plain
# loops. A first run takes half as long again then, and a later one a quarter.
TRIED = ("0.68.",)
LINKED = numba.__version__.startswith(TRIED) and not os.environ.get("HANDCAL_PLAIN")

# (numba's own are partly typed)
_Library: Any = codegen.JITCodeLibrary
_Result: Any = compiler.CompileResult


class _Nowhere:
    """In place of the engine of what is never run by itself."""

    def set_env(self, name: str, env: Any) -> None:
        """Nothing: what the part becomes part of sets it (see ``_Whole``)."""


class _Part(_Library):  # type: ignore[misc]
    """A function and those that it calls, to be linked into what calls it."""

    codegen = _Nowhere()

    def finalize(self) -> None:
        """Link what is called."""
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        """There is none."""
        self._ensure_finalized()
        return 0

    def serialize_using_object_code(self) -> tuple[str, str, Any]:
        """What is kept on disk."""
        self._ensure_finalized()
        return self.name, "part", self._final_module.as_bitcode()

    def read(self, data: bytes) -> None:
        """Become what was kept."""
        self._final_module = binding.parse_bitcode(data)
        self._finalize_dynamic_globals()
        self._finalized = True


class _Whole(_Library):  # type: ignore[misc]
    """What Python calls, with all that it calls."""

    def _finalize_specific(self) -> None:
        super()._finalize_specific()
        for variable in self._final_module.global_variables:
            env = lookup_environment(variable.name)
            if env is not None:
                self._codegen.set_env(variable.name, env)

    def serialize_using_object_code(self) -> tuple[str, str, Any]:
        """What is kept on disk: machine code, and the names in it (numba keeps the module as well,
        several times as long, to be linked into others)."""
        self._ensure_finalized()
        module = self._final_module
        named = [*module.functions, *module.global_variables]
        names = {v.name for v in named if not v.is_declaration}
        return self.name, "whole", (self._get_compiled_object(), names)

    def read(self, data: tuple[bytes, set[str]]) -> None:
        """Become what was kept."""
        self.enable_object_caching()
        self._set_compiled_object(data[0])
        self._finalize_final_module()
        self._codegen._engine._defined_symbols |= data[1]


_KINDS: dict[str, Any] = {"part": _Part, "whole": _Whole}


def readable(payload: tuple[Any, ...]) -> bool:
    """Whether ``rebuilt`` knows how to read this."""
    return payload[0][1] in _KINDS


def rebuilt(target: Any, payload: tuple[Any, ...]) -> Any:
    """The ``CompileResult`` of what was kept on disk, as numba rebuilds its own."""
    (name, kind, data), fndesc, env, signature, objectmode, lifted, note, init, envs = payload
    for begin in init:
        begin()
    library = _KINDS[kind](target.codegen(), name)
    library.read(data)
    entry = target.get_executable(library, fndesc, env)
    for other in envs:
        library.codegen.set_env(other.env_name, other)
    return _Result(
        target_context=target, typing_context=target.typing_context, library=library,
        environment=env, entry_point=entry, fndesc=fndesc, type_annotation=note,
        signature=signature, objectmode=objectmode, lifted=lifted, typing_error=None,
        call_helper=None, metadata=None, reload_init=init, referenced_envs=envs,
    )  # fmt: skip


class _Compiler(compiler.Compiler):
    """Numba's own but for the library that it ends in."""

    library: Any

    def define_pipelines(self) -> Any:
        """Numba's."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()


class Inside(_Compiler):
    """Of what is called from within another function."""

    library = _Part


class Outside(_Compiler):
    """Of what Python calls."""

    library = _Whole

    def _compile_core(self) -> Any:
        # (it makes millions of objects, and all of them are looked through again and again)
        collects = gc.isenabled()
        gc.disable()
        try:
            return super()._compile_core()
        finally:
            if collects:
                gc.enable()
