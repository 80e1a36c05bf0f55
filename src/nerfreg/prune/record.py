"""A study as strict JSON, from which all of it can be traced."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from nerfreg.prune.ledger import flat
from nerfreg.prune.summary import Summary, set_points
from nerfreg.prune.verdicts import Finding


def record(summary: Summary, command: Sequence[str], preset: str) -> dict[str, Any]:
    """All of it, for `prune.json`: strict JSON; ends that are not known are null."""
    outcome, design = summary.outcome, summary.design
    content = {
        "command": list(command),
        "scene": summary.scene,
        "views": summary.views,
        "budget": summary.budget,
        "spent": summary.ledger.spent,
        "tolerance": summary.tolerance,
        "design": {**asdict(design), "first_look": design.first_look},
        "contributions": [_finding(finding) for finding in outcome.findings.values()],
        "sets": [
            vars(point) | {"gain": asdict(point.gain), "time": asdict(point.time)}
            for point in set_points(design, summary.ledger)
        ],
        "proposals": outcome.proposals,
        "confirmations": [asdict(confirmation) for confirmation in outcome.confirmations],
        "pruned": outcome.pruned,
        "dropped": [name for name in design.full if name not in outcome.pruned],
        "preset": preset,
        "budget_needed": summary.advice,
        "trials": [{**flat(trial), **asdict(m)} for trial, m in summary.ledger.trials.items()],
    }
    strict: dict[str, Any] = _strict(content)
    return strict


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        **asdict(finding.comparison),
        "steps": finding.steps,
        "error": finding.error,
        "gain": asdict(finding.gain),
        "time": asdict(finding.time),
        "verdict": finding.verdict.value,
    }


def _strict(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): _strict(item) for key, item in value.items()}
    return [_strict(item) for item in value] if isinstance(value, list | tuple) else value
