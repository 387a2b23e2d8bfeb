"""Measure the import audit: real files, generated valid files, planted slips and faults.

python tools/audit_trials.py real [FOLDER ...]      every URDF, MJCF and SDF file below the folders
python tools/audit_trials.py real --read-only [FOLDER ...]   read and lint them, without engines
python tools/audit_trials.py valid --files 500      false differences in generated files
python tools/audit_trials.py stages --files 300      one clear line per damaged USD stage
python tools/audit_trials.py converters --trials 300   planted faults of converters to USD
python tools/audit_trials.py joints --trials 240  one slip in a joint of each random file
python tools/audit_trials.py slips --trials 2000    links with one planted slip and their shapes
python tools/audit_trials.py healthy --trials 2000  right links: uniform, of several densities, rounded
python tools/audit_trials.py size --trials 1000     the time to lint so many links
"""

from __future__ import annotations

import random
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from trials import command

from bodycheck._util.errors import InputError
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.audit.audit import SINGLE, LintFinding
from bodycheck.audit.audit_against import audit_against
from bodycheck.audit.audit_run import (
    AuditOptions,
    checked_engines,
    imported_audit,
)
from bodycheck.audit.lint import lint
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.xml_file import read_bytes
from tests.helpers import usd_stages
from tests.helpers.model_texts import mutated, random_mjcf, random_urdf, sdf_of
from tests.helpers.slipped_joints import JOINT_SLIPS, MJCF_SLIPS, joint_text, slipped, slipped_mjcf
from tests.helpers.slipped_links import SLIPS, Link, chain, changes_enough, is_right, random_link

IMPORTERS = ("mujoco:recommended", "pybullet:recommended", "dart:default")
_ROOTS = re.compile(b"<(robot|mujoco|sdf)\\b")


def real(*folders: Path, every: int = 1, read_only: bool = False) -> None:
    """Audit real files without spins, or only read and lint them.

    Prints outcomes, findings, causes with an example, and the slowest files.
    """
    files = _models(folders)[::every]
    outcomes: Counter[str] = Counter()
    causes: Counter[str] = Counter()
    examples: dict[str, str] = {}
    slow: list[tuple[float, str]] = []
    engines = [] if read_only else checked_engines(None)
    with closing(EnginePool()) as pool, np.errstate(all="ignore"):
        for place, path in enumerate(files):
            root = _ROOTS.search(read_bytes(path))
            assert root is not None
            began = time.monotonic()
            try:
                found = imported_audit(pool, read_model(path), engines, AuditOptions(spins=False))
            except InputError as error:
                outcomes[f"{root[1].decode()} refused"] += 1
                print(f"  {error}")
                continue
            except Exception as error:  # noqa: BLE001 - the trial searches for any exception
                outcomes["faults of the audit itself"] += 1
                print(f"FAULT {path}: {type(error).__name__}: {error}")
                continue
            each = (time.monotonic() - began) / max(len(found.links), 1) / max(len(found.columns), 1)
            slow.append((each, path.name))
            outcomes[f"{root[1].decode()} read"] += 1
            outcomes.update(f"{one.severity} {one.rule}" for one in found.findings)
            for column in found.columns:
                outcomes[f"{column.name} {column.outcome}"] += 1
                if column.outcome in ("timeout",) or "killed" in column.message:
                    print(f"  {path.name} {column.name} {column.outcome}: {column.message[:150]}")
            for link, name, one in found.differing():
                for cause in one.split("; "):
                    kind = f"{name}: {_kind(cause)}"
                    causes[kind] += 1
                    examples.setdefault(kind, f"{path.name} {link.name}")
                    if "no known fault" in cause:
                        print(f"  unexplained: {path.name} {link.name} {name}: {cause}")
            if sys.stderr.isatty():
                print(f"{place + 1} of {len(files)}", end="\r", file=sys.stderr)
    print(f"{len(files)} files")
    for what, amount in (*sorted(outcomes.items()), *causes.most_common()):
        example = f", as in {examples[what]}" if what in examples else ""
        print(f"  {amount:6d}  {what}{example}")
    slow.sort(reverse=True)
    print("slowest, s per link and importer:", [(round(s, 2), name) for s, name in slow[:5]])


def _models(folders: Sequence[Path]) -> list[Path]:
    """Return the model files in these folders, or in those of the installed engines."""
    specs = (find_spec(name) for name in (("pybullet_data", "mujoco") if not folders else ()))
    folders = folders or [Path(spec.origin).parent for spec in specs if spec and spec.origin]
    suffixes = (".urdf", ".xml", ".sdf", ".world")
    files = sorted(path for folder in folders for path in folder.rglob("*") if path.suffix in suffixes)
    return [path for path in files if path.is_file() and _ROOTS.search(read_bytes(path))]


def _kind(cause: str) -> str:
    return cause.split(":")[0] if cause.startswith(("damping", "limits", "mass invented")) else cause[:75]


def valid(files: int = 500, seed: int = 1) -> None:
    """Import generated files; print false differences, and the largest of importers that read them rightly.

    Bodies are compared in imports that lose nothing, joints and mass matrices in all.
    """
    rng = np.random.default_rng(seed)
    false: Counter[str] = Counter()
    worst: dict[str, float] = {}
    compared: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder, closing(EnginePool()) as pool, np.errstate(all="ignore"):
        for k in range(files):
            mjcf = k % 2 == 1
            path = Path(folder) / f"model{k}.{'xml' if mjcf else 'urdf'}"
            path.write_text(random_mjcf(rng) if mjcf else random_urdf(rng))
            names = ("mujoco:default",) if mjcf else IMPORTERS
            engines = dict.fromkeys(name.partition(":")[0] for name in names)
            found = imported_audit(pool, read_model(path), [*engines], AuditOptions(spins=False))
            for name in found.failed:
                false[f"{name} failed"] += 1
            for link in found.links:
                for name in names:
                    if (difference := link.held[name].difference) is not None:
                        compared["links"] += 1
                        false[f"{name}: a body"] += difference.largest > SINGLE
                        _note(worst, f"{name} ({found.format.upper()})", difference.largest)
            compared["joints"] += sum(len(joint.held) for joint in found.joints)
            for _, name, cause in found.differing_joints():
                false[f"{name}: {cause.partition(':')[0]}"] += 1
            for name, matrix in found.matrices.items():
                if matrix.deviation is None or matrix.is_wrong:
                    false[f"M in {name}: {matrix.cause}"] += 1
                elif not matrix.differs:  # others follow from bodies that the default import changes
                    _note(worst, f"M in {name} ({found.format.upper()})", matrix.deviation)
    print(f"{files} files, {dict(compared)} compared; false differences: {dict(+false) or 'none'}")
    for name, deviation in sorted(worst.items()):
        print(f"  {name}: at most {deviation:.2e}")


def _note(worst: dict[str, float], name: str, deviation: float) -> None:
    worst[name] = max(worst.get(name, 0.0), deviation)


def stages(files: int = 500, seed: int = 1) -> None:
    """Read damaged USD stages, as text and binary, and print every result other than one clear line."""
    from pxr import Usd

    rng = random.Random(seed)
    endings: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        text, binary = Path(folder) / "sound.usda", Path(folder) / "sound.usdc"
        text.write_text(usd_stages.Stage(metre=0.01).text(_links(np.random.default_rng(seed))))
        Usd.Stage.Open(str(text)).Export(str(binary))
        for k in range(files):
            sound = (text, binary)[k % 2]
            path = Path(folder) / f"model{sound.suffix}"
            path.write_bytes(mutated(sound.read_bytes(), rng))
            endings[_ended(path)] += 1
    _print_counts(f"{files} damaged stages", endings)


def _ended(path: Path) -> str:
    """Return how reading a damaged file ended; a file that raises anything else than InputError is kept."""
    try:
        read_model(path)
        return "read"
    except InputError as error:
        clear = "\n" not in str(error) and str(path) in str(error)
        return "one line" if clear else f"UNCLEAR: {error}"
    except Exception as error:  # noqa: BLE001 - the trial searches for any exception
        kept = tempfile.mkstemp(prefix="fault-", suffix=path.suffix)[1]
        Path(kept).write_bytes(path.read_bytes())
        return f"FAULT {kept} {type(error).__name__}: {error}"[:200]


def _print_counts(title: str, endings: Counter[str]) -> None:
    print(title)
    for what, amount in endings.most_common():
        print(f"  {amount:6d}  {what}")


def _links(rng: np.random.Generator) -> list[usd_stages.Link]:
    """Return three links of random masses, centres and tensors, one of them fixed to another."""
    found = []
    for k in range(3):
        moments = rng.uniform(0.5, 1.5, 3)
        moments[2] = rng.uniform(abs(moments[0] - moments[1]), moments[0] + moments[1])
        A = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        size = 10.0 ** rng.uniform(-4, 0)
        tensor = A @ np.diag(moments * size) @ A.T
        centre, position = rng.normal(size=(2, 3)) * 0.1
        parent = found[-1].name if found else ""
        joint = "fixed" if k == 2 else "revolute"
        mass = float(10.0 ** rng.uniform(-1, 1))
        tensor = 0.5 * (tensor + tensor.T)
        found.append(usd_stages.Link(f"link{k}", mass, centre, tensor, position, parent, joint))
    return found


def converters(trials: int = 200, seed: int = 1) -> None:
    """Write the stage of a random URDF with one fault of converters, or with none, and compare the two."""
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    faults = {
        "principal axes lost": {"axes": "lost"},
        "rotated by the inverse of the principal axes": {"axes": "inverted"},
        "off-diagonals dropped": {"diagonal_only": True},
        "tensor times": {"moments": 1e-4},
        "centre of mass times": {"centres": 1e-2},
        "mass times": {"masses": 1e3},
        "axes of the body exchanged": {"turned": turn},
        "": {},
        " relabelled": {"axes": "relabelled"},
    }
    rng = np.random.default_rng(seed)
    endings: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        stage, urdf = Path(folder) / "robot.usda", Path(folder) / "robot.urdf"
        for k in range(trials):
            links, (cause, fault) = _links(rng), list(faults.items())[k % len(faults)]
            metre, kilogram = float(rng.choice([1.0, 0.01, 0.001])), float(rng.choice([1.0, 0.001]))
            urdf.write_text(usd_stages.urdf(links))
            written = usd_stages.Stage(metre, kilogram, str(rng.choice(["Y", "Z"])), **fault)
            stage.write_text(written.text(links))
            found = [why for _, _, why in audit_against(stage, urdf).differing()]
            if ("axes" in fault and fault["axes"] == "relabelled") or not fault:
                endings["healthy, false differences" if found else "healthy, agree"] += 1
            else:
                named = len(found) == 3 and all(why.startswith(cause) for why in found)
                endings[f"{cause}: {'named' if named else f'NOT NAMED: {found}'}"] += 1
    _print_counts(f"{trials} stages", endings)


def joints(trials: int = 200, seed: int = 1) -> None:
    """Plant one slip in a joint of each random URDF and MJCF file; compare healthy URDF with SDFormat."""
    rng = np.random.default_rng(seed)
    endings: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder, np.errstate(all="ignore"):
        stated, changed = Path(folder) / "stated.urdf", Path(folder) / "changed.urdf"
        for k in range(trials):
            name = list(JOINT_SLIPS)[k % len(JOINT_SLIPS)]
            text = ""
            while text.count("<joint") < 2:
                text = joint_text(rng, random_urdf(rng))
            stated.write_text(text)
            joint = read_model(stated).links[-1].joint
            assert joint is not None
            changed.write_text(slipped(text, name, joint.name))
            endings[_ending(changed, stated, name, joint.name, JOINT_SLIPS[name].cause)] += 1
            changed.write_text(sdf_of(text))
            if accused := audit_against(changed, stated).differing_joints():
                endings[f"healthy, ACCUSED: {accused[0][1:]}"] += 1
            name = list(MJCF_SLIPS)[k % len(MJCF_SLIPS)]
            text, other = slipped_mjcf(rng, name)
            stated.write_text(text)
            changed.write_text(other)
            endings[_ending(changed, stated, f"MJCF, {name}", "j", MJCF_SLIPS[name].cause)] += 1
    _print_counts(f"{trials} slips", endings)


def _ending(changed: Path, stated: Path, name: str, joint: str, cause: str) -> str:
    """Return whether the first difference is the planted one, all are of its joint, and M is explained."""
    found = audit_against(changed, stated)
    causes = [(one.name, text) for one, _, text in found.differing_joints()]
    if not causes or {one for one, _ in causes} != {joint} or not causes[0][1].startswith(cause):
        return f"{name}: NOT NAMED: {causes}"
    (matrix,) = found.matrices.values()
    return f"{name}: named{f', M NOT EXPLAINED: {matrix}' if matrix.is_wrong else ''}"


def slips(trials: int = 200, seed: int = 1) -> None:
    """Plant one slip in each link; print how many are found with the right numbers."""
    rng = np.random.default_rng(seed)
    counts: dict[str, Counter[str]] = {name: Counter() for name in SLIPS}
    with tempfile.TemporaryDirectory() as folder:
        for k in range(trials):
            name = list(SLIPS)[k % len(SLIPS)]
            make, shapes = SLIPS[name]
            link = random_link(rng, Path(folder), str(rng.choice(shapes)))
            written = make(link, rng)
            named = [one for one in _linted(link, written, rng, Path(folder)) if one.severity != "note"]
            right = any(is_right(one.inertia_kg_m2, link) for one in named)
            kind = "counted" if changes_enough(link, written) else "small or a density"
            counts[name][f"{kind}, {'right' if right else 'other' if named else 'silent'}"] += 1
    total = sum(counts.values(), Counter[str]())
    for name, found in counts.items():
        print(f"  {name}: {', '.join(f'{amount} {what}' for what, amount in sorted(found.items()))}")
    counted = sum(amount for what, amount in total.items() if what.startswith("counted"))
    print(f"{trials} links: {total['counted, right']} of {counted} that count have the right numbers")


def healthy(trials: int = 200, seed: int = 1) -> None:
    """Lint right links with 4 to 17 digits: of one or several densities, or with other shapes."""
    rng = np.random.default_rng(seed)
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        for k in range(trials):
            kinds = ("box", "cylinder", "sphere", "capsule", "mesh", "several", "several", "several")
            link = random_link(rng, Path(folder), str(rng.choice(kinds)), even=k % 2 == 0)
            link.digits = int(rng.choice([4, 6, 8, 17]))
            written = link.written
            if k % 3 == 2:  # a stand-in; a round one would be taken for one about another axis
                other = random_link(rng, Path(folder), str(rng.choice(("box", "mesh", "several"))))
                written = other.tensor * rng.uniform(0.1, 1.0) * np.trace(written) / np.trace(other.tensor)
            for one in _linted(link, written, rng, Path(folder)):
                found[f"{one.severity} {one.rule}"] += 1
                if one.severity != "note":
                    print(f"  accused: {one.message}\n  {link.text('part', written, visual=False)}")
    accused = sum(amount for what, amount in found.items() if not what.startswith("note"))
    print(f"{trials} healthy links: {accused} accused; {dict(found)}")


def _linted(link: Link, written: np.ndarray, rng: np.random.Generator, folder: Path) -> list[LintFinding]:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{link.text("part", written, bool(rng.integers(2)))}</robot>')
    return list(lint(read_model(path)))


def size(trials: int = 200) -> None:
    """Time the lint of chains of links with a healthy tensor, a slip, an odd tensor, and without any."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        for kind, factors in (("healthy", (1, 1, 1)), ("odd", (3.3, 2.2, 2.9)), ("empty", None)):
            path.write_text(chain(trials, factors))
            began, cpu = time.monotonic(), time.process_time()
            findings = len(list(lint(read_model(path))))
            elapsed, used = time.monotonic() - began, time.process_time() - cpu
            print(f"{trials} {kind} links: {elapsed:.2f} s, CPU {used:.2f} s, {findings} findings")


if __name__ == "__main__":
    command(*(real, valid, stages, converters, joints, slips, healthy, size))
