"""LSV-2 over TCP, against a server on this computer."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from conflank_cli.cli import cli
from tests.postprocessors.dnc.lsv2_server import FOLDER, Server

TEXT = b"".join(b"%d L X+%d.5 Y-3.25 F800\r\n" % (n, n) for n in range(900))


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "BLADE1.H"
    path.write_bytes(TEXT)
    return path


def dnc(*arguments: str):
    return CliRunner().invoke(cli, ["dnc", *arguments, "--folder", FOLDER])


def test_both_directions_are_byte_for_byte(server: Server, program: Path) -> None:
    result = dnc("send", str(program), "--unverified", "--send", "--lsv2", server.address)
    assert result.exit_code == 0, result.stderr
    assert server.files == {f"{FOLDER}\\BLADE1.H": TEXT}
    copy = program.parent / "COPY.H"
    result = dnc("receive", "BLADE1.H", "-o", str(copy), "--lsv2", server.address)
    assert result.exit_code == 0, result.stderr
    assert copy.read_bytes() == TEXT
    assert sorted(path.name for path in program.parent.iterdir()) == ["BLADE1.H", "COPY.H"]


def test_it_is_dry_and_gated_too(server: Server, program: Path) -> None:
    assert dnc("send", str(program), "--lsv2", server.address).exit_code == 3
    result = dnc("send", str(program), "--unverified", "--lsv2", server.address)
    assert result.exit_code == 0 and "nothing was sent" in result.stdout
    assert server.files == {}


def test_a_file_that_exists_is_replaced_only_when_told(server: Server, program: Path) -> None:
    name = f"{FOLDER}\\BLADE1.H"
    server.files[name] = b"old\r\n"
    result = dnc("send", str(program), "--unverified", "--send", "--lsv2", server.address)
    assert result.exit_code == 5 and "exists" in result.stderr
    assert server.files == {name: b"old\r\n"}
    result = dnc("send", str(program), "--unverified", "--send", "--overwrite", "--lsv2", server.address)
    assert result.exit_code == 0, result.stderr
    assert server.files == {name: TEXT}


def test_a_connection_that_breaks_leaves_nothing_under_the_name(program: Path) -> None:
    server = Server(breaks_after=3)
    server.files[f"{FOLDER}\\OTHER.H"] = TEXT
    try:
        result = dnc("send", str(program), "--unverified", "--send", "--lsv2", server.address)
        assert result.exit_code == 5, result.stderr
        assert f"{FOLDER}\\BLADE1.H" not in server.files
        result = dnc("receive", "OTHER.H", "-o", str(program.parent / "OTHER.H"), "--lsv2", server.address)
        assert result.exit_code == 5, result.stderr
    finally:
        server.close()
    assert sorted(path.name for path in program.parent.iterdir()) == ["BLADE1.H"]


def test_a_file_that_arrives_short_is_not_given_its_name(program: Path) -> None:
    server = Server(loses=7)
    try:
        result = dnc("send", str(program), "--unverified", "--send", "--lsv2", server.address)
    finally:
        server.close()
    assert result.exit_code == 5
    assert f"of {len(TEXT)} bytes arrived" in result.stderr
    assert f"{FOLDER}\\BLADE1.H" not in server.files


def test_no_file_no_server_no_login(server: Server, tmp_path: Path) -> None:
    result = dnc("receive", "NONE.H", "-o", str(tmp_path / "X.H"), "--lsv2", server.address)
    assert result.exit_code == 5 and "no such file" in result.stderr
    address = server.address
    server.close()
    result = dnc("receive", "NONE.H", "-o", str(tmp_path / "X.H"), "--lsv2", "127.0.0.1:1")
    assert result.exit_code == 5
    assert dnc("receive", "NONE.H", "-o", str(tmp_path / "X.H"), "--lsv2", address + "x").exit_code == 3
    assert [*tmp_path.iterdir()] == []
