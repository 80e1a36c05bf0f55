"""The files of `conf`: what can be chosen for a group, and which defaults a choice sets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from nerfreg_docs.markdown import code, plain, table

CONF = Path(__file__).parents[3] / "conf"


def read(group: str, choice: str) -> dict[str, Any]:
    """The content of one file, without its defaults list."""
    content = yaml.safe_load((CONF / group / f"{choice}.yaml").read_text(encoding="utf-8"))
    return {key: value for key, value in content.items() if key != "defaults"}


def chosen(group: str) -> str:
    """The choice that `conf/config.yaml` makes for a group."""
    content = yaml.safe_load((CONF / "config.yaml").read_text(encoding="utf-8"))
    for entry in content["defaults"]:
        if isinstance(entry, dict) and group in entry:
            return str(entry[group])
    raise KeyError(f"conf/config.yaml chooses nothing for {group}")


def summary(path: Path) -> str:
    """The comment at the head of a file, but for Hydra's package directive."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        if not line.startswith("# @package"):
            lines.append(line.removeprefix("#").strip())
    return " ".join(lines)


def choices_table(group: str) -> str:
    """What `conf` offers for a group."""
    prefix = "" if (CONF / "config.yaml").read_text().find(f"- {group}:") >= 0 else "+"
    rows = [
        [code(f"{prefix}{group}={path.stem}"), plain(summary(path))]
        for path in sorted((CONF / group).glob("*.yaml"))
    ]
    return table(["choice", "meaning"], rows)
