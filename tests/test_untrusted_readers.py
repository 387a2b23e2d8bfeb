"""Contents of strangers' files: each is read, or refused in one line, at a cost that its size explains."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bodycheck._util.errors import InputError
from bodycheck._util.pinned_libraries import duckdb_connection
from bodycheck._util.untrusted import number_of
from bodycheck.recordings.formats import read_recording
from bodycheck.reports.cache.journal import Journal
from bodycheck.reports.run_files.tables import as_csv
from bodycheck.reports.run_files.trajectory_files import MAX_BYTES, read_npz
from bodycheck.runs import directory
from bodycheck.scenarios.library import load_scenario
from bodycheck.scenarios.shapes import load_mesh
from tests.helpers.child_process import run_in_child
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import tumbling

LIMIT_S = 60.0


@pytest.mark.parametrize("suffix", [".stl", ".obj"])
def test_size_is_checked_before_anything_is_read(suffix: str, tmp_path: Path) -> None:
    """A sparse file of 100 GB is refused at once."""
    path = tmp_path / f"part{suffix}"
    with path.open("wb") as file:
        file.truncate(100 << 30)
    with pytest.raises(InputError, match="too large, 107374182400 bytes"):
        load_mesh(path, 1.0)


@pytest.mark.slow(after=2)
@pytest.mark.nightly(after=4)
@pytest.mark.parametrize("depth", [300, 330, 500, 700, 900, 1000, 100_000])
@pytest.mark.parametrize("kind", ["objects", "lists"])
def test_nested_json_is_read_or_refused_in_one_line(depth: int, kind: str, tmp_path: Path) -> None:
    """The depth at which a recursion ends is no internal error."""
    begin, end = ('{"a": ', "}") if kind == "objects" else ("[", "]")
    nested = f"{begin * depth}1{end * depth}"
    (tmp_path / "motion.jsonl").write_text(f'{{"t_s": 0, "x": {nested}}}\n')
    with pytest.raises(InputError, match="nested too deeply"):
        read_recording(tmp_path / "motion.jsonl", "")
    (tmp_path / "mine.toml").write_text(f"x = {nested}".replace(": ", " = "))
    with pytest.raises(InputError):
        load_scenario(tmp_path / "mine.toml")
    for text in (nested, f'{{"schema_version": 1, "scenarios": {nested}}}'):
        (tmp_path / "manifest.json").write_text(text)
        assert run_bodycheck(tmp_path, "table", ".").returncode == 2


@pytest.mark.parametrize("key", ["\\ud800", "a\\udfff", "\\ud83d.x"])
@pytest.mark.parametrize("place", ["a name", "a nested name", "a text", "a map"])
def test_half_a_character_is_refused_in_one_line(key: str, place: str, tmp_path: Path) -> None:
    """JSON can escape one half of a surrogate pair, which no output can print."""
    (tmp_path / "mine.toml").write_text(tumbling())
    record = {
        "a name": f'{{"t_s": 0, "{key}": 1}}',
        "a nested name": f'{{"t_s": 0, "a": {{"{key}": 1}}}}',
        "a text": f'{{"t_s": "{key}"}}',
        "a map": '{"t_s": 0, "x_m": 1}',
    }[place]
    (tmp_path / "motion.jsonl").write_text(f"{record}\n" * 3)
    words = ["judge", "motion.jsonl", "--scenario", "mine.toml"]
    if place == "a map":
        words += ["--map", f"x_m={json.loads(chr(34) + key + chr(34))}"]
    done = run_bodycheck(tmp_path, *words)
    assert done.returncode == 2
    assert done.stderr.isascii()


def npz(path: Path, header: bytes) -> None:
    """Write an npz file with one array that has this header."""
    with zipfile.ZipFile(path, "w") as archive:
        length = len(header).to_bytes(2, "little")
        archive.writestr("t_s.npy", b"\x93NUMPY\x01\x00" + length + header)


@pytest.mark.parametrize(
    "header",
    [
        *(b"(" * count for count in (1, 4, 100, 1000, 60_000)),
        *(b"[" * 300 + b"]" * 300, b"{'descr': " + b"-" * 5000 + b"1}", b"\x00" * 50, b"'", b"\xff\xfe"),
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (" + b"9" * 5000 + b",)}",
        b"{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,)}",
        b"{'descr': ('<f8', ((((1,),),),)), 'fortran_order': False, 'shape': (1,)}",
        b"{'descr': '|O', 'fortran_order': False, 'shape': (1,)}",
    ],
    ids=range(14),
)
def test_header_of_an_array_is_refused_in_one_line(header: bytes, tmp_path: Path) -> None:
    """The header is a literal of Python, whose parser raises many kinds of errors."""
    npz(tmp_path / "motion.npz", header)
    with pytest.raises(InputError, match="not an npz file of numbers"):
        read_npz(tmp_path / "motion.npz")


def parquet(path: Path, columns: str, rows: int) -> None:
    """Write a Parquet file of columns given in SQL, of the row number i."""
    with duckdb_connection() as database:
        database.sql(f"SELECT {columns} FROM range({rows}) t(i)").write_parquet(str(path), compression="zstd")


BOMBS = {
    "text": "repeat('x', 1000000) AS big",
    "bytes": "repeat('x', 1000000)::BLOB AS big",
    "list": "list_resize([]::INT[], 1000000, 1) AS big",
    "list of texts": "[repeat('x', 500000), repeat('y', 500000)] AS big",
    "struct": "{'a': {'b': repeat('x', 1000000)}} AS big",
    "map": "map([1, 2], [repeat('x', 500000), repeat('y', 500000)]) AS big",
}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("kind", BOMBS)
def test_size_of_parquet_in_memory_is_checked(kind: str, tmp_path: Path) -> None:
    """Kilobytes that unpack to gigabytes are not read where no map uses them, and refused where one does."""
    path = tmp_path / "motion.parquet"
    rows = 50 if kind == "list" else 1000
    parquet(path, f"i::DOUBLE AS t_s, {BOMBS[kind]}", rows)
    assert path.stat().st_size < 10_000_000

    def read() -> str:
        try:
            found = read_recording(path, "")
            assert found.values("t_s")[-1] == rows - 1.0
            return str(found.values("big"))
        except InputError as error:
            return str(error)

    ended = run_in_child(read, LIMIT_S)
    assert ended.error is None
    assert f"exceeds the limit of {MAX_BYTES}" in ended.value or "Out of Memory" in ended.value
    assert ended.growth_megabytes < 1500.0


def test_text_of_parquet_that_is_not_unicode_is_refused_in_one_line(tmp_path: Path) -> None:
    """The library reads such text without checking it."""
    path = tmp_path / "motion.parquet"
    with duckdb_connection() as database:
        found = database.sql("SELECT i::DOUBLE AS t_s, 'abcdefgh' || i AS name FROM range(3) t(i)")
        found.write_parquet(str(path), compression="uncompressed")
    path.write_bytes(path.read_bytes().replace(b"abcdefgh", b"\xff\xfe\xfd\xfcefgh"))
    read = read_recording(path, "")
    assert list(read.values("t_s")) == [0.0, 1.0, 2.0]
    with pytest.raises(InputError, match=r"motion\.parquet"):
        read.values("name")


NAMES = (
    "nights-?",
    "nights-*",
    "nights-[12]",
    "x=1",
    "a b",
    "nights-{1,2}",
    "~",
    "%41",
    "caf\u00e9",
    "'",
    '"',
)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("name", NAMES)
def test_path_is_no_pattern(name: str, tmp_path: Path, stored_history: Path) -> None:
    """A history is that of its own folder, whatever its name and those of its neighbours are."""
    for other in ("nights-1", "nights-2", name):
        shutil.copytree(stored_history, tmp_path / other)
    words = ["SELECT count(*) AS n FROM results", "--format", "json"]
    done = run_bodycheck(tmp_path, "history", "query", name, *words)
    one = run_bodycheck(tmp_path, "history", "query", "nights-1", *words)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == json.loads(one.stdout)
    parquet(tmp_path / "motion.parquet", "i::DOUBLE AS t_s", 3)
    path = tmp_path / f"{name}.parquet"
    (tmp_path / "motion.parquet").rename(path)
    assert read_recording(path, "").names == ("t_s",)


WORDS = {
    "fullwidth digits": "\uff11\uff12",
    "Arabic digits": "\u0661\u0662",
    "Devanagari digits": "\u0967",
    "an underscore": "1_000",
    "a no-break space": "\u00a01",
    "a fullwidth sign": "\uff0d1",
    "a superscript": "1\u00b2",
    "hexadecimal": "0x10",
}
MODELS = {
    "urdf": "<robot name='r'><link name='l'><inertial><mass value='{}'/>"
    "<inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial></link></robot>",
    "mjcf": "<mujoco><worldbody><body name='l'><inertial pos='0 0 0' mass='{}' diaginertia='1 1 1'/>"
    "<joint type='free'/></body></worldbody></mujoco>",
}
MESHES = {"p.obj": "v {} 0 0\n", "p.off": "OFF\n3 1 0\n{} 0 0\n0 0 1\n1 0 0\n3 0 1 2\n"}


def scenario_of(model: str, text: str, folder: Path) -> Path:
    """Write a scenario whose body is the link of a model file."""
    (folder / f"robot.{model}").write_text(text)
    start, _, rest = tumbling().partition("[body]")
    path = folder / "mine.toml"
    path.write_text(
        f'{start}[body]\n{model} = "robot.{model}"\nlink = "l"\n{rest[rest.index("[initial]") :]}'
    )
    return path


@pytest.mark.parametrize("model", MODELS)
def test_decimal_mass_of_a_model_is_read(model: str, tmp_path: Path) -> None:
    """The models of the next test are valid but for their masses."""
    assert load_scenario(scenario_of(model, MODELS[model].format("1.5e0"), tmp_path)).body.mass_kg == 1.5


@pytest.mark.parametrize("word", WORDS.values(), ids=WORDS)
def test_number_that_no_engine_reads_is_refused(word: str, tmp_path: Path) -> None:
    """Numbers of model files, meshes and recordings are decimals in ASCII; float() reads more."""
    with pytest.raises(ValueError, match="not a number"):
        number_of(word)
    for model, text in MODELS.items():
        with pytest.raises(InputError, match="number"):
            load_scenario(scenario_of(model, text.format(word), tmp_path))
    for name, text in MESHES.items():
        (tmp_path / name).write_text(text.format(word))
        with pytest.raises(InputError, match="line"):
            load_mesh(tmp_path / name, 1.0)
    (tmp_path / "motion.jsonl").write_text(json.dumps({"t_s": word}) + "\n")
    with pytest.raises(InputError, match="t_s"):
        read_recording(tmp_path / "motion.jsonl", "").values("t_s")


@pytest.mark.parametrize("word", ["1", "-1.5", "+.5", "5.", "1e5", "1E-05", "inf", "NaN", "-Infinity"])
def test_decimal_number_is_read_as_float_reads_it(word: str) -> None:
    """What C reads in its own locale is read."""
    np.testing.assert_equal(number_of(word), float(word))


FORMULAS = ("=cmd|x!A1", "+1", "-1", "@SUM(A1)")


@pytest.mark.parametrize("name", FORMULAS)
def test_scenario_name_is_no_formula(name: str, tmp_path: Path) -> None:
    """A name that a spreadsheet would evaluate is refused."""
    (tmp_path / "mine.toml").write_text(tumbling().replace('"mine"', json.dumps(name)))
    with pytest.raises(InputError, match="formula"):
        load_scenario(tmp_path / "mine.toml")


@pytest.mark.parametrize("text", [*FORMULAS, "\t=1"])
def test_text_of_a_table_is_no_formula(text: str) -> None:
    """Text that begins like a formula has a leading space in CSV; numbers and other text are unchanged."""
    table = pd.DataFrame({"message": [text, "a=b", None], "size": [-1.5, 2.0, np.nan], text: [1, 2, 3]})
    assert as_csv(table) == f"message,size, {text}\n {text},-1.5,1\na=b,2.0,2\n,,3\n".encode()


@pytest.mark.parametrize("product", ["1e308*1e308*yaw", "1e308/1e-308*yaw", "1e300*deg*1e300*yaw"])
def test_factor_that_overflows_is_refused_without_a_warning(product: str, tmp_path: Path) -> None:
    """The line names the product; no line of Python's is printed."""
    (tmp_path / "mine.toml").write_text(tumbling())
    (tmp_path / "motion.csv").write_text("t_s,yaw\n0,0.1\n1,0.2\n2,0.3\n")
    words = ["judge", "motion.csv", "--scenario", "mine.toml", "--map", f"wx_body_rad_s={product}"]
    done = run_bodycheck(tmp_path, *words)
    assert done.returncode == 2
    assert product in done.stderr
    assert done.stderr.count("\n") == 1


def test_run_that_lacks_memory_says_how_it_is_continued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Finished cases are not lost: the line names --resume."""

    def fail(*_: object, journal: Journal, **__: object) -> None:
        journal.put("a finished case", {})
        raise MemoryError

    monkeypatch.setattr(directory, "run_selection", fail)
    (tmp_path / "mine.toml").write_text(tumbling())
    done = run_bodycheck(tmp_path, "run", "mine.toml", "--engine", "reference:rk4", "--out", "out")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == "out of memory; continue with: bodycheck run --resume out"
