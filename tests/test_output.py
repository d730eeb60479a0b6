"""Writing: whole or not at all, several files all or none, and nothing but files is replaced."""

import os
import stat
from pathlib import Path

import pytest

from conflank_cli.errors import UsageError
from conflank_cli.output import check_folder, check_output, write_output, write_outputs


def test_a_device_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    """A rename onto /dev/null would make a file of it, if one may."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reading = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_output(b"data", pipe)
    assert os.read(reading, 100) == b"data"
    os.close(reading)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]


def test_a_link_stays_one(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to("real")
    write_output("new", tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


def test_several_files_are_written_all_or_none(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(UsageError, match="No space left"):
        write_outputs([(tmp_path / "a", "new"), (tmp_path / "b", "new"), ("/dev/full", "x")])
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "old"}
    write_outputs([(tmp_path / "a", "new"), (tmp_path / "b", b"new")])
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "new", "b": "new"}


def test_what_may_not_be_written_is_refused_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever runs the tests may be allowed everything, so the answer of the system is given here."""
    closed = tmp_path / "closed"
    closed.mkdir()
    (closed / "there").write_text("")
    (tmp_path / "read_only").write_text("")
    forbidden = {closed, tmp_path / "read_only"}
    monkeypatch.setattr("conflank_cli.output.os.access", lambda path, mode: Path(path) not in forbidden)
    for name, words in (("closed/new", "a folder that may not be written"), ("read_only", "a file that may not")):
        with pytest.raises(UsageError, match=words):
            check_output(tmp_path / name)
    with pytest.raises(UsageError, match="closed may not be written"):
        check_folder("--out", closed / "deep" / "out")
    with pytest.raises(UsageError, match="a file"):
        check_folder("--out", closed / "there" / "out")
    check_folder("--out", tmp_path / "deep" / "out")
