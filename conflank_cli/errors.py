"""What can go wrong, as a user reads it: where, what was found, what was expected, and what to do next.

Exit codes (the command line maps an error to its ``exit_code``): 0 done, 1 valid run with findings, 2 usage,
3 bad input file, 4 numerical failure, 5 device.
"""

from __future__ import annotations

EXIT_DONE = 0
EXIT_FINDINGS = 1
EXIT_USAGE = 2
EXIT_INPUT = 3
EXIT_NUMERICAL = 4
EXIT_DEVICE = 5


class ConflankError(Exception):
    """Base of all errors meant for the user.

    Parameters
    ----------
    where: file and place in it, e.g. ``"job.toml: [tools.define.MY6] r_min"``.
    found: what is there.
    expected: what should be there.
    next_step: what the user can do about it.
    """

    exit_code = EXIT_INPUT

    def __init__(self, where: str, found: str, expected: str, next_step: str) -> None:
        super().__init__(where, found, expected, next_step)
        self.where = where
        self.found = found
        self.expected = expected
        self.next_step = next_step

    def __str__(self) -> str:
        return f"{self.where}: found {self.found}; expected {self.expected}. {self.next_step}"


class UsageError(ConflankError):
    """The command line itself is wrong (exit code 2)."""

    exit_code = EXIT_USAGE


class InputError(ConflankError):
    """A file is missing, damaged, or says something impossible (exit code 3)."""

    exit_code = EXIT_INPUT


class NumericalError(ConflankError):
    """The input is sound but no usable result was found (exit code 4)."""

    exit_code = EXIT_NUMERICAL


class DeviceError(ConflankError):
    """A port or a control did not do its part (exit code 5)."""

    exit_code = EXIT_DEVICE
