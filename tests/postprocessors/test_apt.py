import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from postprocessors.apt import WIDTH, write_apt
from postprocessors.errors import PostError
from postprocessors.machines.machine import load_machine
from postprocessors.post import ProgramOptions
from postprocessors.toolpath import Operation, Purpose, Stretch
from tests.postprocessors.heidenhain.test_conversational import OPTIONS, T1, axis_at, path_of, small_path, with_sweep

CL = replace(OPTIONS, style="multax")


def test_no_line_is_too_long() -> None:
    tip = np.array([[-199999.5, -188888.25, -177777.125], [0.0, 0.0, 0.0]])
    axis = np.array([axis_at(-100.0, 20.0)] * 2)
    path = path_of(Operation(T1, (Stretch(Purpose.SWEEP, 1, tip, axis, np.array([0.0, 500.0])),)))
    (program,) = write_apt(path, load_machine("ac-table"), CL)
    lines = program.text.split("\r\n")
    assert max(map(len, lines)) <= WIDTH
    (folded,) = (k for k, line in enumerate(lines) if line.endswith("$"))
    numbers = (lines[folded][:-1] + lines[folded + 1]).partition("/")[2].split(",")
    np.testing.assert_allclose([float(number) for number in numbers], [*tip[0], *axis[0]], atol=1e-4)


def test_any_axis_can_be_given_whatever_the_machine_reaches() -> None:
    path = with_sweep(axis=np.array([axis_at(-130.0, 0.0)] * 2))
    (program,) = write_apt(path, load_machine("ac-table"), CL)
    assert "GOTO/" in program.text


def test_the_feed_is_given_again_after_every_rapid() -> None:
    (program,) = write_apt(small_path(), load_machine("ac-table"), CL)
    words = re.findall(r"^(RAPID|FEDRAT|GOTO)", program.text, re.MULTILINE)
    for rapid, following in pairwise(words):
        if rapid == "RAPID":
            assert following == "GOTO"
    for number, word in enumerate(words):
        if word == "RAPID" and number + 2 < len(words):
            assert words[number + 2] in ("FEDRAT", "RAPID")


@pytest.mark.parametrize(
    ("options", "where"),
    [
        (replace(CL, style="tcpm"), "[program] style"),
        (replace(CL, split="tool"), "[program] split"),
        (replace(CL, datum=(1.0, 0.0, 0.0)), "[program] datum"),
        (replace(CL, own={"decimal": "comma"}), "[program] options"),
    ],
)
def test_what_the_data_do_not_have_is_refused(options: ProgramOptions, where: str) -> None:
    with pytest.raises(PostError) as caught:
        write_apt(small_path(), load_machine("ac-table"), options)
    assert caught.value.where == where


def test_a_pose_that_is_none_is_named() -> None:
    path = with_sweep(tip=np.array([[0.0, 0.0, 0.0], [np.inf, 0.0, 0.0]]))
    with pytest.raises(PostError, match="sweep 5, pose 2"):
        write_apt(path, load_machine("ac-table"), CL)
