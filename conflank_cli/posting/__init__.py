"""From sweeps to the neutral tool path and the program: block spacing, feed, approach and retract."""

from conflank_cli.posting.program import plan_to_toolpath, post_program, post_programs
from conflank_cli.posting.summary import summarize

__all__ = ["plan_to_toolpath", "post_program", "post_programs", "summarize"]
