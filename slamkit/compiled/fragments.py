"""Compiled functions that become machine code only within those that call them. Importing this module imports Numba.

Left to itself Numba optimises a function by itself, then again within each caller, and again within each caller's
caller: seven times for what stands at the bottom of a step. A fragment is checked and translated once, and optimised
with everything around it where it ends up.
"""

# mypy: disable-error-code="misc, no-untyped-def, no-untyped-call"
# Numba has no type information.

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class Fragment(JITCodeLibrary):
    """Code that waits for the function that it is linked into."""

    def add_llvm_module(self, ll_module: Any) -> None:
        """Take it as it is."""
        self._final_module.link_in(ll_module)

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """None, which Numba writes as 0."""
        return 0

    @property
    def codegen(self) -> Fragment:
        """Where Numba wants to enter a function's environment."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Without machine code there is no place for one; only code that works on objects of Python reads it."""


class FragmentCompiler(Compiler):
    """Numba's compiler, to a fragment."""

    def __init__(self, typing_context: Any, target_context: Any, library: Any, *rest: Any) -> None:
        super().__init__(typing_context, target_context, Fragment(target_context.codegen(), "fragment"), *rest)
