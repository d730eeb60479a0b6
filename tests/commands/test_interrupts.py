"""Ctrl-C and SIGTERM: what was written, and what a control has received, is said and never denied."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from conflank_cli.cli import cli
from conflank_cli.commands import dnc
from conflank_cli.output import done_so_far, forget_done, write_outputs
from tests.commands.judged import judge
from tests.commands.test_dnc import FAST, MAIN, PROTOCOLS, control, text_of
from tests.postprocessors.dnc.lsv2_server import FOLDER, Server

SLOW = ("--set", "baud=4800")
DENIED = ("nothing was written", "nothing was sent")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "memory").mkdir()
    (tmp_path / "BLADE1.H").write_bytes(text_of(200))
    judge(tmp_path / "BLADE1.H")
    return tmp_path


def interrupted(
    *arguments: str, protocol: str, number: int = signal.SIGINT, after: str = "is open", wait: float = 0.8
) -> tuple[int, str]:
    """Exit code and messages of a transfer at ./tnc that gets a signal some time after it has said something."""
    words = ["--port", "./tnc", "--profile", PROTOCOLS[protocol], *SLOW]
    # What a shell runs in the background is started to ignore interrupts.
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = [MAIN[0], "-c", f"{heed}; from conflank_cli.cli import main; main()", "dnc", *arguments, *words]
    said = ""
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            said += line
            if after in line:
                break
        time.sleep(wait)
        process.send_signal(number)
        said += process.communicate(timeout=20)[1]
    return process.returncode, said


@pytest.mark.parametrize(
    ("action", "protocol", "number", "words"),
    [
        ("send", "standard", signal.SIGINT, ["what has gone out to the control: ", " lines; look at the control"]),
        (
            "send",
            "blockwise",
            signal.SIGTERM,
            ["the control has acknowledged ", " blocks of BLADE1", "look at the control"],
        ),
        ("drip", "blockwise", signal.SIGINT, ["the control has acknowledged ", "one more; look at the machine first"]),
    ],
)
def test_lines_that_have_gone_out_are_not_denied(
    folder: Path, action: str, protocol: str, number: int, words: list[str]
) -> None:
    name = "BLADE1" if protocol == "standard" else "BLADE1.H"
    with control(f"load={name}", protocol=protocol, settings=SLOW) as simulated:
        code, said = interrupted(action, "BLADE1.H", "--send", protocol=protocol, number=number)
        simulated.kill()
    assert code == 130, said
    for word in ("Interrupted: ", *words):
        assert word in said, said
    assert not any(word in said for word in DENIED)


def test_before_the_control_starts_nothing_was_sent(folder: Path) -> None:
    # A directory from the control never starts a transfer here.
    with control("load=BLADE1", settings=(*SLOW, "--fault", "silent_at=0")) as simulated:
        simulated.send_signal(signal.SIGSTOP)
        code, said = interrupted("send", "BLADE1.H", "--send", protocol="standard", wait=0.2)
        simulated.kill()
    assert code == 130
    assert said.rstrip().endswith("Interrupted: nothing was sent."), said


def test_a_program_that_was_being_received_is_not_kept(folder: Path) -> None:
    (folder / "memory" / "BLADE1.H").write_bytes(text_of(200))
    with control("save=BLADE1.H", settings=SLOW) as simulated:
        code, said = interrupted("receive", "BLADE1", "-o", "COPY.H", protocol="standard")
        simulated.kill()
    assert code == 130
    assert said.rstrip().endswith("Interrupted: nothing was received."), said
    assert not (folder / "COPY.H").exists()


def test_a_server_that_is_ended_in_a_transfer_says_what_the_control_has(folder: Path) -> None:
    with control("load=BLADE1.H", protocol="fe1", settings=SLOW) as simulated:
        code, said = interrupted("serve", ".", "--send", protocol="fe1", after="Ctrl-C ends it", wait=1.2)
        simulated.kill()
    assert code == 0
    assert "ended; the control has acknowledged" in said and "look at the control" in said, said


# --- in one process -------------------------------------------------------------------------------------------------


def call(*arguments: str) -> Result:
    """Through the door that words messages and exit codes."""
    return CliRunner().invoke(cli, ["dnc", *arguments])


def ctrl_c(*arguments: Any, **options: Any) -> Any:
    raise KeyboardInterrupt


def then_ctrl_c(function: Callable[..., Any]) -> Callable[..., Any]:
    def called(*arguments: Any, **options: Any) -> Any:
        function(*arguments, **options)
        raise KeyboardInterrupt

    return called


@pytest.mark.parametrize(
    ("method", "when", "words"),
    [
        ("connect", ctrl_c, "nothing was sent"),
        ("change_directory", ctrl_c, "nothing was sent"),
        ("send_file", ctrl_c, f"the control may have part of the program as {FOLDER}\\CONFLANK.TMP: delete it"),
        ("send_file", then_ctrl_c, f"the control may have part of the program as {FOLDER}\\CONFLANK.TMP"),
        ("move_file", ctrl_c, f"the control has the program as {FOLDER}\\CONFLANK.TMP or as {FOLDER}\\BLADE1.H"),
        ("move_file", then_ctrl_c, f"the control has the program as {FOLDER}\\CONFLANK.TMP or as {FOLDER}\\BLADE1.H"),
        ("disconnect", ctrl_c, f"the control has the whole program as {FOLDER}\\BLADE1.H"),
    ],
)
def test_over_the_network(
    folder: Path, monkeypatch: pytest.MonkeyPatch, method: str, when: Callable[..., Any], words: str
) -> None:
    import pyLSV2

    step = when(getattr(pyLSV2.LSV2, method)) if when is then_ctrl_c else when
    monkeypatch.setattr(pyLSV2.LSV2, method, step)
    server = Server()
    try:
        result = call("send", "BLADE1.H", "--send", "--lsv2", server.address, "--folder", FOLDER)
    finally:
        server.close()
    assert result.exit_code == 130
    assert f"Interrupted: {words}" in result.stderr
    assert "nothing was written" not in result.stderr


def test_after_the_transfer_it_was_sent(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the moment between the last character and the end of the command."""
    monkeypatch.setattr(dnc, "_print_json", ctrl_c)
    with control("load=BLADE1", settings=FAST):
        result = call("send", "BLADE1.H", "--send", "--port", "./tnc", "--json", *FAST)
    assert result.exit_code == 130
    assert "Interrupted: BLADE1.H was sent to ./tnc." in result.stderr


def test_a_file_that_was_complete_in_that_moment_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from postprocessors.dnc.folder import FileSink

    monkeypatch.setattr(FileSink, "commit", then_ctrl_c(FileSink.commit))
    (folder / "memory" / "BLADE2.H").write_bytes(text_of(9, "BLADE2"))
    with control("save=BLADE2.H", settings=FAST):
        result = call("receive", "BLADE2", "-o", "COPY.H", "--port", "./tnc", *FAST)
    assert result.exit_code == 130
    assert "Interrupted: COPY.H was received completely." in result.stderr
    assert (folder / "COPY.H").read_bytes() == text_of(9, "BLADE2")


# --- files ----------------------------------------------------------------------------------------------------------


def test_files_that_belong_together_all_get_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C between the first and the second rename."""
    replace = Path.replace

    def interrupt(path: Path, target: Path) -> Path:
        result = replace(path, target)
        os.kill(os.getpid(), signal.SIGINT)
        return result

    forget_done()
    monkeypatch.setattr(Path, "replace", interrupt)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        write_outputs([(tmp_path / "a", "1"), (tmp_path / "b", "2")])
    assert signal.getsignal(signal.SIGINT) is before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]
    assert done_so_far() == [f"{tmp_path / 'a'} was written", f"{tmp_path / 'b'} was written"]
    forget_done()


def test_where_interrupts_are_ignored_they_stay_so(tmp_path: Path) -> None:
    """As a shell starts what runs in the background."""
    code = (
        "import os, signal; from pathlib import Path; from conflank_cli.output import write_outputs\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "replace = Path.replace\n"
        "Path.replace = lambda path, target: (os.kill(os.getpid(), signal.SIGINT), replace(path, target))\n"
        "write_outputs([('a', '1'), ('b', '2')])\n"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, b"")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_what_was_written_before_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that is interrupted after its output has its name, and the next one in the same process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("postprocessors.dnc.folder.Folder.directory", ctrl_c)
    write_outputs([("x", "1")])
    result = call("serve", ".", "--profile", PROTOCOLS["fe1"])
    assert (result.exit_code, result.stderr.strip()) == (130, "Interrupted: nothing was written.")
