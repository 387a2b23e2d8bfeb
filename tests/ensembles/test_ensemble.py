"""Ensembles: distribution, reproducible rows, batches, quantiles and the files of a run."""

from __future__ import annotations

import json
import math
import re
import shlex
import shutil
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import duckdb
import mujoco
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from bodycheck._util.errors import InputError
from bodycheck.adapters.batches import Batch, BatchAnswer, one_by_one, record_batch, stacked
from bodycheck.adapters.contract import Engine, Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.mujoco import MuJoCo
from bodycheck.adapters.mujoco import rollouts as mujoco_rollouts
from bodycheck.adapters.optional.mujoco_ports import record_worlds
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.workers import protocol, received_messages
from bodycheck.adapters.workers.case_messages import batch_message, batch_of
from bodycheck.cli.rooms.ensemble_commands import _new_folder
from bodycheck.ensembles.ensemble_answer import ensemble_document
from bodycheck.ensembles.ensemble_cases import ROTATION_MEASURES, measured, replay_of, truth_of
from bodycheck.ensembles.ensemble_files import distributions_svg
from bodycheck.ensembles.ensemble_merge import merge_ensembles
from bodycheck.ensembles.ensemble_result import EnsembleRequest, EnsembleResult
from bodycheck.ensembles.ensemble_run import run_ensemble
from bodycheck.ensembles.hunt_run import HuntRequest, hunt, write_hunt
from bodycheck.reference_impl.random_bodies import Bodies
from bodycheck.reports.document import Sentence, Table
from bodycheck.reports.measurement.case import run_case
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.render.styles import COLOURS, engine_colour
from bodycheck.reports.summary.quantiles import SHARES, QuantileSketch
from bodycheck.runs.directory import RUNS
from bodycheck.runs.run_progress import no_progress
from bodycheck.scenarios.ensemble import Ensemble, default_distribution, toml_text
from bodycheck.scenarios.library import load_scenario
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.quantile_agreement import agree


def ensemble(seed: int = 1) -> Ensemble:
    """Return the ensemble of a free body."""
    scenario = load_scenario("intermediate-axis")
    return Ensemble(scenario, default_distribution(scenario), seed, 5)


def batch(method: str, m: int = 12) -> Batch:
    """Return free bodies with a step."""
    return Batch(ensemble().template, ensemble().bodies(0, m), method, Setting(dt_s=0.05))


# ------------------------------------------------------------------------------------- the distribution


def test_any_row_can_be_made_alone() -> None:
    """A row has the same numbers, to the last bit, alone and in any range of rows."""
    together = ensemble().bodies(0, 50)
    for row in (0, 7, 49):
        alone = ensemble().bodies(row, row + 1)
        for name in ("moments", "quaternion", "omega_body", "torque_body"):
            assert np.array_equal(getattr(alone, name)[0], getattr(together, name)[row])


def test_row_scenario_has_the_numbers_of_the_row() -> None:
    """The scenario of a row gives engines exactly the numbers of the batch."""
    bodies, scene = ensemble().bodies(3, 4), ensemble().row_scenario(3).scene
    assert np.array_equal(np.diag(scene.body.inertia), bodies.moments[0])
    assert np.array_equal(scene.initial.quaternion, bodies.quaternion[0])
    assert np.array_equal(scene.initial.omega_body, bodies.omega_body[0])


def test_text_with_any_character_is_toml() -> None:
    """A text with quotes, control characters and letters of any script is read back unchanged."""
    data = {"summary": "".join(map(chr, range(0x100))) + "\u2028 \U0001f680"}
    assert tomllib.loads(toml_text(data)) == data


def test_distribution_is_as_documented() -> None:
    """Shares of second moments, heights of directions, attitudes and log sizes have their uniform means."""
    n = 20_000
    bodies, ranges = ensemble().bodies(0, n), ensemble().distribution
    trace = bodies.moments.sum(axis=1)
    shares = 1.0 - 2.0 * bodies.moments / trace[:, None]
    assert np.all(shares >= -1e-12)
    spin = np.linalg.norm(bodies.omega_body, axis=1)
    for values, mean, variance in (
        *((shares[:, k], 1 / 3, 1 / 18) for k in range(3)),
        *((bodies.omega_body[:, k] / spin, 0.0, 1 / 3) for k in range(3)),
        *((bodies.quaternion[:, k], 0.0, 1 / 4) for k in range(4)),
        *((bodies.quaternion[:, k] ** 2, 1 / 4, 1 / 16) for k in range(4)),
        (_share(spin, *ranges.spin_rad_s), 1 / 2, 1 / 12),
        (_share(trace, *ranges.trace_kg_m2), 1 / 2, 1 / 12),
    ):
        assert abs(np.mean(values) - mean) <= 5.0 * math.sqrt(variance / n)
    assert np.max(np.abs(np.linalg.norm(bodies.quaternion, axis=1) - 1.0)) <= 1e-15


def _share(values: np.ndarray, low: float, high: float) -> np.ndarray:
    return np.log(values / low) / math.log(high / low)


# ---------------------------------------------------------------------------------------------- batches


@pytest.mark.parametrize("method", ["rk4", "euler", "implicit@unaligned"])
def test_mujoco_rollouts_equal_single_cases(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rollout equals single simulations bit for bit, also if it is divided into several calls and parts."""
    monkeypatch.setattr(mujoco_rollouts, "MODELS", 5)
    monkeypatch.setattr(mujoco_rollouts, "STATES", 5 * 14 * 60)
    requested = batch(method)
    together, alone = record_batch(MuJoCo(), requested), one_by_one(MuJoCo(), requested)
    assert together.endings == alone.endings
    assert "ok" in alone.endings
    assert np.array_equal(together.quaternion, alone.quaternion, equal_nan=True)
    assert np.array_equal(together.omega_body, alone.omega_body, equal_nan=True)


class Worlds:
    """MuJoCo bodies stepped one after the other, with the interface of a port that stores them together."""

    def __init__(self, models: Sequence[mujoco.MjModel]) -> None:
        self.models, self.bodies = models, [mujoco.MjData(model) for model in models]

    def model(self) -> SimpleNamespace:
        """Return the fields of all models."""
        names = ("body_mass", "body_inertia", "body_iquat")
        fields = {name: np.array([getattr(model, name) for model in self.models]) for name in names}
        return SimpleNamespace(**fields, opt=self.models[0].opt)

    def put(self, **state: np.ndarray) -> None:
        """Set the state."""
        for name, values in state.items():
            for data, value in zip(self.bodies, values, strict=True):
                getattr(data, name)[:] = value

    def step(self, steps: int) -> None:
        """Make the steps."""
        for model, data in zip(self.models, self.bodies, strict=True):
            mujoco.mj_step(model, data, steps)

    def get(self) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of the state."""
        return np.array([data.qpos for data in self.bodies]), np.array([data.qvel for data in self.bodies])


def test_worlds_of_a_port_have_the_motions_of_single_cases() -> None:
    """Each body has its own model and state; bodies whose model belongs to another body are invalid."""
    requested = batch("rk4")
    together = record_worlds(requested, "rk4", "float64", Worlds)
    alone = one_by_one(MuJoCo(), requested)
    assert together.endings == alone.endings
    assert np.array_equal(together.quaternion, alone.quaternion)
    assert np.array_equal(together.omega_body, alone.omega_body)

    def wrong(models: Sequence[mujoco.MjModel]) -> Worlds:
        models[3].body_inertia[1] *= 1.001
        return Worlds(models)

    found = record_worlds(requested, "rk4", "float64", wrong)
    assert [row for row, ending in enumerate(found.endings) if ending == "invalid"] == [3]
    assert found.messages[3].startswith("inertia")
    assert np.isnan(found.quaternion[3]).all()
    assert np.array_equal(found.quaternion[4], alone.quaternion[4])


@pytest.mark.nightly
@pytest.mark.parametrize("method", ["m1", "rk4", pytest.param("dop853", marks=pytest.mark.nightly)])
def test_reference_batches_equal_single_cases(method: str) -> None:
    """The batch kernels agree with the single-body kernels to round-off."""
    requested = batch(method)
    together, alone = Reference().record_batch(requested), one_by_one(Reference(), requested)
    assert together is not None
    stable = np.abs(alone.omega_body).max(axis=(1, 2)) < 100.0
    assert stable.sum() > 6
    np.testing.assert_allclose(together.quaternion[stable], alone.quaternion[stable], atol=1e-10)


def test_replay_tells_a_batch_that_depends_on_its_other_bodies() -> None:
    """A replay reports whether bits are equal in every batch; it reports nothing for a failed body."""

    def motions(bodies: Bodies) -> BatchAnswer:
        return record_batch(Reference(), replace(batch("m1"), bodies=bodies))

    def mixing(bodies: Bodies) -> BatchAnswer:
        found = motions(bodies)
        return replace(found, omega_body=found.omega_body + 1e-12 * found.omega_body.mean(axis=0))

    def failing(bodies: Bodies) -> BatchAnswer:
        return BatchAnswer.none(replace(batch("m1"), bodies=bodies), "failed", "gone")

    bodies = batch("m1").bodies
    assert [replay_of(kind, bodies)[0] for kind in (motions, mixing, failing)] == [
        "same bits",
        "other bits",
        "",
    ]


def test_batch_survives_the_protocol() -> None:
    """Messages preserve all bits of a request and an answer; an answer with too few bodies is refused."""
    requested = batch("rk4", 3)
    again = batch_of(batch_message(requested))
    assert np.array_equal(again.bodies.omega_body, requested.bodies.omega_body)
    answer = record_batch(Reference(), requested)
    message = protocol.message_of(protocol.line_of(protocol.batch_answer_message(answer)))
    back = received_messages.batch_answer_of(message, 3, 5)
    assert np.array_equal(back.quaternion, answer.quaternion)
    with pytest.raises(protocol.ProtocolError):
        received_messages.batch_answer_of(message, 4, 5)


def test_measures_equal_those_of_a_run() -> None:
    """Each measure of a row equals that of results.csv for the row's scenario."""
    template, bodies = ensemble().template, ensemble().bodies(0, 4)
    requested = Batch(template, bodies, "rk4", Setting(dt_s=0.01))
    answer = one_by_one(Reference(), requested)
    found = measured(template, bodies, truth_of(template, bodies, free=True), answer)
    reference = Reference()
    engine = Engine(reference.name, reference.version, reference.methods)
    for row in range(4):
        problem = Problem.of(ensemble().row_scenario(row), "row")
        case = run_case(
            problem, engine, engine.methods["rk4"], requested.setting, lambda _, case: record(reference, case)
        )
        for name, values in found.measures.items():
            assert values[row] == pytest.approx(case.columns[name], rel=1e-6, abs=1e-15)


def test_diverged_and_missing_motions_are_distinguished() -> None:
    """A motion that is not finite is unstable with infinite error; a failed motion is not measured."""
    requested = batch("rk4", 3)
    answer = record_batch(Reference(), requested)
    answer.omega_body[0, 2] = np.nan
    answer.omega_body[1] *= 20.0
    answer = replace(answer, endings=("ok", "ok", "failed"))
    truth = truth_of(requested.template, requested.bodies, free=True)
    found = measured(requested.template, requested.bodies, truth, answer)
    assert list(found.endings) == ["unstable", "unstable", "failed"]
    errors = found.measures["orientation_error_rad"]
    assert np.isinf(errors[:2]).all()
    assert np.isnan(errors[2])


def test_matrix_that_diverged_is_an_unstable_motion() -> None:
    """No rotation is nearest to a matrix that is not finite."""
    requested = batch("euler", 3)
    cases = [(scene, Case(scene, "euler", requested.setting)) for scene in requested.scenes()]
    rows = [(scene, record(Reference(), case)) for scene, case in cases]
    motion = rows[1][1].trajectory
    assert motion is not None
    assert motion.rotation is not None
    motion.rotation[2:] = np.nan
    truth = truth_of(requested.template, requested.bodies, free=True)
    found = measured(requested.template, requested.bodies, truth, stacked(requested, rows, "float64"))
    assert found.endings[1] == "unstable"


def test_body_that_spins_too_fast_for_its_truth_is_refused() -> None:
    """One line gives the speed."""
    requested = batch("rk4", 3)
    requested.bodies.omega_body[1] *= 1e20
    with pytest.raises(InputError, match=r"^no truth where \|omega\| is up to .* rad/s: "):
        truth_of(requested.template, requested.bodies, free=True)


# -------------------------------------------------------------------------------------------- quantiles


def test_quantiles_are_those_of_the_sorted_numbers() -> None:
    """A quantile equals the sorted number of its rank to 2^-11, whatever the order of adding."""
    values = np.random.default_rng(1).lognormal(-20.0, 6.0, 10_001)
    whole, parts = QuantileSketch(), QuantileSketch()
    whole.add(values)
    for part in np.split(values[::-1], [10, 500, 9000]):
        parts.add(part)
    assert np.array_equal(whole.keys, parts.keys)
    assert np.array_equal(whole.counts, parts.counts)
    for share in SHARES:
        exact = np.sort(values)[math.ceil(share * len(values)) - 1]
        assert whole.quantile(share).value == pytest.approx(exact, rel=2.0**-11)


def test_error_bars_cover_as_they_state() -> None:
    """Quantiles of two samples agree within their 95 % error bars in 90 to 99 of 100 trials on average."""
    rng, agreed, covered, trials = np.random.default_rng(2), 0, 0, 600
    for _ in range(trials):
        one, other = QuantileSketch(), QuantileSketch()
        one.add(rng.lognormal(0.0, 3.0, 2000))
        other.add(rng.lognormal(0.0, 3.0, 2000))
        agreed += agree(one.quantile(0.75), other.quantile(0.75))
        found = one.quantile(0.5)
        covered += found.low <= 1.0 <= found.high
    assert 0.92 <= agreed / trials <= 0.985
    assert 0.92 <= covered / trials <= 0.985


@pytest.mark.parametrize("values", [[0.0, np.inf, 1.0, 1.0], [0.0, 0.0, 0.0]])
def test_zeros_and_infinities_are_counted(values: list[float], expected_message: ExpectedMessage) -> None:
    """An error of zero and an unstable body are ranked correctly."""
    sketch = QuantileSketch()
    sketch.add(np.array(values))
    assert sketch.quantile(1e-9).value == 0.0
    assert sketch.quantile(1.0).value == max(values)
    with expected_message.raises(ValueError):
        sketch.add(np.array([np.nan]))


# ------------------------------------------------------------------------------------------------- runs


def test_intervals_of_quantiles_stand_as_measured_and_alike_in_sentence_and_table() -> None:
    """Their ends are not symmetric about the quantile: no error that is stated is below 0."""
    key: Any = (SimpleNamespace(name="mine"), SimpleNamespace(name="rk4", control="dt"), Setting(dt_s=0.1))
    request = EnsembleRequest(scenario="tumbling", engines=["mine:rk4"], n=300)
    ensemble: Any = None
    result = EnsembleResult.empty(request, ensemble, [key])
    statistics = result.statistics[0][1]
    for sketch in statistics.sketches.values():
        sketch.add(10.0 ** np.random.default_rng(1).normal(-8.0, 3.0, 300))
    first, table, *_ = ensemble_document(result, Path()).parts
    assert isinstance(first, Sentence)
    assert isinstance(table, Table)
    cells = [str(cell) for cell in table.rows[0][1:3]]
    for share, cell in zip((0.5, 0.95), cells, strict=True):
        value, low, high = (float(part) for part in re.findall(r"[\d.]+(?:e-?\d+)?", cell))
        bar = statistics.quantile("orientation_error_rad", share)
        assert [low, value, high] == pytest.approx([bar.low, bar.value, bar.high], rel=1e-2)
    assert cells[1] in first.text


@pytest.mark.nightly
def test_run_writes_a_dataset_whose_worst_rows_can_be_repeated(tmp_path: Path) -> None:
    """DuckDB reads every table and its schema_version; results do not depend on the number of threads."""
    request = EnsembleRequest(
        scenario="intermediate-axis", engines=["reference:rk4", "reference:m1"], n=100, worst=3, jobs=2
    )
    run_ensemble(request, tmp_path / "two", no_progress)
    run_ensemble(replace(request, jobs=1), tmp_path / "one", no_progress)
    for name in ("quantiles.csv", "methods.csv"):
        assert (tmp_path / "two" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()
    with duckdb.connect() as database:

        def table(name: str) -> pd.DataFrame:
            files = f"{tmp_path}/two/{name}/**/*.parquet"
            return database.sql(f"select * from read_parquet('{files}', hive_partitioning = true)").df()

        cases, bodies = table("cases"), table("bodies")
        assert set(cases["method"]) == {"rk4", "m1"}
        assert len(cases) == 200
        assert list(bodies["row"]) == list(range(100))
        assert {*cases["schema_version"], *bodies["schema_version"]} == {1}
    worst = pd.read_csv(tmp_path / "two" / "worst.csv")
    errors = cases[cases["method"] == "rk4"]["orientation_error_rad"]
    assert worst[worst["method"] == "rk4"]["orientation_error_rad"].tolist() == sorted(errors)[::-1][:3]
    for row in worst["row"]:
        scene = load_scenario(tmp_path / "two" / "worst" / f"row-{row}.toml").scene
        assert (
            np.diag(scene.body.inertia).tolist()
            == bodies.loc[row, ["i1_kg_m2", "i2_kg_m2", "i3_kg_m2"]].tolist()
        )


SHARDS = 3


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a whole ensemble `whole` and its shards `part-1` to `part-3`."""
    folder = tmp_path_factory.mktemp("shards")
    requested = EnsembleRequest(
        scenario="intermediate-axis", engines=["reference:rk4", "reference:m1"], n=100, first_row=7, worst=5
    )
    run_ensemble(requested, folder / "whole", no_progress)
    for k in range(1, SHARDS + 1):
        run_ensemble(replace(requested, shard=f"{k}/{SHARDS}"), folder / f"part-{k}", no_progress)
    return folder


def parts_of(folder: Path, tmp_path: Path) -> list[Path]:
    """Return copies of the shards."""
    return [Path(shutil.copytree(folder / f"part-{k}", tmp_path / f"part-{k}")) for k in range(1, SHARDS + 1)]


@pytest.mark.slow
def test_merged_shards_equal_one_ensemble(shards: Path, tmp_path: Path) -> None:
    """Every table of the merged shards equals that of one ensemble, with rows in order and none lost."""
    parts = [shards / f"part-{k}" for k in (2, 3, 1)]
    merged = merge_ensembles(parts, tmp_path / "merged", allow_code=False)
    assert (merged.shards, merged.findings) == (("1/3", "2/3", "3/3"), ())
    for name in ("quantiles.csv", "methods.csv"):
        assert (tmp_path / "merged" / name).read_bytes() == (shards / "whole" / name).read_bytes()
    worst, expected = (
        pd.read_csv(folder / "worst.csv").drop(columns="reproduce")
        for folder in (tmp_path / "merged", shards / "whole")
    )
    pd.testing.assert_frame_equal(worst, expected)
    assert {path.name for path in (tmp_path / "merged/worst").iterdir()} == {
        f"row-{row}.toml" for row in worst["row"]
    }
    with duckdb.connect() as database:
        for table in ("bodies", "cases"):
            one, other = (
                database.read_parquet(f"{folder}/{table}/**/*.parquet", hive_partitioning=True).df()
                for folder in (tmp_path / "merged", shards / "whole")
            )
            keys = [name for name in ("method", "row") if name in one]
            one, other = (found.sort_values(keys, ignore_index=True) for found in (one, other))
            pd.testing.assert_frame_equal(one, other)
        sizes = [len(database.read_parquet(f"{shards}/part-{k}/bodies/**/*.parquet").df()) for k in (1, 2, 3)]
    assert sizes == [33, 33, 34]


@pytest.mark.slow
def test_merging_reports_machines_that_differ(shards: Path, tmp_path: Path) -> None:
    """The report names versions and sentinels that differ: engine, row, shards and number of digits."""
    parts = parts_of(shards, tmp_path)
    manifest = json.loads((parts[1] / "manifest.json").read_text())
    (parts[1] / "manifest.json").write_text(json.dumps({**manifest, "python": "3.99.0"}))
    path = parts[2] / "sentinels" / "0003.npz"
    arrays = dict(np.load(path))
    arrays["omega_body_rad_s"] = arrays["omega_body_rad_s"] * (1.0 + 1e-9)
    np.savez(path, **arrays)
    version, sentinel = merge_ensembles(parts, tmp_path / "merged").findings
    assert version.startswith("shards differ in python: ")
    assert version.endswith("3.99.0 in shard 2/3")
    assert sentinel.startswith("reference:rk4 on row 10 of intermediate-axis")
    assert "shard 3/3 agrees to 9.0 digits, the least in omega_body_rad_s" in sentinel
    reported = json.loads((tmp_path / "merged/manifest.json").read_text())
    assert reported["merged"] == {"shards": ["1/3", "2/3", "3/3"], "findings": [version, sentinel]}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("replays", "merged"),
    [
        (("same bits", "", "same bits"), ""),
        (("", "same bits", "same bits"), ""),
        (("other bits", "", "same bits"), "other bits"),
        (("same bits", "same bits", "other bits"), "other bits"),
    ],
)
def test_merged_replay_is_that_of_the_worst_shard(
    replays: tuple[str, ...], merged: str, shards: Path, tmp_path: Path
) -> None:
    """Other bits in one shard are other bits of the ensemble; else one unknown replay makes it unknown."""
    parts = parts_of(shards, tmp_path)
    for part, replay in zip(parts, replays, strict=True):
        manifest = json.loads((part / "manifest.json").read_text())
        manifest["methods"][0]["replay"] = replay
        (part / "manifest.json").write_text(json.dumps(manifest))
    found = [statistics.replay for _, statistics in merge_ensembles(parts, tmp_path / "merged").statistics]
    assert found == [merged, "same bits"]


def _without_a_part(parts: list[Path]) -> None:
    parts.pop()


def _twice_the_same(parts: list[Path]) -> None:
    parts[1] = parts[0]


def _of_another_seed(parts: list[Path]) -> None:
    path = parts[1] / "manifest.json"
    reported = json.loads(path.read_text())
    reported["request"]["seed"] = 2
    path.write_text(json.dumps(reported))


def _without_a_replay(parts: list[Path]) -> None:
    path = parts[1] / "manifest.json"
    reported = json.loads(path.read_text())
    del reported["methods"][0]["replay"]
    path.write_text(json.dumps(reported))


def _with_damaged_cases(parts: list[Path]) -> None:
    (path,) = (parts[1] / "cases").rglob("*method=rk4/**/*.parquet")
    path.write_bytes(path.read_bytes()[:-5])


def _with_cases_of_another_shard(parts: list[Path]) -> None:
    (path,) = (parts[1] / "cases").rglob("*method=rk4/**/*.parquet")
    shutil.copyfile(parts[2] / path.relative_to(parts[1]), path)


def _without_bodies(parts: list[Path]) -> None:
    (path,) = (parts[1] / "bodies").rglob("*.parquet")
    path.unlink()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (_without_a_part, "missing shard: 3/3"),
        (_twice_the_same, "part-1: is given twice"),
        (_of_another_seed, "part-2: seed is 2, but 1 in "),
        (_without_a_replay, "methods.0.replay: Field required"),
        (_with_damaged_cases, "part-0.parquet: cannot be read: "),
        (_with_cases_of_another_shard, "part-0.parquet: must have the rows 40 to 72"),
        (_without_bodies, "seed=1: lacks the rows 40 to 72"),
    ],
)
def test_incomplete_shards_are_refused(
    damage: Callable[[list[Path]], None], named: str, shards: Path, tmp_path: Path
) -> None:
    """The message names the folder and the error, and nothing is written."""
    parts = parts_of(shards, tmp_path)
    damage(parts)
    with pytest.raises(InputError) as refused:
        merge_ensembles(parts, tmp_path / "merged")
    assert named in str(refused.value)
    assert not (tmp_path / "merged").exists()


@pytest.mark.slow
def test_whole_ensemble_is_no_shard(shards: Path, tmp_path: Path) -> None:
    """A folder that was written without --shard is refused by name."""
    with pytest.raises(InputError) as refused:
        merge_ensembles([shards / "whole"], tmp_path / "merged")
    assert str(refused.value).startswith(f"{shards / 'whole'}: a whole ensemble")


@pytest.mark.slow
def test_merge_command_puts_ensembles_together(shards: Path, tmp_path: Path) -> None:
    """`merge` prints what the whole ensemble prints, with the folder of the merged one."""
    folders = [str(shards / f"part-{k}") for k in (1, 2, 3)]
    ended = run_bodycheck(tmp_path, "merge", *folders, "--out", "merged", "--json")
    assert ended.returncode == 0, ended.stderr
    reported = json.loads(ended.stdout)
    assert [row["bodies"] for row in reported["methods"]] == [100, 100]
    assert (reported["shards"], reported["findings"]) == (["1/3", "2/3", "3/3"], [])
    refused = run_bodycheck(tmp_path, "merge", *folders, "--history", "nights")
    assert (refused.returncode, "ensembles" in refused.stderr) == (2, True)


@pytest.mark.slow(after=3)
@pytest.mark.nightly(after=7)
@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"n": 0}, "--n"),
        ({"seed": -1}, "--seed"),
        ({"samples": 1}, "--samples"),
        ({"spin_rad_s": (2.0, 1.0)}, "--spin-rad-s"),
        ({"trace_kg_m2": (0.0, 1.0)}, "--trace-kg-m2"),
        ({"trace_kg_m2": (1e-300, 1e300)}, "--trace-kg-m2"),
        ({"dt_s": [0.3]}, "--dt"),
        ({"dt_s": [0.01, 0.01]}, "--dt"),
        ({"tolerances": [1e-6, 1e-6]}, "--tolerance"),
        ({"scenario": "body-torque", "n": 10_001}, "--n"),
        ({"shard": "4/3"}, "--shard"),
        ({"shard": "1/11"}, "--shard"),
    ],
)
def test_wrong_requests_are_refused(changed: dict[str, object], key: str, tmp_path: Path) -> None:
    """One line names the option, and nothing is written; an ensemble requires loads with a closed form."""
    request = EnsembleRequest(scenario="intermediate-axis", engines=["reference:rk4"], n=10)
    with pytest.raises(InputError) as caught:
        run_ensemble(replace(request, **changed), tmp_path / "out", no_progress)  # type: ignore[arg-type]
    assert str(caught.value).startswith(key)
    assert "\n" not in str(caught.value)
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
def test_hunt_finds_the_separatrix_for_m1() -> None:
    """From uniform starts the search finds where M1 is worst, far from the median and near the separatrix."""
    requested = EnsembleRequest(scenario="intermediate-axis", engines=["reference:m1"], n=1)
    found = hunt(HuntRequest(ensemble=requested, evaluations=1000), no_progress)
    assert len(found.path.scores) <= 1000
    assert found.value > 8.0 * found.typical
    assert found.bodies.separatrix_distance[0] < 0.01
    assert found.worst >= found.uniform


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("names", [("euler", "lie-euler"), ("lie-euler", "euler")])
def test_hunt_reports_a_breakdown_of_either_method(names: tuple[str, str], tmp_path: Path) -> None:
    """At fast spins quaternion Euler diverges: that start is the worst, whichever method is named first."""
    first, second = (f"reference:{name}" for name in names)
    requested = EnsembleRequest(
        scenario="intermediate-axis", engines=[first], n=1, dt_s=[0.1], spin_rad_s=(100.0, 1000.0)
    )
    found = hunt(HuntRequest(ensemble=requested, against=second, evaluations=240), no_progress)
    assert found.path.outcomes[found.worst] == "unstable"
    assert found.ratio is None
    assert found.typical_of == np.sum(np.isfinite(found.path.values[: found.uniform]))
    write_hunt(found, tmp_path / "found")
    assert json.loads((tmp_path / "found/manifest.json").read_text())["typical"] is None


@pytest.mark.slow
def test_hunt_without_errors_has_no_ratio(tmp_path: Path) -> None:
    """A method has no distance from itself, and the median is 0."""
    requested = EnsembleRequest(scenario="intermediate-axis", engines=["reference:rk4"], n=1, dt_s=[0.02])
    found = hunt(HuntRequest(ensemble=requested, against="reference:rk4", evaluations=240), no_progress)
    assert (found.value, found.typical, found.typical_of, found.ratio) == (0.0, 0.0, found.uniform, None)
    write_hunt(found, tmp_path / "found")
    assert "times the median" not in (tmp_path / "found/worst.toml").read_text()


@pytest.mark.slow
def test_worst_start_of_a_hunt_is_repeated_by_its_command(tmp_path: Path) -> None:
    """A run of worst.toml in MuJoCo has the error that the hunt found, and no earlier start was worse."""
    words = ("--engine", "mujoco:rk4", "--dt", "0.05", "--evaluations", "240", "--quiet", "--json")
    done = run_bodycheck(tmp_path, "hunt", "intermediate-axis", *words, "--out", "found")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["value"] > 5.0 * found["typical"]
    path = pd.read_csv(tmp_path / "found/path.csv")
    assert path["orientation_error_rad"].max() == found["value"]
    assert path.loc[path["worst_so_far"], "evaluation"].tolist() == [
        one["evaluation"] for one in found["path"]
    ]
    _, *run = shlex.split(found["reproduce"])
    again = run_bodycheck(tmp_path, *run, "--no-speed", "--quiet", "--out", "again")
    assert again.returncode == 0, again.stderr
    results = pd.read_csv(tmp_path / "again/results.csv")
    assert results["orientation_error_rad"].tolist() == pytest.approx([found["value"]], rel=1e-6)


@pytest.mark.nightly
def test_command_of_a_hunt_runs_a_function_and_the_tolerance_of_the_other_method(tmp_path: Path) -> None:
    """It allows the code of the function, and has the step of one method and the tolerance of the other."""
    (tmp_path / "still.py").write_text("def step(state, dt):\n    return state\n")
    words = ("--engine", "still:step", "--against", "reference:taylor", "--dt", "0.5", "--tolerance", "1e-6")
    words = (*words, "--allow-code", "--evaluations", "240", "--quiet", "--json", "--out", "found")
    done = run_bodycheck(tmp_path, "hunt", "intermediate-axis", *words)
    assert done.returncode == 0, done.stderr
    _, *run = shlex.split(json.loads(done.stdout)["reproduce"])
    again = run_bodycheck(tmp_path, *run, "--no-speed", "--quiet", "--out", "again")
    assert again.returncode == 0, again.stderr
    results = pd.read_csv(tmp_path / "again/results.csv")
    assert set(results["dt_s"].dropna()) == {0.5}
    assert set(results["tolerance"].dropna()) == {1e-6}


def test_default_folder_is_a_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second ensemble of the same scenario does not refuse the folder of the first."""
    monkeypatch.chdir(tmp_path)
    assert _new_folder("ensemble-top-1") == RUNS / "ensemble-top-1"
    for name in ("ensemble-top-1", "ensemble-top-1-2"):
        (RUNS / name).mkdir(parents=True)
    assert _new_folder("ensemble-top-1") == RUNS / "ensemble-top-1-3"


def test_hunt_finds_where_two_methods_differ_most(tmp_path: Path) -> None:
    """The value is the angle between the two motions and does not depend on the truth."""
    words = ("--against", "reference:m1", "--dt", "0.05", "--evaluations", "240", "--quiet", "--out", "found")
    done = run_bodycheck(tmp_path, "hunt", "intermediate-axis", "--engine", "reference:rk4", *words)
    assert done.returncode == 0, done.stderr
    scene = load_scenario(tmp_path / "found/worst.toml").scene
    motions = [
        record(Reference(), Case(scene, method, Setting(dt_s=0.05))).trajectory for method in ("rk4", "m1")
    ]
    one, other = (motion.rotation_matrices for motion in motions if motion is not None)
    angle = np.max(Rotation.from_matrix(np.swapaxes(one, 1, 2) @ other).magnitude())
    worst = pd.read_csv(tmp_path / "found/path.csv")["orientation_error_rad"].max()
    assert angle == pytest.approx(worst, rel=1e-9)
    assert f"{worst:.3g}" in done.stdout


@pytest.mark.nightly
def test_ensemble_command_runs_an_engine_in_workers(tmp_path: Path) -> None:
    """The errors of bodies in PyBullet, which has no batches, equal those of their scenarios in a run."""
    words = ("ensemble", "intermediate-axis", "--engine", "pybullet:maximal", "--dt", "0.02", "--quiet")
    done = run_bodycheck(tmp_path, *words, "--n", "30", "--worst", "2", "--out", "found", "--json")
    assert done.returncode == 0, done.stderr
    worst = json.loads(done.stdout)["worst"]
    assert len(worst) == 2
    for row in worst:
        scenario = f"found/worst/row-{row['row']}.toml"
        words = ("--engine", "pybullet:maximal", "--dt", "0.02", "--no-speed", "--quiet")
        again = run_bodycheck(tmp_path, "run", scenario, *words, "--out", f"row-{row['row']}")
        assert again.returncode == 0, again.stderr
        results = pd.read_csv(tmp_path / f"row-{row['row']}/results.csv")
        assert results["orientation_error_rad"].tolist() == pytest.approx(
            [row["orientation_error_rad"]], rel=1e-6
        )
    text = run_bodycheck(tmp_path, "ensemble", "intermediate-axis", "--row", str(worst[0]["row"]))
    assert text.stdout == (tmp_path / f"found/worst/row-{worst[0]['row']}.toml").read_text()


@pytest.mark.slow
def test_figure_has_one_colour_per_engine_and_one_dash_per_method() -> None:
    """The colours are those of the report, whatever else is drawn."""
    sketch = QuantileSketch()
    sketch.add(np.array([1e-3, 1e-2]))
    methods: list[Any] = [
        ((SimpleNamespace(name=engine), SimpleNamespace(name=name, control="dt"), Setting(1e-2, None)), one)
        for engine, name in (("my-engine", "a"), ("reference", "rk4"), ("reference", "m1"))
        for one in [SimpleNamespace(sketches=dict.fromkeys(ROTATION_MEASURES, sketch))]
    ]
    text = distributions_svg(methods).decode()
    assert (
        text.count(f"stroke: {COLOURS[engine_colour('reference')]}")
        > text.count(f"stroke: {COLOURS[engine_colour('my-engine')]}")
        > 0
    )
    assert f"stroke: {COLOURS[engine_colour('mujoco')]}" not in text
    assert "stroke-dasharray" in text
