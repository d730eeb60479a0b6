"""`conflank dnc`: programs to and from the control over a serial line."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from conflank_cli import completion, options
from conflank_cli.commands.dnc_simulate import simulate
from conflank_cli.commands.wiring import Wiring, wiring
from conflank_cli.options import Talk
from conflank_cli.output import note_done, uninterrupted

if TYPE_CHECKING:
    from conflank_cli.verification.result import Verification
    from postprocessors.dnc.engine import Counts, Engine
    from postprocessors.dnc.profile import Profile
    from postprocessors.dnc.program import Program


@click.group(cls=options.NearestGroup, epilog="\b\nExample:\n  conflank dnc send BLADE1.H")
def dnc() -> None:
    """Transfer programs over RS-232.

    The operator starts each transfer at the control. Nothing goes out without --send, and only programs that have
    been verified. docs/dnc.md tells how to set up the control, the cable and a profile.
    """


# --- send -----------------------------------------------------------------------------------------------------------


@dnc.command(epilog="\b\nExample:\n  conflank dnc send BLADE1.H --profile itnc530-blockwise --port /dev/ttyUSB0")
@click.argument("program", metavar="PROGRAM", shell_complete=completion.files(*completion.PROGRAM))
@click.option("--send", "really", is_flag=True, help="Do it; otherwise only say what would be sent.")
@click.option("--unverified", is_flag=True, help="Also without a verification that is free of findings.")
@click.option("--lsv2", "address", metavar="HOST[:PORT]", help="Over TCP instead of the serial port (extra lsv2).")
@click.option(
    "--folder", metavar="DIR", default="TNC:\\", show_default=True, help="Folder of the control, with --lsv2."
)
@click.option("--overwrite", is_flag=True, help="Replace a file of that name at the control, with --lsv2.")
@wiring
@options.as_json
@options.common
def send(
    program: str,
    really: bool,
    unverified: bool,
    address: str | None,
    folder: str,
    overwrite: bool,
    wiring: Wiring,
    as_json: bool,
    talk: Talk,
) -> None:
    """Send a program to the control.

    PROGRAM needs PROGRAM.verification.json beside it, of this very text and without findings. Start the transfer at
    the control as well: in the standard protocol it asks for a name, which must be the one in the program's first line.
    """
    checked, verification = _releasable(program, wiring.profile, unverified, really, talk)
    if address is not None:
        if not really:
            _dry("would send", checked, verification, f"{address}, {folder}", [], {}, as_json)
            return
        size = _send_over_network(checked, address, folder, overwrite, talk)
        if as_json:
            done = {"sent": True, "bytes": size}
            _print_json(_about(checked, verification, f"{address}, {folder}") | done)
        return
    if not really:
        facts = _line_facts(wiring.profile, checked)
        words = _line_words(wiring.profile, checked)
        _dry("would send", checked, verification, wiring.port, words, facts, as_json)
        return
    done = _transfer(_sender(checked, wiring.profile), wiring, talk, "send", checked.sent_bytes)
    note_done(f"{checked.path.name} was sent to {wiring.port}")
    if not wiring.profile.blockwise:
        talk.note("The control answered EOT, which it also does on an error: see its screen.")
    if as_json:
        _print_json(_about(checked, verification, wiring.port) | {"sent": True} | done)


def _send_over_network(checked: Program, address: str, folder: str, overwrite: bool, talk: Talk) -> int:
    """Send through LSV-2; how many bytes those were."""
    from postprocessors.dnc.lsv2 import send_data

    with _terminated():
        send_data(checked.path.name, checked.data, address, folder, overwrite)
        note_done(f"{checked.path.name} was sent to {address}")
    talk.note(f"sent {checked.path.name}: {checked.size:,} bytes to {address}")
    return checked.size


def _sender(program: Program, profile: Profile) -> Engine:
    from postprocessors.dnc.blockwise import BlockwiseServer
    from postprocessors.dnc.folder import OneProgram
    from postprocessors.dnc.standard import StandardSender

    title = f"sending {program.path.name}"
    if profile.blockwise:
        return BlockwiseServer(profile, title, OneProgram(program), once=True)
    return StandardSender(profile, title, program.text())


def _releasable(
    name: str, profile: Profile, unverified: bool, really: bool, talk: Talk
) -> tuple[Program, Verification | None]:
    """The program and its verification, if nothing speaks against sending it; None for the latter if it is not needed.

    `really`: whether it is going to be sent, for the wording of the notes.
    """
    from conflank_cli.commands.release import Refused, release
    from conflank_cli.commands.tables import judged_against, unknown_moves
    from conflank_cli.errors import InputError
    from postprocessors.dnc.program import read_program

    path = Path(name)
    program = read_program(path, profile)
    verification = None
    try:
        verification = release(path, program.sha256)
    except (Refused, InputError) as refused:
        if not unverified:
            raise
        reason = refused.found if isinstance(refused, Refused) else f"{refused.where}: {refused.found}"
        talk.note(f"note: {reason}; {'sent' if really else 'would be sent'} all the same (--unverified)")
    if verification is not None and really:
        talk.note("judged against")
        facts = [*judged_against(verification), ("unknown", unknown_moves(verification)), ("findings", "none")]
        for key, text in facts:
            talk.note(f"  {key:<9} {text}")
    if not program.plain:
        talk.note("note: not every line ends in CR LF; the control gets them so")
    if program.named and not program.ended:
        talk.note("note: the last line does not end the program; the control may wait for more")
    return program, verification


def _line_words(profile: Profile, program: Program | None = None) -> list[tuple[str, str]]:
    bits = f"{profile.baud} baud, {profile.data_bits}{profile.parity[0].upper()}{profile.stop_bits:g}"
    words = [("settings", f"{bits}, handshake {profile.handshake}, {profile.protocol} ({profile.name})")]
    if program is not None:
        words.append(("time", f"at least {_least_seconds(profile, program):.0f} s"))
    return words


def _line_facts(profile: Profile, program: Program | None = None) -> dict[str, Any]:
    """The same for --json."""
    facts: dict[str, Any] = {
        "profile": profile.name,
        "baud": profile.baud,
        "data_bits": profile.data_bits,
        "parity": profile.parity,
        "stop_bits": profile.stop_bits,
        "handshake": profile.handshake,
        "protocol": profile.protocol,
    }
    if program is not None:
        facts["least_time_s"] = _least_seconds(profile, program)
    return facts


def _least_seconds(profile: Profile, program: Program) -> float:
    """What the characters of a program take on the line."""
    return (program.sent_bytes + (3 * program.lines if profile.blockwise else 0)) * profile.character_s


def _about(program: Program, verification: Verification | None, to: str | None) -> dict[str, Any]:
    """Which program goes where, and what it was judged against, for --json."""
    judged = None
    if verification is not None:
        judged = {
            "against": verification.against,
            "coverage": verification.coverage,
            "overcut_max_um": verification.overcut_max_um,
            "stock_max_um": verification.stock_max_um,
            "unknown_moves": verification.unknown_moves,
            "findings": verification.findings,
        }
    return {
        "program": str(program.path),
        "name": program.name,
        "lines": program.lines,
        "size_bytes": program.size,
        "sha256": program.sha256,
        "verification": judged,
        "to": to or None,
    }


def _print_json(content: dict[str, Any]) -> None:
    from conflank_cli.commands.documents import print_document

    print_document(content)


def _dry(
    what: str,
    program: Program,
    verification: Verification | None,
    to: str | None,
    words: list[tuple[str, str]],
    facts: dict[str, Any],
    as_json: bool,
) -> None:
    """What a run without --send says, on standard output."""
    from conflank_cli.commands.tables import judged_against, unknown_moves

    if as_json:
        _print_json(_about(program, verification, to) | facts | {"sent": False})
        return
    lines = [("program", f"{program.name}, {program.lines:,} lines, {program.size:,} bytes")]
    lines.append(("sha256", program.sha256))
    lines += [("first", next(program.text()).decode("latin-1")), *words]
    click.echo(f"{what} {program.path} to {to or 'no port'}")
    if verification is not None:
        lines += judged_against(verification)
        lines.append(("coverage", f"{100.0 * verification.coverage:.2f} %"))
        lines += [("unknown", unknown_moves(verification)), ("findings", "none")]
    else:
        lines.append(("findings", "not verified"))
    for name, value in lines:
        click.echo(f"  {name:<9} {value}")
    click.echo("nothing was sent: add --send")


# --- receive --------------------------------------------------------------------------------------------------------


@dnc.command(epilog="\b\nExample:\n  conflank dnc receive BLADE1 --port ./tnc -o COPY.H")
@click.argument("name", metavar="NAME")
@click.option(
    "-o", "--output", metavar="FILE", help="Where to write it; default: NAME, with .H if it has no extension."
)
@click.option("--overwrite", is_flag=True, help="Replace FILE if it exists.")
@click.option("--lsv2", "address", metavar="HOST[:PORT]", help="Over TCP instead of the serial port (extra lsv2).")
@click.option(
    "--folder", metavar="DIR", default="TNC:\\", show_default=True, help="Folder of the control, with --lsv2."
)
@wiring
@options.as_json
@options.common
def receive(
    name: str,
    output: str | None,
    overwrite: bool,
    address: str | None,
    folder: str,
    wiring: Wiring,
    as_json: bool,
    talk: Talk,
) -> None:
    """Receive a program from the control.

    Start its output at the control. A program of another name is not taken. FILE appears when it is complete.
    """
    import re

    from conflank_cli.errors import UsageError
    from conflank_cli.output import check_output
    from postprocessors.dnc.blockwise import NAME_PATTERN, BlockwiseServer
    from postprocessors.dnc.folder import FileSink, OneFile, is_judgement
    from postprocessors.dnc.standard import StandardReceiver
    from postprocessors.errors import Interrupted

    if re.fullmatch(NAME_PATTERN, name) is None:
        raise UsageError(f"NAME {name}", "no legal name", "letters, digits, . _ -", "Name it as the control does.")
    path = Path(output if output is not None else name if "." in name else f"{name}.H")
    check_output(path)
    if path.exists() and not overwrite:
        raise UsageError(f"-o {path}", "a file that exists", "a new name", "Replace it with --overwrite.")
    if is_judgement(path.name):
        raise UsageError(f"-o {path}", "the name of a verification", "another", "Only conflank verify writes those.")
    if address is not None:
        from postprocessors.dnc.lsv2 import receive_file

        with _terminated():
            size = receive_file(name, path, address, folder, _give_name)
        talk.note(f"received {name}: {size:,} bytes from {address}")
        if as_json:
            _print_json({"files": [str(path)], "name": name, "from": f"{address}, {folder}", "bytes": size})
        return
    title = f"receiving {name}"
    engine: Engine
    if wiring.profile.blockwise:
        engine = BlockwiseServer(wiring.profile, title, OneFile(name, path, overwrite), once=True)
    else:
        engine = StandardReceiver(wiring.profile, title, FileSink(path, overwrite, expected=name))
    before = _stamp(path)
    try:
        done = _transfer(engine, wiring, talk, "receive", None)
    except Interrupted:
        # It may have been complete in the moment before.
        if _stamp(path) == before:
            raise
        raise Interrupted(f"{path} was received completely") from None
    note_done(f"{path} was written")
    if as_json:
        _print_json({"files": [str(path)], "name": name, "from": wiring.port} | done)


def _stamp(path: Path) -> tuple[int, int] | None:
    """What tells a file from one that has taken its name."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


def _give_name(part: Path, final: Path) -> None:
    part.chmod(0o644)
    with uninterrupted():
        part.replace(final)
        note_done(f"{final} was written")


# --- serve ----------------------------------------------------------------------------------------------------------


@dnc.command(epilog="\b\nExample:\n  conflank dnc serve . --profile itnc530-fe1")
@click.argument("folder", metavar="FOLDER", type=click.Path())
@click.option("--send", "really", is_flag=True, help="Do it; otherwise only list what would be offered.")
@click.option("--unverified", is_flag=True, help="Also programs without a verification that is free of findings.")
@click.option("--read-only", is_flag=True, help="Take nothing from the control.")
@click.option("--overwrite", is_flag=True, help="Let the control replace files.")
@wiring
@options.as_json
@options.common
def serve(
    folder: str,
    really: bool,
    unverified: bool,
    read_only: bool,
    overwrite: bool,
    wiring: Wiring,
    as_json: bool,
    talk: Talk,
) -> None:
    """Be a file server for a control in FE1, FE2 or blockwise mode.

    The control reads the directory of FOLDER, and reads and writes its files; nothing outside FOLDER exists for it.
    Ctrl-C ends it.
    """
    from conflank_cli.commands.release import objection
    from conflank_cli.errors import InputError, UsageError
    from postprocessors.dnc.blockwise import BlockwiseServer
    from postprocessors.dnc.folder import Folder, Gate
    from postprocessors.errors import Interrupted

    path = Path(folder)
    if not path.is_dir():
        raise InputError(folder, "no folder", "a folder with programs", "Check its path.")
    if not wiring.profile.blockwise:
        found, expected = f"protocol {wiring.profile.protocol}", "fe1, fe2 or blockwise"
        raise UsageError("--profile", found, expected, "In the standard protocol the control cannot ask for files.")
    gate: Gate = (lambda path, digest: None) if unverified else objection
    store = Folder(path, wiring.profile, gate, writable=not read_only, overwrite=overwrite)
    if not really and as_json:
        offered = [
            {"name": entry.name, "bytes": entry.size, "refused": store.refusal(entry.name)}
            for entry in store.directory()
        ]
        facts = {"folder": folder, "to": wiring.port or None} | _line_facts(wiring.profile)
        _print_json(facts | {"programs": offered, "served": False})
        return
    if not really:
        click.echo(f"would serve {folder} at {wiring.port or 'no port'}")
        for name, value in _line_words(wiring.profile):
            click.echo(f"  {name:<9} {value}")
        for entry in store.directory():
            reason = store.refusal(entry.name)
            click.echo(
                f"  {entry.name:<24} {entry.size:>12,}  {'not sent: ' + reason if reason else 'sent if asked for'}"
            )
        click.echo("nothing is served: add --send")
        return
    engine = BlockwiseServer(wiring.profile, f"serving {folder}", store, once=False, report=talk.note)
    talk.note(f"serving {folder} at {wiring.port}; Ctrl-C ends it")
    try:
        _transfer(engine, wiring, talk, "serve", None)
    except Interrupted as interrupt:
        talk.note(f"ended; {interrupt.text}")
        if as_json:
            counts = {"blocks": engine.counts.blocks, "bytes": engine.counts.bytes, "repeats": engine.counts.repeats}
            _print_json({"folder": folder, "to": wiring.port, "served": True} | counts)


# --- drip -----------------------------------------------------------------------------------------------------------


@dnc.command(epilog="\b\nExample:\n  conflank dnc drip BLADE1.H --profile itnc530-blockwise --set baud=115200")
@click.argument("program", metavar="PROGRAM", shell_complete=completion.files(*completion.PROGRAM))
@click.option("--send", "really", is_flag=True, help="Do it; otherwise only say what would be sent.")
@click.option("--unverified", is_flag=True, help="Also without a verification that is free of findings.")
@click.option(
    "--turnaround-ms",
    type=click.FloatRange(0.0, 1e5),
    default=5.0,
    show_default=True,
    help="What both sides need between two blocks; measure it at the control.",
)
@wiring
@options.as_json
@options.common
def drip(
    program: str,
    really: bool,
    unverified: bool,
    turnaround_ms: float,
    wiring: Wiring,
    as_json: bool,
    talk: Talk,
) -> None:
    """Feed a program to the control block by block while it runs.

    For programs larger than the control's memory. The line rate limits the feed: above the limit that is stated the
    machine stands and waits, which marks the part. Programs with jumps, labels or calls are refused.
    """
    from msgspec.structs import replace

    from conflank_cli.errors import UsageError
    from postprocessors.dnc.program import check_drip, feed_limit

    profile = wiring.profile
    if not profile.blockwise:
        found, expected = f"protocol {profile.protocol}", "blockwise, fe1 or fe2, where ACK paces each block"
        raise UsageError("--profile", found, expected, "Choose such a profile, and set the control to it.")
    checked, verification = _releasable(program, profile, unverified, really, talk)
    check_drip(checked)
    limit = feed_limit(checked, profile, turnaround_ms / 1000.0)
    over = f"{limit.over:,} of {limit.moves:,} moves are programmed faster than their own block allows"
    words = [
        ("feed", f"F {limit.sustained:.0f} mm/min at most, on the average of the program"),
        ("", f"F {limit.least:.0f} mm/min at line {limit.least_line}, whose way is shortest for its characters"),
        ("", over),
    ]
    facts = {
        "feed_sustained_mm_min": limit.sustained,
        "feed_least_mm_min": limit.least,
        "feed_least_line": limit.least_line,
        "moves": limit.moves,
        "moves_too_fast": limit.over,
    }
    if not really:
        facts = _line_facts(profile, checked) | facts
        words = _line_words(profile, checked) + words
        _dry("would feed", checked, verification, wiring.port, words, facts, as_json)
        return
    for _, text in words:
        talk.note(text)
    # A block is acknowledged when the machine has room for the next: that takes as long as the cut does.
    patient = Wiring(replace(profile, silence_timeout_s=0.0), wiring.port, wiring.log, wiring.as_hex)
    done = _transfer(_sender(checked, patient.profile), patient, talk, "drip", checked.sent_bytes)
    note_done(f"{checked.path.name} was fed to {wiring.port}")
    if as_json:
        _print_json(_about(checked, verification, wiring.port) | facts | {"sent": True} | done)


# --- ports and check ------------------------------------------------------------------------------------------------


@dnc.command(epilog="\b\nExample:\n  conflank dnc ports")
@options.as_json
@options.common
def ports(as_json: bool, talk: Talk) -> None:
    """List the serial ports of this computer."""
    from serial.tools.list_ports import comports

    found = sorted(comports())
    if as_json:
        keys = ("device", "description", "hwid", "manufacturer", "product", "serial_number")
        _print_json({"ports": [{key: getattr(port, key) for key in keys} for port in found]})
        return
    for port in found:
        click.echo(f"{port.device:<16} {port.description}")
    if not found:
        talk.note("no serial ports; a USB adapter shows up when it is plugged in")


@dnc.command(epilog="\b\nExample:\n  conflank dnc check --profile itnc530-standard --mp5020 168 --mp5030 0")
@click.option("--mp5020", type=click.IntRange(0, 255), help="Machine parameter 5020.x, as the control shows it.")
@click.option("--mp5030", type=click.IntRange(0, 1), help="Machine parameter 5030.x.")
@click.option("--open", "try_port", is_flag=True, help="Open the port and read its settings and lines back.")
@click.option("--loop-back", is_flag=True, help="Send every character and expect it back: needs a loop-back plug.")
@wiring
@options.as_json
@options.common
def check(
    mp5020: int | None,
    mp5030: int | None,
    try_port: bool,
    loop_back: bool,
    wiring: Wiring,
    as_json: bool,
    talk: Talk,
) -> int:
    """Compare a profile with the control's machine parameters and with the port.

    Exit code 1 means that they differ.
    """
    from conflank_cli.errors import EXIT_DONE, EXIT_FINDINGS
    from postprocessors.dnc.loop import port_state, try_loop
    from postprocessors.dnc.profile import explain_mp5020

    del talk
    profile = wiring.profile
    # What was compared, how it stands, and whether that is right.
    facts: list[tuple[str, str, bool]] = []
    if mp5020 is not None:
        own = explain_mp5020(profile.mp5020)
        facts += [
            (key, f"control {value}, profile {own[key]}", value == own[key])
            for key, value in explain_mp5020(mp5020).items()
        ]
    if mp5030 is not None:
        facts.append(("protocol", f"MP5030 {mp5030}, profile {profile.mp5030}", mp5030 == profile.mp5030))
    if try_port or loop_back:
        facts += port_state(profile, wiring.port)
    if loop_back:
        facts += try_loop(profile, wiring.port)
    if as_json:
        compared = [{"what": name, "found": text, "good": good} for name, text, good in facts]
        line = _line_facts(profile) | {"mp5020": profile.mp5020, "mp5030": profile.mp5030}
        _print_json(line | {"port": wiring.port or None, "compared": compared})
    else:
        click.echo(f"{profile.name}: MP5020 = {profile.mp5020}, MP5030 = {profile.mp5030}")
        for name, value in _line_words(profile):
            click.echo(f"  {name:<14} {value}")
        for name, text, good in facts:
            click.echo(f"  {name:<14} {text}{'' if good else '  <- differs'}")
    return EXIT_DONE if all(good for *_, good in facts) else EXIT_FINDINGS


# --- how a transfer runs --------------------------------------------------------------------------------------------


LOOK = {
    "send": "look at the control and delete incomplete files there",
    "drip": "look at the machine first: it may have stopped in the cut, or still be running",
    "serve": "look at the control and delete incomplete files there",
}
"""What to do where a control has received something of a text that has not ended."""
NOTHING = {
    "send": "nothing was sent",
    "drip": "nothing was sent",
    "receive": "nothing was received",
    "serve": "no transfer was under way",
}


def _transfer(engine: Engine, wiring: Wiring, talk: Talk, what: str, total: int | None) -> dict[str, Any]:
    """Run an engine at the port, with a bar, a log and a summary; returns how much went over the wire.

    Raises
    ------
    Interrupted: Ctrl-C or SIGTERM; says what the control has received.
    """
    from postprocessors.errors import Interrupted

    try:
        return _watched(engine, wiring, talk, what, total)
    except KeyboardInterrupt:
        # Where the engine was not told, it was not running: before the first character, or after the last.
        left = engine.left_behind() if engine.left is None else engine.left
        raise Interrupted(f"{left}; {LOOK[what]}" if left else NOTHING[what]) from None


def _watched(engine: Engine, wiring: Wiring, talk: Talk, what: str, total: int | None) -> dict[str, Any]:
    """The same, as long as nobody interrupts it."""
    from postprocessors.dnc.port import open_port
    from postprocessors.dnc.session import Session, TransferLog

    profile = wiring.profile
    with _terminated():
        try:
            port = open_port(profile, wiring.port)
        except BaseException:
            # An engine that receives has its hidden file open already.
            engine.abort("no port", 0.0)
            raise
        try:
            with _log_file(wiring.log) as stream, _bar(talk, what, total) as watch:
                if what != "serve":
                    talk.note(f"{wiring.port} is open: start the transfer at the control")
                log = TransferLog(stream, wiring.as_hex) if stream is not None else None
                started: list[float] = []

                def on_counts(counts: Counts) -> None:
                    if engine.started and not started:
                        started.append(time.monotonic())
                    watch(counts)

                try:
                    Session(engine, port, log, on_counts).run()
                except KeyboardInterrupt:
                    if what != "serve" and engine.failure is not None:
                        talk.note(f"stopped: {engine.failure.where}")
                    raise
        finally:
            port.close()
        seconds = time.monotonic() - started[0] if started else 0.0
        counts = engine.counts
        rate = f", {counts.bytes / seconds:,.0f} bytes/s" if seconds > 0.1 else ""
        repeats = f", {counts.repeats} repeated" if counts.repeats else ""
        talk.note(f"done: {counts.blocks:,} blocks, {counts.bytes:,} bytes in {seconds:.1f} s{rate}{repeats}")
    return {"blocks": counts.blocks, "bytes": counts.bytes, "seconds": round(seconds, 3), "repeats": counts.repeats}


@contextmanager
def _log_file(name: str | None) -> Iterator[Any]:
    if name is None:
        yield None
        return
    from conflank_cli.errors import UsageError

    try:
        stream = Path(name).open("w", encoding="utf-8")  # noqa: SIM115  (closed below)
    except OSError as error:
        raise UsageError(f"--log {name}", f"{error.strerror}", "a file that can be written", "Name another.") from None
    with stream:
        yield stream


@contextmanager
def _terminated() -> Iterator[None]:
    """Let SIGTERM end a transfer as Ctrl-C does, with nothing half done."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    try:
        before = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:
        # Not the main thread: whoever started it there has signals of its own.
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _bar(talk: Talk, what: str, total: int | None) -> Iterator[Callable[[Counts], None]]:
    """A bar with bytes, blocks, rate and time left, on a terminal."""
    if talk.quiet or not sys.stderr.isatty():
        yield lambda counts: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TextColumn("{task.fields[blocks]} blocks"),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bars:
        task = bars.add_task(what, total=total, blocks=0)
        yield lambda counts: bars.update(task, completed=counts.bytes, blocks=counts.blocks)


dnc.add_command(simulate)
