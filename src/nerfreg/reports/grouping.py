"""What may be compared: runs of one scene with as many views, scored on the same photographs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from nerfreg.reports.records import RunRecord


@dataclass(frozen=True, order=True)
class Setting:
    """scene, views: its name, and the number of training views. held_out: scored on held-out training views."""

    scene: str
    views: int
    held_out: bool

    @property
    def title(self) -> str:
        """As a heading: "fern, 3 views"."""
        views = "1 view" if self.views == 1 else f"{self.views} views"
        return f"{self.scene}, {views}" + (
            ", scored on held-out training views" if self.held_out else ""
        )

    @property
    def name(self) -> str:
        """As part of a file's name: "fern-3"."""
        return slug(f"{self.scene}-{self.views}" + ("-held-out" if self.held_out else ""))


def by_setting(records: Sequence[RunRecord]) -> dict[Setting, list[RunRecord]]:
    """Runs by what they may be compared in, scenes in the order of their names."""
    groups: dict[Setting, list[RunRecord]] = {}
    for record in records:
        groups.setdefault(Setting(record.scene, record.views, record.held_out), []).append(record)
    return dict(sorted(groups.items()))


def by_method(records: Sequence[RunRecord]) -> dict[str, list[RunRecord]]:
    """Runs by method, in the order in which methods appear."""
    groups: dict[str, list[RunRecord]] = {}
    for record in records:
        groups.setdefault(record.method, []).append(record)
    return groups


def slug(text: str) -> str:
    """Lower-case letters, digits, dots and single dashes: a name for a file or for a part of a page."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-") or "unnamed"
