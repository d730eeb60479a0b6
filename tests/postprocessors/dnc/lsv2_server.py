"""A loopback server for LSV-2 over TCP: length, four letters, payload. Enough of it to move files."""

from __future__ import annotations

import socket
import struct
import threading
from dataclasses import dataclass, field

NO_FILE = 32
LONGEST_BLOCK = 4096
FOLDER = "TNC:\\PROGS"


@dataclass
class Server:
    """One connection after another, each until the client leaves.

    Attributes
    ----------
    files: by full name.
    breaks_after: telegrams with data after which it closes the connection (0: never).
    loses: bytes that it drops from the end of each file.
    """

    files: dict[str, bytes] = field(default_factory=dict)
    breaks_after: int = 0
    loses: int = 0

    def __post_init__(self) -> None:
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._socket.close()

    def _run(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            with connection:
                try:
                    self._serve(connection)
                except (ConnectionError, EOFError, OSError):
                    continue

    def _serve(self, connection: socket.socket) -> None:
        stream = connection.makefile("rb")
        writing, arrived, sent, pieces = "", b"", 0, []

        def answer(word: str, payload: bytes = b"") -> None:
            connection.sendall(struct.pack("!L", len(payload)) + word.encode() + payload)

        while True:
            head = stream.read(8)
            if len(head) < 8:
                return
            payload = stream.read(struct.unpack("!L", head[:4])[0])
            word = head[4:].decode()
            text = payload.split(b"\0")[0].decode("latin-1")
            if word == "A_LG":
                answer("T_OK")
            elif word in ("A_LO", "C_CC", "C_DC"):
                found = word != "C_DC" or text.rstrip("\\") == FOLDER
                answer("T_OK") if found else answer("T_ER", bytes((1, NO_FILE)))
            elif word == "R_VR":
                answer("S_VR", b"x\0" if payload else b"iTNC530\x00340490 08\0BASIS\0%0000\0")
            elif word == "R_PR":
                # The longest block is the value after the two bytes of the version; nothing else matters here.
                numbers = [0] * 32 + [LONGEST_BLOCK] + [0] * 9
                answer("S_PR", struct.pack("!14L8B8L2BH4B2L2HL", *numbers))
            elif word == "R_FI":
                if text in self.files:
                    entry = struct.pack("!LLL", len(self.files[text]), 1_700_000_000, 0x02)
                    answer("S_FI", entry + text.rpartition("\\")[2].encode() + b"\0")
                else:
                    answer("T_ER", bytes((1, NO_FILE)))
            elif word == "R_DI":
                answer("S_DI", struct.pack("!L", 1 << 30) + b"\0" * 160 + FOLDER.encode() + b"\0")
            elif word == "C_FL":
                writing, arrived = text, b""
                answer("T_OK")
            elif word == "S_FL":
                arrived += payload
                sent += 1
                if self.breaks_after and sent >= self.breaks_after:
                    return
                answer("T_OK")
            elif word == "T_FD":
                self.files[writing] = arrived[: len(arrived) - self.loses]
                answer("T_OK")
            elif word == "C_FD":
                self.files.pop(text)
                answer("T_OK")
            elif word == "C_FR":
                source, target = (part.decode("latin-1") for part in payload.split(b"\0")[:2])
                self.files[target] = self.files.pop(f"{FOLDER}\\{source}")
                answer("T_OK")
            elif word == "R_FL":
                data = self.files[text]
                pieces = [data[first : first + 1000] for first in range(0, len(data), 1000)]
                answer("S_FL", pieces.pop(0))
            elif word == "T_OK":
                sent += 1
                if self.breaks_after and sent >= self.breaks_after:
                    return
                if pieces:
                    answer("S_FL", pieces.pop(0))
                else:
                    answer("T_FD")
            else:
                answer("T_ER", b"\x01\x14")
