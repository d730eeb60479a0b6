"""`conflank dnc` over pseudo-terminals: the simulated control runs in a process of its own."""

import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from conflank_cli.cli import cli
from postprocessors.dnc.simulated_control import Setup, SimulatedControl
from tests.commands.judged import judge

MAIN = [sys.executable, "-c", "from conflank_cli.cli import main; main()"]
FAST = ("--set", "baud=115200")
PROTOCOLS = {
    "standard": "itnc530-standard",
    "blockwise": "itnc530-blockwise",
    "fe1": "itnc530-fe1",
    "fe2": "itnc530-fe2",
}
HELP = Path(__file__).parent.parent / "help"


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["dnc", *arguments])


def text_of(blocks: int, name: str = "BLADE1", seed: int = 1) -> bytes:
    rng = random.Random(seed)
    lines = [f"0 BEGIN PGM {name} MM"]
    lines += [f"{n} L X{rng.uniform(-9, 9):+.4f} Y{rng.uniform(-9, 9):+.4f} A-30.5 F800" for n in range(1, blocks - 1)]
    lines.append(f"{blocks - 1} END PGM {name} MM")
    return "".join(line + "\r\n" for line in lines).encode()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a verified program, the current one, and memory/ for the simulated control."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "memory").mkdir()
    path = tmp_path / "BLADE1.H"
    path.write_bytes(text_of(24))
    judge(path)
    return tmp_path


@contextmanager
def control(*actions: str, protocol: str = "standard", settings: tuple[str, ...] = FAST) -> Iterator[subprocess.Popen]:
    """The simulated control at ./tnc with its programs in memory/."""
    command = [*MAIN, "dnc", "simulate", *actions, "--link", "tnc", "--memory", "memory"]
    command += ["--profile", PROTOCOLS[protocol], *settings]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("/dev/")
        try:
            yield process
            process.wait(timeout=20)
        finally:
            process.kill()


def call(action: str, *arguments: str, protocol: str = "standard", settings: tuple[str, ...] = FAST) -> Result:
    return invoke(action, *arguments, "--port", "./tnc", "--profile", PROTOCOLS[protocol], *settings)


def visible(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# --- everything works -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_both_directions_are_byte_for_byte(folder: Path, protocol: str) -> None:
    with control("load=BLADE1.H", protocol=protocol) as simulated:
        result = call("send", "BLADE1.H", "--send", protocol=protocol)
        assert result.exit_code == 0, result.stderr
        assert "done: 24 blocks" in result.stderr
        assert simulated.wait(timeout=10) == 0
    assert (folder / "memory" / "BLADE1.H").read_bytes() == (folder / "BLADE1.H").read_bytes()
    with control("save=BLADE1.H", protocol=protocol):
        result = call("receive", "BLADE1", "-o", "COPY.H", protocol=protocol)
        assert result.exit_code == 0, result.stderr
    assert (folder / "COPY.H").read_bytes() == (folder / "BLADE1.H").read_bytes()


def test_one_line_and_the_log_in_both_forms(folder: Path) -> None:
    (folder / "memory" / "X.T").write_bytes(b"x\r\n")
    with control("save=X.T", protocol="blockwise"):
        assert call("receive", "X.T", "--log", "log.txt", protocol="blockwise").exit_code == 0
    assert (folder / "X.T").read_bytes() == b"x\r\n"
    log = (folder / "log.txt").read_text()
    assert "< <STX>x<ETB>" in log and "> <ACK>" in log and "# ended: complete" in log
    with control("save=X.T"):
        assert call("receive", "X.T", "--overwrite", "--log", "log.txt", "--hex").exit_code == 0
    assert re.search(r"< 00 00 .*\n(.*\n)*.*78 0d 0a", (folder / "log.txt").read_text())


def test_a_socket_is_a_port_too(folder: Path) -> None:
    """What stands at the other end of a serial device server."""
    memory: dict[str, bytes] = {}
    simulated = SimulatedControl(Setup(blockwise=True, character_s=1e-5), memory)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.settimeout(0.002)
                # Whoever opens a port throws away what is in it: the operator presses the key afterwards.
                time.sleep(0.3)
                simulated.load("BLADE1.H", time.monotonic())
                while not simulated.idle:
                    now = time.monotonic()
                    simulated.tick(now)
                    connection.sendall(simulated.output(now))
                    try:
                        for character in connection.recv(4096):
                            simulated.feed(character, now)
                    except TimeoutError:
                        continue

        thread = threading.Thread(target=serve)
        thread.start()
        port = f"socket://127.0.0.1:{server.getsockname()[1]}"
        result = invoke("send", "BLADE1.H", "--send", "--port", port, "--profile", "itnc530-blockwise", *FAST)
        thread.join(timeout=10)
    assert result.exit_code == 0, result.stderr
    assert memory["BLADE1.H"] == (folder / "BLADE1.H").read_bytes()


def test_the_program_obeys_dc3_where_the_driver_does_not(folder: Path) -> None:
    fault = ("--fault", "dc3_every=300", "--fault", "dc3_for=0.15")
    for by in ("driver", "program"):
        with control("load=BLADE1", settings=(*FAST, *fault)) as simulated:
            result = call("send", "BLADE1.H", "--send", settings=(*FAST, "--set", f"dc3_by={by}"))
            assert result.exit_code == 0, result.stderr
            assert simulated.wait(timeout=10) == 0
        assert (folder / "memory" / "BLADE1.H").read_bytes() == (folder / "BLADE1.H").read_bytes()


def test_a_receive_buffer_of_twelve_characters_at_a_real_port(folder: Path) -> None:
    (folder / "BLADE1.H").write_bytes(text_of(5))
    slow = ("--set", "baud=1200")
    with control("load=BLADE1", settings=(*slow, "--fault", "buffer=12", "--fault", "appetite=90")) as simulated:
        result = call("send", "BLADE1.H", "--send", "--unverified", settings=slow)
        assert result.exit_code == 0, result.stderr
        assert simulated.wait(timeout=10) == 0
    assert (folder / "memory" / "BLADE1.H").read_bytes() == (folder / "BLADE1.H").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["standard", "blockwise"])
def test_ten_megabytes_in_both_directions(folder: Path, protocol: str) -> None:
    text = text_of(280_000)
    assert len(text) > 10_000_000
    (folder / "BLADE1.H").write_bytes(text)
    fast = ("--set", "baud=4000000")
    with control("load=BLADE1.H" if protocol != "standard" else "load=BLADE1", protocol=protocol, settings=fast) as it:
        result = call("send", "BLADE1.H", "--send", "--unverified", protocol=protocol, settings=fast)
        assert result.exit_code == 0, result.stderr
        assert it.wait(timeout=60) == 0
    assert (folder / "memory" / "BLADE1.H").read_bytes() == text
    with control("save=BLADE1.H", protocol=protocol, settings=fast):
        result = call("receive", "BLADE1", "-o", "COPY.H", protocol=protocol, settings=fast)
        assert result.exit_code == 0, result.stderr
    assert (folder / "COPY.H").read_bytes() == text


@pytest.mark.slow
def test_the_rate_of_the_line_is_used(folder: Path) -> None:
    """As the simulated control paces it: at least 95 % at 115,200 baud."""
    (folder / "BLADE1.H").write_bytes(text_of(7000))
    with control("load=BLADE1") as simulated:
        assert call("send", "BLADE1.H", "--send", "--unverified").exit_code == 0
        shown, _ = simulated.communicate(timeout=10)
    share = re.search(r"([\d.]+) % of the line", shown)
    assert share and float(share[1]) >= 95.0


def test_a_terminal_sees_bytes_blocks_rate_and_time_left(folder: Path) -> None:
    shown = b""
    master, slave = os.openpty()
    settings = ("--set", "baud=19200")
    with control("load=BLADE1", settings=settings):
        command = [*MAIN, "dnc", "send", "BLADE1.H", "--send", "--port", "./tnc", *settings]
        with subprocess.Popen(command, stderr=slave) as process:
            os.close(slave)
            while True:
                try:
                    shown += os.read(master, 65536)
                except OSError:
                    break
    os.close(master)
    assert process.returncode == 0
    for word in ("send", "blocks", "kB", "/s", "0:00:0", "━"):
        assert word in shown.decode(), word


# --- what goes wrong ------------------------------------------------------------------------------------------------

FAILURES = {
    # name: (direction, protocol, faults of the control, settings here, words of the message)
    "error from the control": ("send", "blockwise", ["error_at=9"], [], ["MEMORY FULL", "after line 8"]),
    "error, standard": ("send", "standard", ["error_at=9"], [], ["error 13 from the control"]),
    "ended at the control": ("receive", "blockwise", ["end_at=9"], [], ["EOT", "after line 8"]),
    "cable pulled, sending": ("send", "blockwise", ["silent_at=9"], ["silence_timeout_s=0.5"], ["block 9 for 0.5 s"]),
    "cable pulled, receiving": ("receive", "standard", ["silent_at=20"], ["silence_timeout_s=0.5"], ["for 0.5 s"]),
    "port vanishes, sending": ("send", "blockwise", ["vanish_at=9"], [], ["the port is gone", "after line 8"]),
    "port vanishes, receiving": ("receive", "blockwise", ["vanish_at=9"], [], ["the port is gone", "after line 8"]),
    "no EOT": ("send", "standard", ["no_eot=true"], ["reply_timeout_s=0.5"], ["no EOT", "Look at the control"]),
    "no EOT, receiving": ("receive", "blockwise", ["no_eot=true"], ["reply_timeout_s=0.5"], ["no EOT within 0.5 s"]),
    "wrong name": ("send", "fe1", ["other_name=OTHER.H"], [], ["asks for OTHER", "BLADE1"]),
    "wrong name, receiving": ("receive", "fe1", ["other_name=OTHER.H"], [], ["outputs OTHER"]),
    "NAK for ever": ("send", "blockwise", ["nak=5:99"], [], ["block 5 refused 4 times"]),
    "nobody starts": ("send", "standard", [], ["start_timeout_s=0.01"], ["no DC1 within 0.01 s"]),
}


@pytest.mark.parametrize("name", FAILURES)
def test_a_failure_has_one_message_exit_code_5_and_leaves_nothing(folder: Path, name: str) -> None:
    direction, protocol, faults, settings, words = FAILURES[name]
    here = [*FAST, *(word for setting in settings for word in ("--set", setting))]
    there = [*FAST, *(word for fault in faults for word in ("--fault", fault))]
    if direction == "receive":
        (folder / "memory" / "BLADE1.H").write_bytes(text_of(24))
    before = visible(folder)
    action = "load=BLADE1.H" if direction == "send" and protocol != "standard" else "load=BLADE1"
    with control("save=BLADE1.H" if direction == "receive" else action, protocol=protocol, settings=there) as simulated:
        arguments = ["BLADE1.H", "--send"] if direction == "send" else ["BLADE1", "-o", "COPY.H"]
        result = call(direction, *arguments, protocol=protocol, settings=here)
        simulated.kill()
    assert result.exit_code == 5, result.stderr
    message = result.stderr[result.stderr.index("error: ") :]
    assert re.fullmatch(r"error: .+\n  found +.+\n  expected +.+\n  next +.+\n", message), message
    for word in words:
        assert word in message
    assert [file for file in visible(folder) if file != "tnc"] == before
    if direction == "send" and name != "no EOT":
        assert visible(folder / "memory") == []


@pytest.mark.parametrize(("number", "code"), [(signal.SIGKILL, -9), (signal.SIGTERM, 130), (signal.SIGINT, 130)])
def test_a_process_that_is_killed_leaves_no_file_under_its_name(folder: Path, number: int, code: int) -> None:
    slow = ("--set", "baud=4800")
    (folder / "memory" / "BLADE1.H").write_bytes(text_of(200))
    with control("save=BLADE1.H", settings=slow) as simulated:
        command = [*MAIN, "dnc", "receive", "BLADE1", "-o", "COPY.H", "--port", "./tnc", *slow, "--log", "log.txt"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            until = time.monotonic() + 20
            while not [*folder.glob(".COPY.H.*.part")] and time.monotonic() < until:
                time.sleep(0.02)
            time.sleep(0.8)
            process.send_signal(number)
            _, errors = process.communicate(timeout=10)
        simulated.kill()
    assert process.returncode == code
    assert not (folder / "COPY.H").exists()
    if number != signal.SIGKILL:
        assert not [*folder.glob(".COPY.H.*")]
        assert "stopped: receiving BLADE1, after line" in errors


def test_a_killed_sender_leaves_nothing_at_the_control(folder: Path) -> None:
    slow = ("--set", "baud=4800")
    (folder / "BLADE1.H").write_bytes(text_of(200))
    with control("load=BLADE1", settings=slow) as simulated:
        command = [*MAIN, "dnc", "send", "BLADE1.H", "--send", "--unverified", "--port", "./tnc", *slow]
        with subprocess.Popen(command, stderr=subprocess.PIPE) as process:
            assert process.stderr is not None
            for line in process.stderr:
                if b"is open" in line:
                    break
            time.sleep(0.8)
            process.kill()
        assert simulated.wait(timeout=10) == 5
    assert visible(folder / "memory") == []


def test_a_dozen_random_schedules_at_real_ports(folder: Path) -> None:
    """Seeds 0 .. 11: whoever keeps a file keeps the right one; the exit code is 0 exactly where that is so, or 5."""
    for seed in range(12):
        rng = random.Random(seed)
        text = text_of(rng.randrange(5, 60), seed=seed)
        protocol = rng.choice([*PROTOCOLS])
        faults = rng.choice(
            [
                ["nak=3:2", "silence=4:0.4"],
                ["nak=2:16"],
                ["dc3_every=90", "dc3_for=0.05"],
                ["wrong_check=2,4"],
                ["lost_answer=3"],
                ["error_at=4"],
                ["corrupt_every=701"] if protocol != "standard" else ["silence=2:0.3"],
                [],
            ]
        )
        there = (*FAST, *(word for fault in faults for word in ("--fault", fault)))
        here = (*FAST, "--set", "silence_timeout_s=1", "--set", "reply_timeout_s=1")
        for path in (folder / "memory").iterdir():
            path.unlink()
        (folder / "COPY.H").unlink(missing_ok=True)
        if rng.random() < 0.5:
            (folder / "BLADE1.H").write_bytes(text)
            judge(folder / "BLADE1.H")
            kept = folder / "memory" / "BLADE1.H"
            name = "BLADE1" if protocol == "standard" else "BLADE1.H"
            with control(f"load={name}", protocol=protocol, settings=there) as simulated:
                result = call("send", "BLADE1.H", "--send", protocol=protocol, settings=here)
                time.sleep(0.1)
                simulated.kill()
        else:
            (folder / "memory" / "BLADE1.H").write_bytes(text)
            kept = folder / "COPY.H"
            with control("save=BLADE1.H", protocol=protocol, settings=there) as simulated:
                result = call("receive", "BLADE1", "-o", "COPY.H", protocol=protocol, settings=here)
                simulated.kill()
        assert result.exit_code in (0, 5), (seed, result.stderr)
        assert kept.exists() == (result.exit_code == 0), (seed, faults, result.stderr)
        assert not kept.exists() or kept.read_bytes() == text, seed


# --- safety ---------------------------------------------------------------------------------------------------------


def test_nothing_is_sent_unless_asked_for(folder: Path) -> None:
    """The port does not exist, which only matters to somebody who opens it."""
    result = invoke("send", "BLADE1.H", "--port", "/dev/nowhere")
    assert result.exit_code == 0, result.stderr
    for word in ("would send BLADE1.H to /dev/nowhere", "24 lines", "9600 baud, 7E1", "nothing was sent: add --send"):
        assert word in result.stdout
    really = invoke("send", "BLADE1.H", "--port", "/dev/nowhere", "--send")
    assert really.exit_code == 5
    assert "/dev/nowhere" in really.stderr


def test_serve_offers_a_folder_and_nothing_else(folder: Path) -> None:
    served = folder / "served"
    served.mkdir()
    for name in ("A.H", "B.H", "C.H"):
        (served / name).write_bytes(text_of(8, name[0]))
        judge(served / name)
    judge(served / "C.H", ["CF201"])
    (folder / "SECRET.H").write_bytes(text_of(5, "SECRET"))
    (served / "LINK.H").symlink_to(folder / "SECRET.H")
    listing = invoke("serve", "served", "--profile", "itnc530-fe1")
    assert listing.exit_code == 0
    assert "LINK" not in listing.stdout and "CF201" in listing.stdout and "nothing is served" in listing.stdout
    (folder / "memory" / "NEW.H").write_bytes(text_of(8, "NEW"))
    (folder / "memory" / "A.H").write_bytes(text_of(9, "A", seed=5))
    actions = [
        "fe1-directory",
        "load=B.H",
        "load=C.H",
        "load=LINK.H",
        "load=A/B.H",
        "save=NEW.H",
        "save=A.H",
        "load-all",
    ]
    command = [*MAIN, "dnc", "serve", "served", "--send", "--port", "./tnc", "--profile", "itnc530-fe1", *FAST]
    with (
        control(*actions, protocol="fe1") as simulated,
        subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server,
    ):
        assert simulated.stdout is not None
        shown = ""
        while "load-all" not in shown:
            shown += simulated.stdout.readline()
        server.send_signal(signal.SIGINT)
        _, said = server.communicate(timeout=10)
    assert server.returncode == 0, said
    assert "directory: A.H=1 B.H=1 C.H=1" in shown
    assert "load=B.H: B.H: 8 blocks read" in shown
    assert "load=C.H: NOT VERIFIED" in shown
    assert "load=LINK.H: FILE NOT FOUND" in shown
    assert "load=A/B.H: ILLEGAL REQUEST" in shown
    assert "save=NEW.H: NEW.H: output" in shown
    assert "save=A.H: FILE EXISTS" in shown
    assert (served / "A.H").read_bytes() == text_of(8, "A")
    assert (served / "NEW.H").read_bytes() == text_of(8, "NEW")
    assert (folder / "memory" / "B.H").read_bytes() == text_of(8, "B")
    # NEW.H came from the control and has no verification: read-all leaves it out, as it does C.H.
    assert "load-all: read: A B" in shown
    assert "left out" in said
    assert visible(served) == ["A.H", "A.H.verification.json", "B.H", "B.H.verification.json", "C.H",
                               "C.H.verification.json", "LINK.H", "NEW.H"]  # fmt: skip


def test_serve_needs_a_protocol_in_which_the_control_asks(folder: Path) -> None:
    assert invoke("serve", ".").exit_code == 2
    assert invoke("serve", "none", "--profile", "itnc530-fe1").exit_code == 3


def test_receive_replaces_nothing_without_being_told(folder: Path) -> None:
    result = invoke("receive", "BLADE1", "--port", "/dev/nowhere")
    assert result.exit_code == 2 and "--overwrite" in result.stderr
    assert invoke("receive", "../BLADE1", "--port", "/dev/nowhere").exit_code == 2
    assert invoke("receive", "NEW", "--port", "/dev/nowhere").exit_code == 5
    assert visible(folder) == ["BLADE1.H", "BLADE1.H.verification.json", "memory"]


def test_drip_states_the_feed_and_refuses_jumps(folder: Path) -> None:
    result = invoke("drip", "BLADE1.H", "--profile", "itnc530-blockwise")
    assert result.exit_code == 0, result.stderr
    assert re.search(r"feed +F \d+ mm/min at most", result.stdout)
    assert re.search(r"\d+ of 21 moves are programmed faster", result.stdout)
    assert invoke("drip", "BLADE1.H").exit_code == 2
    with control("load=BLADE1.H", protocol="blockwise") as simulated:
        result = call("drip", "BLADE1.H", "--send", protocol="blockwise")
        assert result.exit_code == 0, result.stderr
        assert simulated.wait(timeout=10) == 0
    (folder / "BLADE1.H").write_bytes(text_of(8).replace(b"3 L", b"3 LBL 1 L"))
    result = invoke("drip", "BLADE1.H", "--unverified", "--profile", "itnc530-blockwise")
    assert result.exit_code == 3 and "line 4" in result.stderr


# --- figures as JSON ------------------------------------------------------------------------------------------------


def test_transfers_as_json(folder: Path) -> None:
    """One document each, of both sides; the simulated control has to say where its port is before."""
    size = (folder / "BLADE1.H").stat().st_size
    (folder / "memory" / "BLADE2.H").write_bytes(text_of(24, "BLADE2"))
    arguments = ["simulate", "load=BLADE1.H", "save=BLADE2.H", "--memory", "memory", "--json"]
    settings = ["--profile", PROTOCOLS["blockwise"], *FAST]
    with subprocess.Popen(
        [*MAIN, "dnc", *arguments, *settings], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        port = process.stderr.readline().strip()
        sent = json.loads(invoke("send", "BLADE1.H", "--send", "--port", port, *settings, "--json", "--quiet").stdout)
        back = json.loads(
            invoke("receive", "BLADE2", "-o", "COPY.H", "--port", port, *settings, "--json", "--quiet").stdout
        )
        done = json.loads(process.communicate(timeout=20)[0])
    assert sent["sent"] and sent["bytes"] == sent["size_bytes"] == back["bytes"] == size
    assert sent["blocks"] == back["blocks"] == 24
    assert (back["files"], back["from"]) == (["COPY.H"], port)
    assert done["port"] == port
    assert [(each["action"], each["succeeded"]) for each in done["actions"]] == [
        ("load=BLADE1.H", True),
        ("save=BLADE2.H", True),
    ]


# --- ports, check, help ---------------------------------------------------------------------------------------------


def test_ports_as_json() -> None:
    assert isinstance(json.loads(invoke("ports", "--json").stdout)["ports"], list)


def test_check_compares_with_the_machine_parameters() -> None:
    same = invoke("check", "--mp5020", "168", "--mp5030", "0")
    assert same.exit_code == 0 and "MP5020 = 168" in same.stdout
    other = invoke("check", "--mp5020", "169", "--mp5030", "1")
    assert other.exit_code == 1
    assert other.stdout.count("<- differs") == 2
    assert "control 8, profile 7" in other.stdout


def test_check_with_a_loop_back() -> None:
    """pyserial's loop:// stands for the plug."""
    result = invoke("check", "--loop-back", "--port", "loop://", *FAST)
    assert result.exit_code == 0, result.stdout
    assert "384 of 384 characters returned, 0 missing or wrong" in result.stdout
    assert invoke("check", "--open", "--port", "/dev/nowhere").exit_code == 5


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (["send", "none.H"], 3, "none.H"),
        (["send", "BLADE1.H", "--set", "baud"], 2, "KEY=VALUE"),
        (["send", "BLADE1.H", "--set", "speed=1"], 3, "speed"),
        (["send", "BLADE1.H", "--profile", "itnc"], 3, "itnc530-standard"),
        (["simulate", "eject"], 2, "load=NAME"),
        (["simulate", "save=NONE.H"], 2, "NONE.H"),
        (["simulate", "load=A", "--fault", "fire=1"], 2, "fire"),
        (["simulate", "load=A", "--wait", "0.1"], 5, "nobody has opened the port"),
        (["send", "BLADE1.H", "--send", "--port", "bad://x"], 5, "bad://x"),
    ],
)
def test_bad_calls(folder: Path, arguments: list[str], code: int, word: str) -> None:
    result = invoke(*arguments)
    assert result.exit_code == code, result.stderr
    assert word in result.stderr
    assert "Traceback" not in result.stderr
