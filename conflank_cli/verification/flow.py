"""The order in which the blocks of one program are run: labels, calls of subprograms, repetitions, jumps."""

from __future__ import annotations

from dataclasses import dataclass

from conflank_cli.verification.blocks import Block
from conflank_cli.verification.recorder import Recorder

DEEPEST = 20
"""Levels of calls; the control allows fewer."""

MOST_AGAIN = 100_000
"""Blocks that are run again, by repetitions, calls and jumps, before a program is given up."""


@dataclass(frozen=True, slots=True)
class Jump:
    """A block that steers the program.

    "label"; "call" of one, with `repeat` if it repeats what lies between; "end" (M2, M30); "last", after which no block
    comes.
    """

    kind: str
    name: str = ""
    repeat: int | None = None


class Flow:
    """Runs through the blocks of one program.

    A subprogram stands between its label and the next label 0. A call without repetitions runs it; a call with n
    repetitions runs what lies between the label and the call n times more.
    """

    def __init__(self, blocks: list[Block], jumps: dict[int, Jump], recorder: Recorder) -> None:
        """Take the blocks, and those among them that steer, by their index."""
        self._blocks = blocks
        self._jumps = jumps
        self._recorder = recorder
        self._labels: dict[str, int] = {}
        for index, jump in jumps.items():
            if jump.kind == "label" and jump.name != "0":
                if jump.name in self._labels:
                    recorder.find("CF109", f"label {jump.name} stands twice", blocks[index].number)
                self._labels.setdefault(jump.name, index)
        self._place = 0
        self._count = 0
        self._returns: list[int] = []
        self._left: dict[int, int] = {}
        self.ended: int | None = None
        """The block with M2 or M30 that has ended the program."""

    def next(self) -> Block | None:
        """The next block that does not steer; None at the end."""
        while self._place < len(self._blocks):
            index = self._place
            self._place += 1
            self._count += 1
            jump = self._jumps.get(index)
            block = self._blocks[index]
            if self._count > len(self._blocks) + MOST_AGAIN:
                text = f"repetitions beyond {MOST_AGAIN:,} blocks are not followed"
                self._recorder.find("CF102", text, block.number)
                return None
            if jump is None:
                return block
            if jump.kind == "end":
                if self._returns:
                    self._recorder.find("CF109", "the program ends within a subprogram", block.number)
                self.ended = block.number
                self._place = len(self._blocks)
                return block
            self._steer(index, jump, block.number)
        return None

    def go_to(self, label: str, block: int) -> None:
        """Go on at a label."""
        if label in self._labels:
            self._place = self._labels[label]
        else:
            self._recorder.find("CF109", f"label {label} is not in the program", block)

    def _steer(self, index: int, jump: Jump, block: int) -> None:
        find = self._recorder.find
        if jump.kind == "last":
            if self._returns:
                find("CF109", "a subprogram without LBL 0 (G98 L0) at its end", block)
            self._place = len(self._blocks)
        elif jump.kind == "label":
            if jump.name == "0" and self._returns:
                self._place = self._returns.pop()
        elif jump.name not in self._labels:
            find("CF109", f"label {jump.name} is not in the program", block)
        elif jump.repeat is None:
            if len(self._returns) >= DEEPEST:
                find("CF102", f"calls more than {DEEPEST} deep are not followed", block)
            else:
                self._returns.append(self._place)
                self._place = self._labels[jump.name] + 1
        elif self._labels[jump.name] > index:
            find("CF109", f"label {jump.name} to be repeated comes later", block)
        else:
            left = self._left.get(index, jump.repeat)
            if left > 0:
                self._left[index] = left - 1
                self._place = self._labels[jump.name] + 1
            else:
                # The next time round the repetitions count anew.
                self._left.pop(index, None)
