"""Names that plugins import, and what a window and a union mean."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

import nerfreg
from nerfreg.hooks import Needs, Regularizer


def test_names_for_plugins_are_found_lazily() -> None:
    from nerfreg import hooks

    for name in ("Regularizer", "hookimpl", "Needs", "Rays", "Samples", "Rendering", "Step"):
        assert getattr(nerfreg, name) is getattr(hooks, name)
    assert {*nerfreg.__all__} <= {*dir(nerfreg)}
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = nerfreg.nothing


@pytest.mark.parametrize(
    ("start", "end", "active"),
    [
        (0.0, 1.0, [0, 1, 50, 99, 100]),
        (0, 1.0, [0, 1, 50, 99, 100]),
        (1, 50, [1]),  # [start, end): step 50 is out
        (0.5, 1.0, [50, 99, 100]),
        (0.0, 0.5, [0, 1]),
        (99, 100, [99]),
        (0.99, 100, [99]),  # one a fraction, the other a step
    ],
)
def test_window(step, start, end, active) -> None:
    plugin = Regularizer(start=start, end=end)
    assert [index for index in (0, 1, 50, 99, 100) if plugin.active(step(index=index))] == active


def test_needs_unite() -> None:
    patches = Needs(patch_size=4, patch_fraction=0.25, neighbors="patch")
    others = Needs(
        patch_size=2, patch_fraction=0.5, neighbors="extra", unseen_rays=0.1, unseen_patches=0.2
    )
    assert patches | others == others | patches == Needs(4, 0.5, "extra", 0.1, 0.2)
    assert Needs() | Needs() == Needs()


def test_a_subclass_keeps_the_base_fields_first() -> None:
    @dataclass
    class Plugin(Regularizer):
        extra: int = 3

    assert Plugin(0.5) == Plugin(weight=0.5, start=0.0, end=1.0, extra=3)
