"""Lets numba compile a helper as a part of the loops that call it, and not by itself as well.

Numba makes every function that a loop calls fast and turns it into machine code, and then does both
again with the loop that it becomes a part of. Nothing but loops calls a helper, so that the first
half of the work, a seventh of the time to compile everything, is for nothing.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

_NOT_NEEDED = {
    "InlineClosureLikes",
    "InlineInlinables",
    "InlineOverloads",
    "LiteralPropagationSubPipelinePass",
    "LiteralUnroll",
    "NopythonRewrites",
}
"""Steps for closures, expressions of whole arrays and the like, which no helper has."""


class _Part(JITCodeLibrary):
    """The code of a helper as it was written."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        # loops find its code by a function of C, which is never called
        key = object().__sizeof__
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=key)
        return True


class PartCompiler(CompilerBase):
    """Compiles what only loops call."""

    def define_pipelines(self) -> list[Any]:
        """Return the steps of numba that are needed, with another one to end with."""
        steps = DefaultPassBuilder.define_nopython_pipeline(self.state)
        steps.passes = [
            (_Lowering if step is NativeLowering else step, text)
            for step, text in steps.passes
            if step.__name__ not in _NOT_NEEDED
        ]
        return [steps]
