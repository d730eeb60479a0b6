"""Files of pictures: their formats."""

from __future__ import annotations

from pathlib import Path

from conflank_cli.errors import UsageError

# Picture formats, and the metadata that keeps equal pictures byte-equal.
FORMATS = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
# Resolution, dots per inch.
DPI = 130


def picture_suffix(file: str, option: str = "--picture") -> str:
    """The suffix of a picture's file, which an option names.

    Raises
    ------
    UsageError: it is no picture format known here.
    """
    suffix = Path(file).suffix.lower()
    if suffix not in FORMATS:
        raise UsageError(
            f"{option} {file}", f"suffix {suffix!r}", "one of " + ", ".join(FORMATS), "Rename the picture."
        )
    return suffix
