"""An audit as plain data that can be read again, for the shards of an audit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import read_json
from bodycheck.reports.audit.audit import (
    Audit,
    Body,
    Column,
    Comparison,
    Difference,
    Finding,
    LinkAudit,
    Spin,
)

AUDIT_FILE = "audit.json"


def write_audit(audit: Audit, folder: Path, **facts: Any) -> None:
    """Write an audit and facts about it to audit.json in a folder."""
    told = {**facts, "audit": asdict(audit)}
    text = json.dumps(told, default=np.ndarray.tolist)
    (folder / AUDIT_FILE).write_text(text + "\n", encoding="utf-8")


def read_audit(folder: Path) -> tuple[Audit, dict[str, Any]]:
    """Read an audit and the facts about it; raises InputError with one line if it cannot be read."""
    path = folder / AUDIT_FILE
    try:
        told = dict(read_json(path))
        return _audit(told.pop("audit")), told
    except FileNotFoundError:
        raise InputError(f"{path}: missing: not a shard of an audit") from None
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a shard of an audit: {error!r}") from None


def _audit(told: Mapping[str, Any]) -> Audit:
    lists = {
        "columns": tuple(Column(**one) for one in told["columns"]),
        "links": tuple(map(_link, told["links"])),
        "findings": tuple(Finding(**one) for one in told["findings"]),
    }
    return Audit(**{**told, **lists})


def _link(told: Mapping[str, Any]) -> LinkAudit:
    parts = {
        "stated": _body(told["stated"]),
        "held": {name: _comparison(one) for name, one in told["held"].items()},
        "spins": {name: Spin(**one) for name, one in told["spins"].items()},
    }
    return LinkAudit(**{**told, **parts})


def _comparison(told: Mapping[str, Any]) -> Comparison:
    difference = told["difference"]
    parts = {
        "expected": _body(told["expected"]),
        "held": _body(told["held"]),
        "difference": None if difference is None else Difference(**difference),
        "causes": tuple(told["causes"]),
        "merged": tuple(told["merged"]),
    }
    return Comparison(**{**told, **parts})


def _body(told: Mapping[str, Any] | None) -> Body | None:
    if told is None:
        return None
    centre, tensor = (np.array(told[name], dtype=np.float64) for name in ("centre_m", "inertia_kg_m2"))
    if centre.shape != (3,) or tensor.shape != (3, 3):
        raise ValueError(f"a body with a centre of shape {centre.shape} and a tensor of {tensor.shape}")
    return Body(float(told["mass_kg"]), centre, tensor)
