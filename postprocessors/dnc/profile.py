"""Profiles: how a control's port is set up, as TOML. What the manuals leave open is an option, its default careful."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import msgspec

from postprocessors.dnc.wire import DC1, DC3, Characters
from postprocessors.errors import PostError
from postprocessors.shipped import read_shipped, schema_error, shipped_names

MOST_RETRIES = 15
"""After as many NAKs the control itself gives up."""
LEAST_IN_FLIGHT = 8
"""The control stops a sender 12 characters before its buffer is full; three or four pass while its DC3 comes back."""
REACTION_S = 0.002
"""In which a program answers a DC3 at best. A line that carries more than 8 characters meanwhile (above 38,400 baud)
can only be stopped in time by the driver or the adapter, whatever is handed to the port."""
AHEAD_S = 0.02
"""How far ahead of such a line characters are handed to the port: long enough that it does not run dry while the system
has something else to do."""

BITS = {"data_8": 0, "bcc_no_control": 1, "stop_by_rts": 2, "stop_by_dc3": 3, "odd": 4, "parity": 5}
"""Bits of MP5020; 6 and 7 are the stop bits."""


class Profile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One control at one port.

    Attributes
    ----------
    name, description: for people.
    port: any name or URL that pyserial opens.
    baud, data_bits, parity, stop_bits: one start bit comes before them.
    handshake: "dc3" (DC1/DC3), "rts-cts", "dc3+rts-cts" or "none".
    dc3_by: who stops at a DC3 while a program is sent: "driver" (the operating system or the adapter, at once) or
        "program" (this one, `in_flight` characters later). Blockwise always "program", because a BCC may look like DC3.
    protocol: "standard", "blockwise" (EXT with BCC), "fe1" or "fe2" (blockwise with fixed characters).
    bcc_no_control: bit 1 of MP5020: a space before ETB where the BCC would be below 0x20.
    prompt: whether DC1 follows each BCC; "auto": with the DC3 handshake.
    line_end_in_block: whether a block carries CR LF at its end (the manuals show "line" only).
    retries: how often a block is repeated after NAK.
    start_timeout_s: how long to wait for the operator; 0 for ever.
    silence_timeout_s: how long silence within a transfer is taken for flow control; 0 for ever.
    reply_timeout_s: how long to wait for what is no flow control: EOT after ETX, the rest of a block that has begun.
    settle_s: a block without DC1 is taken as complete when so long nothing follows its BCC.
    in_flight: most characters handed to the port and not yet on the line; 0: 8 up to 38,400
        baud; above, where only the driver can stop in time, 20 ms of the line.
    leading_nulls: NULs before the first line (standard protocol).
    abort_digit: digit of ESC 1 <digit>, sent when a standard transfer is broken off; -1: send nothing.
    soh ... etb: control characters (MP5010 or MP5200 and following).
    header_answer: what answers the header of a program from the control: "ack", or "echo" (the header itself), as the
        FE1 page of the TNC 430 manual can be read.
    directory_order: of a line in the FE1 directory: "name-sectors" or "sectors-name".
    sector_bytes: size of the sectors that the FE1 directory counts.
    """

    name: str
    description: str = ""
    port: str = ""
    baud: int = 9600
    data_bits: Literal[7, 8] = 7
    parity: Literal["even", "odd", "none"] = "even"
    stop_bits: float = 1.0
    handshake: Literal["dc3", "rts-cts", "dc3+rts-cts", "none"] = "dc3"
    dc3_by: Literal["driver", "program"] = "driver"
    protocol: Literal["standard", "blockwise", "fe1", "fe2"] = "standard"
    bcc_no_control: bool = False
    prompt: Literal["auto", "always", "never"] = "auto"
    line_end_in_block: bool = False
    retries: int = 3
    start_timeout_s: float = 0.0
    silence_timeout_s: float = 120.0
    reply_timeout_s: float = 10.0
    settle_s: float = 0.03
    in_flight: int = 0
    leading_nulls: int = 0
    abort_digit: int = 0
    soh: int = 0x01
    stx: int = 0x02
    etx: int = 0x03
    eot: int = 0x04
    ack: int = 0x06
    etb: int = 0x17
    header_answer: Literal["ack", "echo"] = "ack"
    directory_order: Literal["name-sectors", "sectors-name"] = "name-sectors"
    sector_bytes: int = 512

    @property
    def characters(self) -> Characters:
        """The control characters."""
        return Characters(self.soh, self.stx, self.etx, self.eot, self.ack, self.etb)

    @property
    def blockwise(self) -> bool:
        """Whether lines go as blocks with a BCC."""
        return self.protocol != "standard"

    @property
    def dc3(self) -> bool:
        """Whether DC1 and DC3 are the handshake."""
        return self.handshake.startswith("dc3")

    @property
    def rts_cts(self) -> bool:
        """Whether RTS and CTS are the handshake."""
        return self.handshake.endswith("rts-cts")

    @property
    def prompts(self) -> bool:
        """Whether DC1 follows each BCC that is sent."""
        return self.dc3 if self.prompt == "auto" else self.prompt == "always"

    @property
    def bits_per_character(self) -> float:
        """On the line, start and stop bits included."""
        return 1 + self.data_bits + (self.parity != "none") + self.stop_bits

    @property
    def character_s(self) -> float:
        """Time that one character takes on the line, s."""
        return self.bits_per_character / self.baud

    @property
    def window(self) -> int:
        """Most characters in flight."""
        if self.in_flight or REACTION_S / self.character_s <= LEAST_IN_FLIGHT:
            return self.in_flight or LEAST_IN_FLIGHT
        return int(AHEAD_S / self.character_s)

    @property
    def mp5020(self) -> int:
        """The value of MP5020 that says the same to the control."""
        value = (self.data_bits == 8) << BITS["data_8"] | self.bcc_no_control << BITS["bcc_no_control"]
        value |= self.rts_cts << BITS["stop_by_rts"] | self.dc3 << BITS["stop_by_dc3"]
        value |= (self.parity == "odd") << BITS["odd"] | (self.parity != "none") << BITS["parity"]
        return value | {1.5: 0, 2.0: 1 << 6}.get(self.stop_bits, 1 << 7)

    @property
    def mp5030(self) -> int:
        """The value of MP5030: 0 standard, 1 blockwise."""
        return int(self.blockwise)


def explain_mp5020(value: int) -> dict[str, str]:
    """What a value of MP5020 says, in the words of a profile."""
    on = {name: bool(value >> bit & 1) for name, bit in BITS.items()}
    hands = [name for name, key in (("dc3", "stop_by_dc3"), ("rts-cts", "stop_by_rts")) if on[key]]
    return {
        "data_bits": "8" if on["data_8"] else "7",
        "parity": ("odd" if on["odd"] else "even") if on["parity"] else "none",
        "stop_bits": "1" if value >> 7 & 1 else "2" if value >> 6 & 1 else "1.5",
        "handshake": "+".join(hands) or "none",
        "bcc_no_control": "true" if on["bcc_no_control"] else "false",
    }


_SHIPPED = Path(__file__).parent / "profiles"


def shipped_profiles() -> tuple[str, ...]:
    """Names of the profiles that come with the program."""
    return shipped_names(_SHIPPED)


def load_profile(name_or_path: str | Path, changes: dict[str, str] | None = None) -> Profile:
    """Read a profile by shipped name, or from a file (anything with a folder or ending in .toml).

    `changes` replaces keys of it; values are written as in TOML, with or without quotes.

    Raises
    ------
    PostError: no such profile, unreadable TOML, unknown or impossible values.
    """
    content, where = read_shipped(name_or_path, _SHIPPED, "profile", "a profile")
    return parse_profile(content, where, changes)


def parse_profile(content: str, where: str, changes: dict[str, str] | None = None) -> Profile:
    """Read a profile from the text of its file; `where` names it in messages.

    Raises
    ------
    PostError: no TOML, unknown or impossible values.
    """
    try:
        values = msgspec.toml.decode(content)
        for key, value in (changes or {}).items():
            values[key] = _value(value)
        profile = msgspec.convert(values, Profile)
    except msgspec.ValidationError as error:
        known = Profile.__struct_fields__
        raise schema_error(str(error), where, known, "the keys of a profile", "Compare with docs/dnc.md.") from error
    except msgspec.DecodeError as error:
        raise PostError(where, str(error), "TOML", "Correct the syntax of the file.") from error
    _check(profile, where)
    return profile


def _value(text: str) -> Any:
    """A value as TOML has it; a bare word is a string."""
    try:
        return msgspec.toml.decode(f"x = {text}")["x"]
    except msgspec.DecodeError:
        return text


def _check(profile: Profile, where: str) -> None:
    """Refuse what the types allow and a serial line does not."""
    rules = [
        ("baud", 50 <= profile.baud <= 4_000_000, "50 to 4000000"),
        ("stop_bits", profile.stop_bits in (1.0, 1.5, 2.0), "1, 1.5 or 2"),
        ("retries", 0 <= profile.retries <= MOST_RETRIES, f"0 to {MOST_RETRIES}"),
        ("in_flight", 0 <= profile.in_flight <= 4096, "0 to 4096"),
        ("leading_nulls", 0 <= profile.leading_nulls <= 1000, "0 to 1000"),
        ("abort_digit", -1 <= profile.abort_digit <= 7, "-1 to 7"),
        ("sector_bytes", profile.sector_bytes >= 1, "1 or more"),
        # The space of the former would come after the CR LF of the latter, where a line cannot end.
        ("bcc_no_control", not (profile.bcc_no_control and profile.line_end_in_block), "false with line_end_in_block"),
    ]
    for key in ("start_timeout_s", "silence_timeout_s"):
        rules.append((key, 0.0 <= getattr(profile, key) < 1e6, "0 (for ever) or seconds"))
    for key in ("reply_timeout_s", "settle_s"):
        rules.append((key, 0.0 < getattr(profile, key) < 1e6, "seconds, more than 0"))
    for key, good, expected in rules:
        if not good:
            raise PostError(f"{where}: {key}", f"{getattr(profile, key)}", expected, "Correct the profile.")
    codes = [profile.soh, profile.stx, profile.etx, profile.eot, profile.ack, profile.etb]
    if len(profile.characters.all() | {DC1, DC3}) != len(codes) + 4 or not all(0 < code < 0x20 for code in codes):
        expected = "six different control characters, 1 to 31, other than DC1, DC3, NAK and ESC"
        raise PostError(f"{where}: soh, stx, etx, eot, ack, etb", f"{codes}", expected, "Correct the profile.")
    if profile.protocol == "fe1" or profile.protocol == "fe2":
        fixed = (profile.data_bits, profile.parity, profile.stop_bits)
        if fixed != (7, "even", 1.0) or profile.characters != Characters():
            found = f"{profile.data_bits} data bits, {profile.parity} parity, {profile.stop_bits:g} stop bits"
            expected = "7, even, 1 and the usual characters, which FE fixes"
            raise PostError(
                f"{where}: protocol {profile.protocol}", found, expected, "Use blockwise for other settings."
            )
