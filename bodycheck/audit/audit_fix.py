"""Write the corrected numbers of certain findings into a copy of a URDF, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.files import write_file
from bodycheck._util.formatting import names
from bodycheck.audit.audit import Audit, LintFinding
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.exact_arithmetic import doubles
from bodycheck.scenarios.model_files.urdf_text import Inertial, with_inertials
from bodycheck.scenarios.model_files.xml_file import read_bytes


def with_fix(audit: Audit, model: Path, out: Path) -> Audit:
    """Return an audit with a note on what was written to `out`.

    Raises InputError if the file is no URDF, or if its text cannot be changed without changing other links.
    """
    if audit.format != "urdf":
        raise InputError(f"--fix: writes URDF, not {audit.format}")
    certain = {
        one.link: one
        for one in audit.findings
        if one.confidence == "certain" and one.inertia_kg_m2 is not None
    }
    if not certain:
        note = f"Nothing written to {out}: no certain finding has corrected numbers."
        return replace(audit, notes=(*audit.notes, note))
    content = with_inertials(
        read_bytes(model), {name: Inertial(one.inertia_kg_m2, one.centre_m) for name, one in certain.items()}
    )
    write_file(out, content)
    try:
        _check(model, out, certain)
    except InputError:
        out.unlink()
        raise
    note = f"Written to {out}: the corrected numbers of {names(list(certain))}."
    return replace(audit, notes=(*audit.notes, note))


def _check(model: Path, out: Path, certain: dict[str, LintFinding]) -> None:
    """Raise InputError unless the new file states the corrected numbers, and the old ones of other links."""
    before, after = read_model(model), read_model(out)
    for old, new in zip(before.links, after.links, strict=True):
        finding = certain.get(old.name)
        if old.stated is None or new.stated is None:
            same = old.stated is new.stated
        else:
            tensor = doubles(old.stated.inertia.tensor)[np.triu_indices(3)].tolist()
            expected = tensor if finding is None else list(finding.inertia_kg_m2 or ())
            same = doubles(new.stated.inertia.tensor)[np.triu_indices(3)].tolist() == expected
        if not same:
            raise InputError(f"--fix: the text of link {old.name!r:.80} in {model} cannot be changed")
