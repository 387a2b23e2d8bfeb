"""Check whether a program in any language is a worker as defined in docs/workers.md, and how accurate it is.

    python tools/worker_trials.py --scenarios smoke ./my-worker

Starts the program, sends it the messages of a run, and measures its motions as a run does. Prints one line
per case with the error of orientation, then one line per rule of the protocol. The status is 1 if a rule is
violated, a case failed or was invalid, or none was successful; 2 if the program or a scenario does not exist.
Its memory and its time are not limited.
"""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
from collections.abc import Iterator

from bodycheck._util.errors import BodycheckError
from bodycheck.adapters.execution import Case
from bodycheck.adapters.stable_step import StableStepSearch
from bodycheck.adapters.workers import protocol, received_messages
from bodycheck.adapters.workers.case_messages import case_message, search_message
from bodycheck.adapters.workers.protocol import Message
from bodycheck.reports.cache.answers import Answers
from bodycheck.reports.measurement.case import CaseResult, run_case
from bodycheck.reports.measurement.problem import Problem
from bodycheck.runs.selection import Selection, checked_scenarios


class Program:
    """A worker process, to which requests are sent one at a time.

    Raises OSError if the program does not exist, ProtocolError if it announces no engine.
    """

    def __init__(self, command: list[str]) -> None:
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._asked = 0
        message = self._heard()
        if message.get("bodycheck") != protocol.VERSION:
            raise protocol.ProtocolError(
                f"the worker uses another protocol version: {message.get('bodycheck')!r}"
            )
        if "unavailable" in message:
            raise protocol.ProtocolError(f"the engine is not available: {message['unavailable']}")
        self.engine, _ = received_messages.engine_of(message)

    def ask(self, engine: str, request: Message, timeout_s: float) -> Message:
        """Return the answer; an invalid answer is returned as a failed one with the reason."""
        del engine, timeout_s
        self._asked += 1
        return self.reported(protocol.line_of({"id": self._asked, **request}), self._asked)

    def reported(self, line: bytes, number: int | None) -> Message:
        """Return the answer to a line, which must have this id."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line)
            self._process.stdin.flush()
            answer = self._heard()
        except (OSError, protocol.ProtocolError) as error:
            return {"outcome": "failed", "message": str(error)}
        if "id" not in answer or answer["id"] != number:
            return {"outcome": "failed", "message": f"it answered {answer.get('id')!r}, not {number!r}"}
        return answer

    def _heard(self) -> Message:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.endswith(b"\n"):
            raise protocol.ProtocolError("the worker ended, or closed its output")
        return protocol.message_of(line)

    def end(self) -> int:
        """Close its input, and return its exit status."""
        self._process.communicate()
        return self._process.returncode


def cases(program: Program, scenarios: list[str]) -> Iterator[tuple[CaseResult, Case]]:
    """Yield each case at the steps that the scenarios list, measured as in a run."""
    engine, answers = program.engine, Answers(None, None, 0.0)
    methods = tuple((engine, method) for method in engine.methods.values())
    selection = Selection(tuple(checked_scenarios(scenarios)), methods, {}, None, None)
    for how, scenario in selection.scenarios:
        problem = Problem.of(scenario, how)
        for _, method in methods:
            for setting in selection.settings(scenario, engine, method):
                case = Case(scenario.scene, method.name, setting)
                result = run_case(
                    problem, engine, method, setting, lambda _, c: answers.ask(program, engine, c)
                )
                yield result, case


def rules(program: Program, good: Case | None) -> Iterator[tuple[str, str]]:
    """Yield each rule with its violation, empty if there is none; good: a successful case."""
    for what, line in [("a line that is no JSON", b"hm\n"), ("a line that is no object", b"[1]\n")]:
        yield f"{what} has failed, under the id null", _refused(program.reported(line, None))
    yield "a case ends well", "" if good else "nothing was measured"
    if good is not None:
        prepared = program.ask("", {"do": "prepare", "case": case_message(good)}, 0.0)
        yield "a case is prepared", "" if prepared.get("outcome") == "ok" else str(prepared)
        for _ in range(2):
            yield "a lap of it is timed", _timed(program.ask("", {"do": "lap"}, 0.0))
    if good is not None and good.setting.dt_s is not None:
        search = StableStepSearch(good, good.setting.dt_s, 2.0 * good.setting.dt_s, math.inf)
        found = program.ask("", {"do": "stable-step", **search_message(search)}, 0.0)
        yield "a search for its largest stable step is ok or unsupported", _searched(found)
    yield "a request that is none has failed", _refused(program.ask("", {"do": "nothing"}, 0.0))
    status = program.end()
    yield "the worker ends with status 0 when its input ends", f"status {status}" if status else ""


def _refused(answer: Message) -> str:
    message = str(answer.get("message", ""))
    return "" if answer.get("outcome") == "failed" and "id" in answer else f"{message or answer}"


def _timed(answer: Message) -> str:
    try:
        return "" if received_messages.lap_of(answer) > 0.0 else "it took no time"
    except protocol.ProtocolError as error:
        return str(error)


def _searched(answer: Message) -> str:
    try:
        found = received_messages.stable_step_of(answer)
        return "" if found.outcome in ("ok", "unsupported") else f"{found.outcome}: {found.message}"
    except protocol.ProtocolError as error:
        return str(error)


def main() -> None:
    """Print the cases and the rules."""
    parser = argparse.ArgumentParser(
        description="Check whether a program is a worker, and how accurate its engine is."
    )
    parser.add_argument("--scenarios", default="smoke", help="names, suites and files, separated by commas")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="the program and its arguments")
    given = parser.parse_args()
    if not given.command:
        parser.error("name the program, as in: worker_trials.py --scenarios smoke ./my-worker")
    try:
        program = Program(given.command)
        print(f"{program.engine.name} {program.engine.version}, with {', '.join(program.engine.methods)}")
        good, wrong = None, 0
        for result, case in cases(program, given.scenarios.split(",")):
            columns = result.columns
            good = case if result.ok else good
            wrong += columns["outcome"] in ("failed", "invalid")
            fineness = "" if case.setting.fineness is None else f"{case.setting.fineness:g}"
            error = f"{columns['orientation_error_rad']:.1e} rad" if result.ok else ""
            reported = f"{columns['outcome']:11s} {error:11s}  {columns['message']}"
            print(f"{columns['scenario']:24s} {case.method:12s} {fineness:8s} {reported}".rstrip())
        for rule, fault in rules(program, good):
            wrong += bool(fault)
            print(f"NOT KEPT: {rule}: {fault}" if fault else f"kept: {rule}")
    except (BodycheckError, protocol.ProtocolError, OSError) as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
