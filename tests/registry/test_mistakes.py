"""Each mistake of an author is told in one line that says what to write instead."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable
from importlib import invalidate_caches
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from nerfreg.registry import installed, mistakes, plugins
from nerfreg.registry.plugins import PluginInfo

TABLE = tomllib.loads(Path(__file__).with_name("mistakes.toml").read_text(encoding="utf-8"))


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], PluginInfo]:
    """Install a module `wrong` with a class `Wrong`, and return what becomes of it."""

    def load(code: str) -> PluginInfo:
        future = code.lstrip().startswith("from __future__")
        text = code.lstrip() if future else TABLE["preamble"] + code
        (tmp_path / "wrong.py").write_text(text, encoding="utf-8")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "wrong", raising=False)
        invalidate_caches()
        point = EntryPoint("wrong", "wrong:Wrong", plugins.GROUP)
        monkeypatch.setattr(plugins, "_entry_points", lambda: [point])
        [plugin] = installed()
        sys.modules.pop("wrong", None)
        return plugin

    return load


@pytest.mark.parametrize("mistake", TABLE["mistake"], ids=lambda mistake: mistake["what"])
def test_a_mistake_is_told(load, mistake: dict[str, str]) -> None:
    plugin = load(mistake["code"])
    assert (plugin.cls, plugin.error) == (None, mistake["message"])


RIGHT = """
from enum import Enum
from pathlib import Path
from typing import Any, Optional, Union


class Color(Enum):
    red = 1


@dataclass
class Part:
    size: int = 4


@dataclass
class Wrong(Regularizer):
    weight: float = 0.5
    mode: Literal["a", "b"] = "a"
    modes: list[Literal["a", "b"]] = field(default_factory=lambda: ["b"])
    maybe: Literal[1, 2] | None = None
    file: Path | None = None
    color: Color = Color.red
    part: Part = field(default_factory=Part)
    either: Union[int, str] = 3
    number: Optional[float] = None
    names: dict[str, list[float]] = field(default_factory=dict)
    anything: Any = None
    bound_weight: float = 0.1
    weights: list[float] = field(default_factory=list)
    color_inputs: int = 4
    schedulable: ClassVar[tuple[str, ...]] = ("bound_weight", "weight")
    in_evaluation: ClassVar[tuple[str, ...]] = ("nerfreg_rays",)
    conflicts = ("kl",)
    LIMIT = 3
    _count = 0

    def __post_init__(self):
        self.made = True

    @hookimpl(wrapper=True)
    def nerfreg_rays(self, rays, step):
        rays = yield
        return rays

    @hookimpl
    def nerfreg_color_input(this, samples):
        return samples
"""


def test_what_is_unusual_and_right_is_let_pass(load) -> None:
    assert load(RIGHT).error == ""


VERSIONED = """
@dataclass
class Wrong(Regularizer):
    hook_versions: ClassVar[tuple[int, int]] = {versions}

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {{}}
"""


@pytest.mark.parametrize(
    ("versions", "error"),
    [
        ((2, 2), ""),
        ((1, 4), ""),
        ((4, 4), ""),
        ((5, 5), "needs hooks version 5, this nerfreg has 4: upgrade nerfreg"),
        ((3, 3), ""),  # Version 4 changed a hook that it does not implement.
        (
            (1, 1),
            "was written for hooks version 1, and what it implements has changed since: "
            "nerfreg_loss (version 2); read their specification and set hook_versions",
        ),
        (
            (3, 2),
            "Wrong.hook_versions=(3, 2): must be the first and the last version, as in (4, 4)",
        ),
    ],
)
def test_versions_of_the_hooks(
    load, versions: tuple[int, int], error: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mistakes, "HOOKS_VERSION", 4)
    changed = {2: ("nerfreg_loss",), 3: (), 4: ("nerfreg_needs",)}
    monkeypatch.setattr(mistakes, "CHANGED", changed)
    assert load(VERSIONED.format(versions=versions)).error == error
