"""Print which planted faults a run with default options reports, and by which quantity.

    python tools/planted_fault_table.py [SUITE_OR_SCENARIO ...]

Runs each faulty method of tests/helpers/planted_faults.py, smoke by default, and prints one row per fault and
base: how it is reported, quantity and size. Exit status 1 if a detectable fault is not reported, or if a base
without a fault is accused.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence

from trials import command

import bodycheck
from bodycheck.adapters.registry import register_adapter
from bodycheck.reports.summary.worst_results import Result
from tests.helpers.planted_faults import BASES, FAULTS, NO_FAULT, Faulty
from tests.helpers.reported_results import reported_results


def described(results: Sequence[Result]) -> str:
    """Return the number of results of each kind, and the worst of each."""
    worst = {one.kind: one for one in reversed(results)}
    counts = Counter(one.kind for one in results)
    return "; ".join(f"{kind} ({counts[kind]}): {one.sentence}" for kind, one in reversed(worst.items()))


def main(*scenarios: str) -> int:
    """Run, print the table, and return the number of wrong reports."""
    engines = [Faulty(base) for base in BASES]
    for engine in engines:
        register_adapter(engine)
    begin = time.perf_counter()
    run = bodycheck.run(scenarios or ("smoke",), engines=[engine.name for engine in engines], speed=False)
    took = time.perf_counter() - begin
    found, missed = reported_results(run), 0
    print("| fault | planted | base | reported by |\n|---|---|---|---|")
    for engine, base in zip(engines, BASES, strict=True):
        accused = found.get(f"{engine.name}:{NO_FAULT}", ())
        missed += bool(accused)
        print(f"| {NO_FAULT} | nothing | {base} | {described(accused) or 'nothing, rightly'} |")
        for fault in FAULTS:
            reported = described(found.get(f"{engine.name}:{fault.name}", ()))
            reason = fault.undetectable.get(base)
            missed += not reported and reason is None
            silent = "NOT REPORTED" if reason is None else f"undetectable: {reason}"
            print(f"| {fault.name} | {fault.planted} | {base} | {reported or silent} |")
    print(f"{len(FAULTS)} kinds of faults x {len(BASES)} bases in {took:.0f} s; {missed} wrong")
    return missed


if __name__ == "__main__":
    command(main)
