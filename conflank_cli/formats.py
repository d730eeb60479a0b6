"""How a job wants its program written: the post for its format, and the options that the post gets."""

from __future__ import annotations

from importlib.metadata import version

from conflank_cli.errors import InputError
from conflank_cli.job import Job
from postprocessors.errors import PostError
from postprocessors.post import Post, ProgramOptions, check_options, post_named


def post_of(job: Job) -> Post:
    """The post for the job's format, once it is known to have what the job asks for.

    Raises
    ------
    InputError: no post of that name is installed, or it does not have the style, split or options.
    """
    try:
        post = post_named(job.program.format)
        check_options(post, program_options(job, post))
    except PostError as error:
        raise InputError(error.where, error.found, error.expected, error.next_step) from error
    return post


def program_options(job: Job, post: Post) -> ProgramOptions:
    """What the job asks of a post; the style is the post's first unless the job names one."""
    program = job.program
    return ProgramOptions(
        version=version("conflank"),
        style=post.styles[0] if program.style is None else program.style,
        datum=program.datum,
        coolant=program.coolant,
        tolerance_mm=program.cycle32.t,
        tolerance_deg=program.cycle32.ta,
        split=program.split,
        own=program.options,
    )
