"""Run only those scenarios and methods that some gate checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bodycheck.adapters.engine_names import is_program
from bodycheck.adapters.registry import default_engines, engine_names, optional_engines
from bodycheck.examine.dynamics.engine_dynamics import dynamics_rows
from bodycheck.reports.gates.gate import Gate
from bodycheck.reports.gates.gate_output import note_failures
from bodycheck.reports.gates.verdict import check_gates
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs.dynamics_run import DynamicsOptions, dynamics
from bodycheck.runs.manifest import Identity
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import ProgressFactory
from bodycheck.runs.runner import run_selection
from bodycheck.runs.selection import select
from bodycheck.scenarios.library import tree_names


def run_for_gates(
    gates: Sequence[Gate],
    scenarios: Sequence[str | Path],
    options: Request,
    make_progress: ProgressFactory,
    *,
    engines: Sequence[str] = (),
    allow_code: bool = False,
) -> Run:
    """Run what the gates check, at the scenarios' own steps, and nothing else; its manifest lists what fails.

    scenarios: names, suites, paths of TOML files. engines: as --engine names them [default: those of the
    gates]. Raises InputError if they are wrong.
    """
    gates = [gate for gate in gates if gate.concerns(engines)]
    others = [gate.engine for gate in gates if not any(gate.matches_engine(name) for name in engine_names())]
    programs = [name for name in dict.fromkeys(others) if is_program(name)]
    named = [name for name in optional_engines() if any(gate.engine == name for gate in gates)]
    selection = select(
        scenarios,
        engines or [*default_engines(), *named, *programs],
        allow_code=allow_code,
        predicate=lambda engine, method: any(
            gate.matches_method(engine.name, method.name)
            # as in any run, a variant of a method runs only if a gate names it
            and (not method.on_request or gate.method == method.name)
            for gate in gates
        ),
    )
    matching = tuple(
        (scenario_spec, scenario)
        for scenario_spec, scenario in selection.scenarios
        if any(gate.matches_scenario(scenario.name) for gate in gates)
    )
    selection = replace(selection, scenarios=matching)
    options = replace(
        options,
        speed=any(gate.target.is_speed for gate in gates),
        laws=any(gate.target.source == "laws" for gate in gates),
        stable_steps=any(gate.target.source == "stability" for gate in gates),
    )
    with make_progress(selection.cases_listed()) as progress:
        run = run_selection(selection, options, Identity.new(), journal=None, progress=progress)
    of_trees = [gate for gate in gates if gate.target.source == "dynamics"]
    measured = dict.fromkeys(engine.name for engine, _ in selection.methods)
    rows = [
        row
        for name in measured
        if any(gate.matches_engine(name) for gate in of_trees)
        for row in dynamics_rows(dynamics(name, tree_names(), DynamicsOptions()))
    ]
    run = run.with_rows(dynamics=rows)
    note_failures(run, check_gates(gates, run))
    return run
