"""The files that stages exchange: one NPZ each, arrays plus one JSON document."""

from conflank_cli.artifacts.npz import Contents, Kind, read_artifact, read_plan, write_artifact

__all__ = ["Contents", "Kind", "read_artifact", "read_plan", "write_artifact"]
