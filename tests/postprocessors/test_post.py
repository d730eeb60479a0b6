"""Posts are found by their entry points, whoever installed them."""

import re
import sys
from pathlib import Path

import pytest

from postprocessors.errors import PostError
from postprocessors.machines.machine import load_machine
from postprocessors.post import Post, ProgramOptions, post_named, post_names
from tests.postprocessors.heidenhain.test_conversational import small_path

MODULE = """
from postprocessors.post import Post, ProgramFile

def write(path, machine, options):
    return (ProgramFile(path.name, "HELLO"),)

POST = Post(".NC", ("plain",), write)
NO_POST = 3
"""


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package that brings a post, and some that do not work."""
    (tmp_path / "foreign_post.py").write_text(MODULE)
    package = tmp_path / "foreign_post-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign-post\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text(
        "[conflank.postprocessors]\nnc = foreign_post:POST\nnone = foreign_post:NO_POST\ngone = foreign_post:GONE\n"
    )
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])


def test_our_own_posts_are_installed() -> None:
    assert {"apt", "h", "i"} <= set(post_names())
    assert [post_named(name).suffix for name in ("h", "i", "apt")] == [".H", ".I", ".APT"]
    assert [post_named(name).styles[0] for name in ("h", "i", "apt")] == ["tcpm", "m128", "multax"]


@pytest.mark.usefixtures("foreign")
def test_a_package_brings_a_post_along() -> None:
    post = post_named("nc")
    assert isinstance(post, Post) and post.suffix == ".NC"


@pytest.mark.usefixtures("foreign")
@pytest.mark.parametrize(("name", "found"), [("none", "whose post is"), ("gone", "does not load"), ("hpgl", "'hpgl'")])
def test_a_post_that_does_not_work_is_named(name: str, found: str) -> None:
    with pytest.raises(PostError) as caught:
        post_named(name)
    assert caught.value.where == "[program] format"
    assert found in caught.value.found


def test_the_post_of_the_docs_works() -> None:
    text = (Path(__file__).parent.parent.parent / "docs" / "posts.md").read_text("utf-8")
    found = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    assert found is not None
    space: dict[str, object] = {}
    exec(found[1], space)
    post = space["POST"]
    assert isinstance(post, Post)
    (program,) = post.write(small_path(), load_machine("ac-table"), ProgramOptions("0", style="plain"))
    assert program.text.split("\r\n")[0] == "0.2182 24.9990 43.3013"
    with pytest.raises(PostError, match="style"):
        post.write(small_path(), load_machine("ac-table"), ProgramOptions("0", style="ln"))
