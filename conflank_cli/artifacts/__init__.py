"""The files that stages exchange: one NPZ each, arrays plus one JSON document."""

from conflank_cli.artifacts.npz import Kind, read_artifact, write_artifact

__all__ = ["Kind", "read_artifact", "write_artifact"]
