"""The reader of the README, and what it notes of a shell."""

from pathlib import Path

import pytest

from benchmarks.first_user import Step, followed, steps

TEXT = """# Title

Type this:

    echo one
    cd folder

Save this as `a.toml`:

```toml
[part]

file = "x"
```

Not this:

```toml
[other]
```

Without make, it is

    false
"""


def test_blocks_are_typed_files_saved_and_the_alternative_left_out() -> None:
    assert list(steps(TEXT)) == [
        Step(typed="echo one"),
        Step(typed="cd folder"),
        Step(file="a.toml", content='[part]\n\nfile = "x"\n'),
    ]


@pytest.mark.parametrize(("last", "code"), [("cat a.toml", 0), ("exit_code_of_no_command", 127), ("false | true", 1)])
def test_one_shell_does_it_all_and_ends_where_something_fails(last: str, code: int, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / ".git").mkdir()
    todo = [*steps(TEXT), Step(typed=last), Step(typed="echo end")]
    done = followed(todo, tmp_path, tmp_path / "log")
    assert (tmp_path / "folder" / "a.toml").read_text() == '[part]\n\nfile = "x"\n'
    expected = [("echo one", 0), ("cd folder", 0), (last, code), ("echo end", 0)]
    assert [(each.typed, each.code) for each in done] == (expected if code == 0 else expected[:3])
    assert all(each.wall >= 0.0 and each.processor >= 0.0 for each in done)
    assert ("end" in (tmp_path / "log").read_text().split()) is (code == 0)
