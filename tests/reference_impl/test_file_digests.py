"""Digests of files by content and name, computed once for each state of the files."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from bodycheck._util import file_digests
from bodycheck._util.file_digests import content_digest, digest_of, files_at, files_below

OLD_NS = 10**18


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of two files, with its own cache next to it and a clock that is much later."""
    monkeypatch.setattr(file_digests, "cache_dir", lambda: tmp_path / "cache")
    later = time.time_ns() + 3_000_000_000
    monkeypatch.setattr(file_digests.time, "time_ns", lambda: later)
    made = tmp_path / "package"
    (made / "inner").mkdir(parents=True)
    (made / "a.py").write_text("a = 1\n")
    (made / "inner" / "b.so").write_bytes(b"\x7fELF")
    return made


@pytest.fixture
def hashed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that receives the name of each file that is read."""
    read: list[str] = []
    real = file_digests._file_digest

    def counted(path: str) -> str:
        read.append(Path(path).name)
        return real(path)

    monkeypatch.setattr(file_digests, "_file_digest", counted)
    return read


def digest(folder: Path) -> str:
    """Return the hash of a folder."""
    return content_digest("package", files_below(str(folder)))


def test_files_are_read_once(folder: Path, hashed: list[str]) -> None:
    """The second request reads nothing and returns the same digest."""
    assert digest(folder) == digest(folder)
    assert hashed == ["a.py", "b.so"]


def test_changed_files_are_cached_again(folder: Path, hashed: list[str]) -> None:
    """Changed files are read once more and then cached again."""
    digest(folder)
    (folder / "a.py").write_text("a = 22\n")
    hashed.clear()
    assert digest(folder) == digest(folder)
    assert hashed == ["a.py", "b.so"]


def test_change_with_equal_size_and_time_is_detected(folder: Path, hashed: list[str]) -> None:
    """A tool may restore a file's modification time, but not the time of its last change."""
    file = folder / "a.py"
    os.utime(file, ns=(OLD_NS, OLD_NS))
    before = digest(folder)
    file.write_text("a = 2\n")
    os.utime(file, ns=(OLD_NS, OLD_NS))
    assert digest(folder) != before
    assert hashed == ["a.py", "b.so"] * 2


def test_replaced_file_is_read_again(folder: Path) -> None:
    """A file that was replaced, moved or renamed counts as changed."""
    found = {digest(folder)}
    (folder / "new").write_text("a = 3\n")
    (folder / "new").replace(folder / "a.py")
    found.add(digest(folder))
    (folder / "a.py").rename(folder / "c.py")
    found.add(digest(folder))
    (folder / "c.py").rename(folder / "inner" / "c.py")
    found.add(digest(folder))
    (folder / "inner" / "b.so").unlink()
    found.add(digest(folder))
    assert len(found) == 5


def test_equal_content_has_an_equal_digest_anywhere(folder: Path, tmp_path: Path) -> None:
    """The digest depends only on names relative to the folder."""
    before = digest(folder)
    assert digest(folder.rename(tmp_path / "elsewhere")) == before


@pytest.mark.parametrize(
    ("age_ns", "reads"), [(0, 2), (2_000_000_000, 2), (2_000_000_001, 1), (-5_000_000_000, 2)]
)
def test_recently_changed_file_is_not_cached(
    age_ns: int, reads: int, folder: Path, hashed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file may change again within the resolution of its times; so may a file dated in the future."""
    newest = max(max(s.st_mtime_ns, s.st_ctime_ns) for _, s in files_below(str(folder)).values())
    monkeypatch.setattr(file_digests.time, "time_ns", lambda: newest + age_ns)
    assert digest(folder) == digest(folder)
    assert hashed == ["a.py", "b.so"] * reads


def test_file_changed_during_reading_is_not_cached(
    folder: Path, hashed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The content that was read may be neither the old nor the new one."""
    real = file_digests._file_digest

    def changing(path: str) -> str:
        found = real(path)
        if path.endswith("a.py"):
            Path(path).write_text(f"a = {len(hashed)}\n")
        return found

    monkeypatch.setattr(file_digests, "_file_digest", changing)
    digest(folder)
    assert not list((folder.parent / "cache").rglob("*"))


def test_unreadable_files_differ_by_the_reason(folder: Path) -> None:
    """A missing file and a folder in its place have different digests."""
    listed = (folder / "a.py").stat()
    gone, replaced = ({"a.py": (str(path), listed)} for path in (folder / "gone", folder / "inner"))
    assert content_digest("gone", gone) != content_digest("replaced", replaced)


@pytest.mark.parametrize("damage", [b"", b"no seal\n", b"\xff\xfe", b"{}\n"])
def test_damaged_cache_is_ignored(damage: bytes, folder: Path, hashed: list[str]) -> None:
    """If the cache is damaged, the files are read again and give the same digest."""
    before = digest(folder)
    (memory,) = (folder.parent / "cache/digests").iterdir()
    memory.write_bytes(damage)
    assert digest(folder) == before
    assert hashed == ["a.py", "b.so"] * 2


def test_cache_that_cannot_be_written_is_ignored(folder: Path, hashed: list[str]) -> None:
    """The digest is the same, but computed each time."""
    (folder.parent / "cache").write_text("a file")
    assert digest(folder) == digest(folder)
    assert len(hashed) == 4


def test_bytecode_and_hidden_folders_do_not_count(folder: Path) -> None:
    """Derived files and those of other tools are ignored; unreadable and deleted files are not an error."""
    before = digest(folder)
    for name in ("__pycache__", ".git", "inner/__pycache__"):
        (folder / name).mkdir()
        (folder / name / "x").touch()
    (folder / "dangling").symlink_to("nowhere")
    assert digest(folder) == before
    assert files_below(str(folder / "no such folder")) == {}
    assert [path for path, _ in files_at([str(folder / "a.py"), str(folder / "gone")])] == [
        str(folder / "a.py")
    ]


def test_linked_folder_is_not_entered(folder: Path) -> None:
    """A link may lead back to the folder itself."""
    (folder / "inner" / "loop").symlink_to(folder)
    assert list(files_below(str(folder))) == ["a.py", "inner/b.so", "inner/loop"]


def test_cache_folder_has_one_file_per_label(folder: Path) -> None:
    """The folder is created with its parents, and no temporary file is left in it."""
    for label in ("one", "one", "two"):
        content_digest(label, files_below(str(folder)))
    assert len(list((folder.parent / "cache/digests").iterdir())) == 2
    assert len(list(folder.parent.rglob("*"))) == 8


def test_digest_of_sources_has_their_places(tmp_path: Path) -> None:
    """A module that is moved or changed changes the digest; other files do not."""
    (tmp_path / "inner").mkdir()
    (tmp_path / "a.py").write_text("a = 1\n")
    found = [digest_of(tmp_path)]
    (tmp_path / "notes.txt").touch()
    assert [digest_of(tmp_path)] == found
    assert len(found[0]) == 64
    (tmp_path / "a.py").rename(tmp_path / "inner/a.py")
    found.append(digest_of(tmp_path))
    (tmp_path / "inner/a.py").write_text("a = 2\n")
    found.append(digest_of(tmp_path))
    assert len({*found}) == 3


def test_no_files_have_a_digest_too(folder: Path) -> None:
    """An engine may have loaded no files; their digest differs from that of any file."""
    nothing = content_digest("nothing", {})
    assert len(nothing) == 64
    assert nothing != digest(folder)
