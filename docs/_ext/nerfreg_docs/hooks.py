"""Which hooks are called in evaluation, as the specifications say."""

from __future__ import annotations

from nerfreg_docs.docstrings import summary
from nerfreg_docs.markdown import plain, table


def hooks_in_evaluation() -> str:
    """The hooks that are called when views are rendered, and what they do."""
    from nerfreg.hooks import ALWAYS_IN_EVALUATION, IN_EVALUATION_IF_ASKED, HookSpecs

    groups = {
        "always": ALWAYS_IN_EVALUATION,
        "for plugins that name it in `Regularizer.in_evaluation`": IN_EVALUATION_IF_ASKED,
    }
    rows = [
        [_link(name), when, plain(summary(getattr(HookSpecs, name)))]
        for when, names in groups.items()
        for name in names
    ]
    return table(["hook", "called in evaluation", "what it does"], rows)


def _link(name: str) -> str:
    return f"{{py:meth}}`{name} <nerfreg.hooks.specs.HookSpecs.{name}>`"
