"""What a HEIDENHAIN control makes of its blocks, in whichever of its languages they are written.

The control is a state: tool, spindle, coolant, feed, tool centre point control, coordinate system, parameters. What may
change it, and what is harmless, stands in lists; everything else in a program is a finding.

Source: HEIDENHAIN iTNC 530 user's manuals, conversational (340 49x) and DIN/ISO programming.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from math import cos, hypot, nan, radians, sin
from typing import NamedTuple

from conflank_cli.verification.arcs import (
    about_pole,
    chamfered,
    points_on,
    pole_of_radius,
    pole_of_tangent,
    rounded,
)
from conflank_cli.verification.blocks import Block
from conflank_cli.verification.flow import Flow
from conflank_cli.verification.frames import Frame, Matrix, spatial
from conflank_cli.verification.numbers import MOST_FEED, MOST_SPINDLE, MOST_TOOL
from conflank_cli.verification.parameters import Parameters
from conflank_cli.verification.program import CalledProgram, CutLabel, HeaderReader, Interpolation, Program
from conflank_cli.verification.recorder import Recorder
from conflank_cli.verification.words import INCH, ROTARY, Vector, Words

_HARMLESS = frozenset({94, 107, 108, 117, 134, 135, 145, 148, 149})
"""M functions that change neither where the cutter goes nor how fast: display of rotary axes, messages about deltas,
feed of rotary axes in degrees, exact stop at corners, no compensation of what M144 would, lift-off at an NC stop."""

_FOLLOWED = frozenset({0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 14, 19, 30, 91, 92, 126, 127, 128, 129, 136, 137, 140})

_UNIT_TOLERANCE = 1e-3
"""A surface normal whose length is off by more than this is a mistake, not rounding."""


class Corner(NamedTuple):
    """A rounding or chamfer that waits for the line after it: its size in mm, and both ends of the line before."""

    kind: str
    size: float
    before: Vector
    corner: Vector
    block: int


class Control:
    """The state of the control while a program is read, beyond that of the recorder."""

    def __init__(self, header: HeaderReader, recorder: Recorder, harmless: Iterable[int] = ()) -> None:
        """Begin. `harmless`: M functions that the machine has and that change nothing that is judged."""
        self.header = header
        self.recorder = recorder
        self.parameters = Parameters()
        self.unit = 1.0
        self.name = ""
        self.side = "R0"
        self.flow: Flow | None = None
        self.corner: Corner | None = None
        self.speed: float | None = None
        self.tool_feed = nan
        self._harmless = _HARMLESS | frozenset(harmless)
        self._per_revolution = False
        self._preset: int | None = None
        self._pole: tuple[float, float] | None = None
        self._leaving: tuple[float, float] | None = None

    @property
    def feed_unit(self) -> float:
        """Feeds of inch programs are in tenths of an inch a minute."""
        return 1.0 if self.unit == 1.0 else INCH / 10.0

    def running_through(self, flow: Flow) -> Iterator[Block]:
        """Blocks to follow, in the order they run; comments are read on the way."""
        while (block := flow.next()) is not None:
            if block.comments:
                self.comments(block)
            if not block.text:
                continue
            if block.skippable:
                self.recorder.find("CF102", "skippable block: read as if it were run", block.number)
            yield block

    def comments(self, block: Block) -> None:
        """Labels of cuts; the header's facts have been read before."""
        for comment in block.comments:
            label = HeaderReader().read(comment)
            if isinstance(label, CutLabel):
                self.recorder.label(label)

    # --- parameters and jumps ---------------------------------------------------------------------------------------

    def assign(self, name: str, value: Callable[[], float | None], block: int) -> None:
        """Give a parameter the value of a function or formula; a ValueError says why that is not followed."""
        try:
            self.parameters.set(name, value())
        except ValueError as error:
            self.parameters.set(name, None)
            self.recorder.find("CF102", f"{error}; {name} is not known", block)

    def jump_if(self, holds: bool | None, label: str, text: str, block: int) -> None:
        """A jump on a condition, None where that is not known; `text` is the block."""
        if holds is None:
            self.recorder.find("CF102", f"whether {text[:60]} jumps is not known", block)
            self.recorder.lose_place(block)
        elif holds and self.flow is not None:
            self.flow.go_to(label, block)

    # --- tool, spindle, feed ----------------------------------------------------------------------------------------

    def select_tool(self, text: str | None, name: str | None, block: int) -> None:
        """Call a tool by what stands for its number (a number, `n.i` or a parameter) or by name."""
        number = None
        if text is not None:
            value = self.parameters.value(text)
            if value is None:
                self.recorder.find("CF102", f"tool from {text}: its value is not known", block)
                name = text
            elif not 0 <= value <= MOST_TOOL or value != int(value):
                # Another cutting edge of the same tool, or none that the control has.
                name = f"{value:g}"
            else:
                number = int(value)
        self.recorder.call_tool(number, name, block)

    def set_speed(self, text: str, block: int) -> None:
        """The S word; a spindle that turns goes on at the new speed."""
        speed = self.parameters.value(text)
        if speed is not None and not 0.0 <= speed <= MOST_SPINDLE:
            self.recorder.find("CF114", f"S{text[:20]} is beyond what the control takes", block)
            speed = None
        self.speed = speed
        if self.recorder.spindle != 0.0:
            self._turn_spindle(-1.0 if self.recorder.spindle < 0.0 else 1.0)

    def _turn_spindle(self, way: float) -> None:
        self.recorder.spindle = nan if self.speed is None else way * self.speed

    def set_feed(self, text: str, block: int) -> None:
        """A feed that holds from now on: a number, a parameter, or AUTO for that of the tool call."""
        find = self.recorder.find
        feed: float | None
        if text == "AUTO":
            feed = self.tool_feed
            if feed != feed:
                find("CF115", "F AUTO without a feed in the tool call", block)
        else:
            feed = self.parameters.value(text)
            if feed is None:
                find("CF102", f"feed from {text}: its value is not known", block)
                feed = nan
            elif not 0.0 < feed <= MOST_FEED:
                find("CF115", f"F{text[:20]} is no feed that the control could drive", block)
                feed = nan
            feed *= self.feed_unit
        if self._per_revolution:
            feed = nan
        self.recorder.feed = feed

    def check_deltas(self, deltas: Iterable[tuple[str, str]], block: int) -> None:
        """DL, DR and DR2 of a tool call: whatever is not zero moves the path in ways that are not followed."""
        for name, text in deltas:
            if self.parameters.value(text) != 0.0:
                self.recorder.find("CF102", f"delta {name}{text} in the tool call is not followed", block)

    # --- coordinate systems -----------------------------------------------------------------------------------------

    def set_preset(self, text: str, block: int) -> None:
        """Cycle 247: another preset, and no shift, mirroring, rotation or scaling any more."""
        recorder = self.recorder
        value = self.parameters.value(text)
        chosen = None if value is None or value != int(value) else int(value)
        if chosen is None:
            recorder.find("CF118", f"preset {text}: its number is not known", block)
        if chosen is None or (self._preset is not None and chosen != self._preset):
            recorder.lose_place(block)
        if self._preset is not None and chosen != self._preset:
            recorder.find("CF118", "more than one preset: the header states one frame", block)
        self._preset = chosen
        recorder.change_frame(recorder.frame.without("shift", "mirrored", "rotation", "scale"))
        recorder.set(recorder.presets, chosen, block)

    def shift_datum(self, words: Words, block: int) -> None:
        """Cycle 7, or G54."""
        recorder = self.recorder
        self._refuse(words, block, "datum shift")
        shift = dict(zip("XYZ", recorder.frame.shift, strict=True))
        for word, value in words.axes.items():
            if word[-1] in ROTARY or value is None:
                if value != 0.0:
                    recorder.find("CF102", f"datum shift in {word} is not followed", block)
                    recorder.unfollowed = "a datum shift"
                continue
            shift[word[-1]] = value + (shift[word[-1]] if word[0] == "I" else 0.0)
        frame = replace(recorder.frame, shift=(shift["X"], shift["Y"], shift["Z"]))
        if frame != recorder.frame and not recorder.frame.only_shifted:
            recorder.find("CF102", "datum shift in a turned, mirrored or scaled system is not followed", block)
            recorder.unfollowed = "a datum shift"
        recorder.change_frame(frame)

    def tilt(self, matrix: Matrix, block: int) -> None:
        """Another tilt of the working plane; the rotary axes stand as they are."""
        recorder = self.recorder
        if recorder.controlled:
            recorder.find("CF113", "working plane tilted while tool centre point control is active", block)
        if recorder.frame.in_plane and matrix != recorder.frame.tilt:
            recorder.find("CF102", "tilt of a mirrored, rotated or scaled system is not followed", block)
            recorder.unfollowed = "a tilted plane"
        recorder.change_frame(replace(recorder.frame, tilt=matrix))
        recorder.set(recorder.tilts, recorder.frame.tilted, block)

    def reset_tilt(self, block: int) -> None:
        """PLANE RESET: the working plane is that of the preset."""
        recorder = self.recorder
        if recorder.controlled and recorder.frame.tilted:
            recorder.find("CF113", "PLANE RESET while tool centre point control is active", block)
        recorder.change_frame(recorder.frame.without("tilt"))
        recorder.set(recorder.tilts, False, block)

    def mirror(self, letters: str, block: int) -> None:
        """Cycle 8: these axes are mirrored, and no other."""
        frame = self.recorder.frame
        if letters and (frame.rotation != 0.0 or frame.scale != (1.0, 1.0, 1.0)):
            self.recorder.find("CF102", "mirroring of a rotated or scaled system is not followed", block)
            self.recorder.unfollowed = "mirroring"
        self._change_in_plane(replace(frame, mirrored=letters), block)

    def rotate(self, degrees: float | None, incremental: bool, block: int) -> None:
        """Cycle 10: rotation about the tool axis."""
        frame = self.recorder.frame
        if degrees is None or ((frame.mirrored or frame.scale != (1.0, 1.0, 1.0)) and degrees != 0.0):
            self.recorder.find("CF102", "this rotation is not followed", block)
            self.recorder.unfollowed = "a rotation"
            return
        before = frame.rotation if incremental else 0.0
        self._change_in_plane(replace(frame, rotation=before + radians(degrees)), block)

    def scale(self, factors: Vector | None, block: int) -> None:
        """Cycle 26: a factor for each axis."""
        if factors is None or min(factors) <= 0.0:
            self.recorder.find("CF102", "this scaling is not followed", block)
            self.recorder.unfollowed = "a scaling"
            return
        self._change_in_plane(replace(self.recorder.frame, scale=factors), block)

    def _change_in_plane(self, frame: Frame, block: int) -> None:
        if self.recorder.controlled and frame != self.recorder.frame:
            self.recorder.find("CF113", "frame changed while tool centre point control is active", block)
        self.recorder.change_frame(frame)

    def not_followed(self, what: str, block: int) -> None:
        """A frame that is not followed: from here on no pose is known."""
        self.recorder.find("CF102", f"{what} is not followed", block)
        self.recorder.unfollowed = what

    def spatial_angles(self, words: Words, block: int) -> Matrix | None:
        """Tilt of cycle 19 or G80; None where an angle is not known."""
        angles = [words.axes.get(letter, 0.0) for letter in ROTARY]
        self._refuse(words, block, "tilted plane")
        a, b, c = angles
        if a is None or b is None or c is None or set(words.axes) - set(ROTARY):
            self.not_followed("a tilted plane by these words", block)
            return None
        return spatial(a, b, c)

    def set_tolerance(self, text: str | None, block: int) -> None:
        """T of cycle 32; None: as the builder has set it."""
        recorder = self.recorder
        value = None if text is None else self.parameters.value(text)
        if text is not None and value is None:
            recorder.find("CF117", f"tolerance from {text}: its value is not known", block)
        recorder.set(recorder.tolerances, None if value is None else (value * self.unit, None), block)

    def set_rotary_tolerance(self, text: str, block: int) -> None:
        """TA of cycle 32, after T."""
        recorder = self.recorder
        last = recorder.tolerances[-1].value if recorder.tolerances else None
        value = self.parameters.value(text)
        if value is None:
            recorder.find("CF117", f"tolerance from {text}: its value is not known", block)
        if isinstance(last, tuple):
            recorder.tolerances.pop()
            recorder.set(recorder.tolerances, (last[0], value), block)
        else:
            recorder.find("CF117", "TA without T", block)

    # --- motion -----------------------------------------------------------------------------------------------------

    def plain(self, axes: dict[str, float | None], vector: Vector | None, rapid: bool, block: int) -> None:
        """A straight move of the usual words only."""
        if self.side != "R0":
            self._check_side(bool(vector) or any(letter in axes for letter in ROTARY), block)
        if self.corner is not None:
            self._finish_corner(axes, block)
        self._leaving = None
        self.recorder.move(axes, vector, rapid, block)

    def _check_side(self, oriented: bool, block: int) -> None:
        if not self.recorder.controlled or not oriented:
            self.recorder.find(
                "CF102", f"radius compensation {self.side} is not followed", block, "radius compensation"
            )

    def _refuse(self, words: Words, block: int, what: str) -> None:
        """A finding for every word but coordinates."""
        self.wrong_words(words, block)
        others = words.polar or words.vector or words.normal or words.radius or words.turn or words.feed or words.side
        if others or words.variant or words.functions or words.back:
            self.recorder.find("CF101", f"{what} with words that do not belong to it", block)

    def wrong_words(self, words: Words, block: int) -> None:
        """Findings for what is no word, stands twice, or is beyond the control's range."""
        if words.rest:
            self.recorder.find("CF101", f"words not understood: {words.rest[:60]}", block)
        for text in words.wrong:
            self.recorder.find("CF109", text, block)
        known = {**words.axes, **words.polar, **words.vector}
        if any(value is None and word not in words.plane for word, value in known.items()):
            self.recorder.find("CF102", "coordinate whose value is not known", block)

    def motion(self, words: Words, vectors: bool, rapid: bool, block: int) -> None:
        """A block of straight motion, M functions or both; `vectors`: whether tool vectors may stand in it."""
        recorder = self.recorder
        self.wrong_words(words, block)
        if words.polar or words.radius or words.turn:
            recorder.find("CF101", "words of an arc or of polar coordinates in a straight move", block)
        rapid = self.begin(words, rapid, block)
        functions = words.functions
        if words.axes or words.vector or words.normal:
            if 91 in functions or 92 in functions:
                self._in_machine_coordinates(words, rapid, block)
            else:
                self._straight(words, vectors, rapid, block)
        if 140 in functions:
            if words.axes or words.vector:
                recorder.find("CF102", "M140 in a block that moves axes is not followed", block)
            self._retract(words.back, rapid, block)
        elif words.back is not None:
            recorder.find("CF101", "MB without M140", block)
        self.finish(words, block)

    def _straight(self, words: Words, vectors: bool, rapid: bool, block: int) -> None:
        vector = None
        if words.vector or words.normal:
            vector = self._vectors(words, vectors, block)
        if self.side != "R0":
            self._check_side(vector is not None or any(word[-1] in ROTARY for word in words.axes), block)
        if self.corner is not None:
            self._finish_corner(words.axes, block)
        self._leaving = None
        self.recorder.move(words.axes, vector, rapid, block, words.plane)

    def _vectors(self, words: Words, allowed: bool, block: int) -> Vector | None:
        find = self.recorder.find
        if words.normal:
            nx, ny, nz = (words.normal.get(letter) for letter in "XYZ")
            if not allowed or nx is None or ny is None or nz is None:
                find("CF101", "surface normal needs LN and all of NX NY NZ", block)
            elif abs(hypot(nx, ny, nz) - 1.0) > _UNIT_TOLERANCE:
                find("CF109", f"surface normal of length {hypot(nx, ny, nz):.4f}", block, "surface normal")
        if not words.vector:
            return None
        i, j, k = (words.vector.get(letter) for letter in "XYZ")
        if not allowed or i is None or j is None or k is None:
            find("CF101", "tool vector needs LN and all of TX TY TZ", block)
            return (0.0, 0.0, 0.0)
        return (i, j, k)

    def _in_machine_coordinates(self, words: Words, rapid: bool, block: int) -> None:
        recorder = self.recorder
        if recorder.controlled:
            recorder.find("CF113", "machine coordinates while tool centre point control is active", block)
        if words.vector or words.normal or any(word[0] == "I" for word in words.axes):
            recorder.find("CF102", "increments or vectors in machine coordinates are not followed", block)
        self._no_corner(block)
        self._leaving = None
        recorder.machine_move(words.axes, rapid, block, 92 in words.functions)

    def _retract(self, back: str | None, rapid: bool, block: int) -> None:
        self._no_corner(block)
        self._leaving = None
        if back is None or back == "MAX":
            self.recorder.to_limit(block)
            return
        length = self.parameters.value(back)
        if length is None or length < 0.0:
            self.recorder.find("CF102", f"retract by MB{back[:20]} is not followed", block)
            self.recorder.lose_place(block)
        else:
            self.recorder.retract(length * self.unit, rapid, block)

    def begin(self, words: Words, rapid: bool, block: int) -> bool:
        """What acts before the motion of a block: M functions, feed, compensation; whether it is a rapid."""
        recorder = self.recorder
        for function in words.functions:
            self._function(function, block)
        if len(set(words.functions)) < len(words.functions):
            recorder.find("CF109", "the same M function twice in a block", block)
        if words.variant is not None:
            recorder.find("CF115", f"{words.variant}: only feeds per minute are followed", block)
            recorder.feed = nan
        elif words.feed is not None and words.feed != "MAX":
            self.set_feed(words.feed, block)
        if (
            words.cap is not None
            and words.cap != "MAX"
            and not 0.0 < (self.parameters.value(words.cap) or 0.0) <= MOST_FEED
        ):
            recorder.find("CF115", f"M128 F{words.cap[:20]}: no feed that the axes could follow the tool at", block)
        if words.side is not None and words.side != self.side:
            self.side = words.side
            recorder.set(recorder.sides, words.side, block)
        return rapid or words.feed == "MAX"

    def finish(self, words: Words, block: int) -> None:
        """What acts after the motion of a block."""
        recorder = self.recorder
        for function in words.functions:
            if function == 129:
                recorder.control(False)
            elif function in (0, 1, 2, 5, 6, 19, 30):
                recorder.spindle = 0.0
            if function in (0, 1, 2, 9, 30):
                recorder.coolant = 0
            if function in (0, 1, 5, 6, 19):
                recorder.event(f"M{function}", block)
            if function == 6:
                recorder.lose_place(block)

    def _function(self, function: int, block: int) -> None:
        """What an M function does at the start of its block."""
        recorder = self.recorder
        if function in (3, 4, 13, 14):
            way = 1.0 if function in (3, 13) else -1.0
            if recorder.spindle * way < 0.0:
                recorder.event(f"M{function}: the spindle turns round", block)
            self._turn_spindle(way)
            if not self.speed:
                recorder.find("CF114", f"M{function} without a speed", block)
        if function in (7, 8, 13, 14):
            recorder.coolant = 7 if function == 7 else 8
        elif function in (126, 127):
            recorder.shortest_way = function == 126
        elif function == 128:
            recorder.control(True, Interpolation.AXIS)
            recorder.spatial = False
        elif function == 136:
            recorder.find("CF115", "M136: feed per revolution is not followed", block)
            self._per_revolution, recorder.feed = True, nan
        elif function == 137:
            if self._per_revolution:
                recorder.feed = nan
            self._per_revolution = False
        elif function not in self._harmless and function not in _FOLLOWED:
            recorder.find("CF102", f"M{function} is not followed", block)

    # --- arcs and corners -------------------------------------------------------------------------------------------

    def set_pole(self, words: Words, block: int) -> None:
        """CC, or I and J."""
        self._refuse(words, block, "pole")
        place = self.recorder.place
        axes = words.axes
        if not axes and place is not None:
            self._pole = (place[0], place[1])
            return
        pole = []
        for index, letter in enumerate("XY"):
            value, step = axes.get(letter), axes.get(f"I{letter}")
            if value is None and place is not None:
                value = place[index] + step if step is not None else None
            pole.append(value if value is not None or self._pole is None else self._pole[index])
        x, y = pole
        if x is None or y is None or set(axes) - {"X", "Y", "IX", "IY"}:
            self.recorder.find("CF102", "this pole is not followed", block)
            self._pole = None
        else:
            self._pole = (x, y)

    def polar_end(self, words: Words, block: int) -> bool:
        """Turn PR and PA about the pole into X and Y; whether that could be done."""
        place, pole = self.recorder.place, self._pole
        radius, angle = words.polar.get("PR"), words.polar.get("PA")
        if pole is not None and place is not None:
            x, y = place[0] - pole[0], place[1] - pole[1]
            if (step := words.polar.get("IPR")) is not None:
                radius = hypot(x, y) + step
            if "PR" not in words.polar and "IPR" not in words.polar:
                radius = hypot(x, y)
            if (step := words.polar.get("IPA")) is not None:
                turned = cos(step) * x - sin(step) * y, sin(step) * x + cos(step) * y
                length = hypot(x, y)
                if radius is not None and length > 0.0:
                    words.axes["X"] = pole[0] + radius * turned[0] / length
                    words.axes["Y"] = pole[1] + radius * turned[1] / length
                    return True
        if pole is None or radius is None or angle is None or "X" in words.axes or "Y" in words.axes:
            self.recorder.find("CF102", "polar coordinates that are not followed", block)
            return False
        words.axes["X"] = pole[0] + radius * cos(angle)
        words.axes["Y"] = pole[1] + radius * sin(angle)
        return True

    def arc(self, kind: str, words: Words, block: int) -> None:
        """An arc: "C" about the pole, "CR" by its radius, "CT" tangential; `words.turn` is its sense."""
        recorder = self.recorder
        self.wrong_words(words, block)
        rapid = self.begin(words, False, block)
        self._no_corner(block)
        found = None if rapid or self._off_plane(words) else self._arc_points(kind, words)
        if found is None:
            recorder.find("CF102", f"{kind} block is not followed", block)
            self._leaving = None
            recorder.move(dict.fromkeys("XYZ"), None, False, block)
        else:
            recorder.through(found, block)
            if recorder.feed != recorder.feed:
                recorder.find("CF112", "cutting move without a feed", block)
        self.finish(words, block)

    def _off_plane(self, words: Words) -> bool:
        """Whether an arc has words that lead out of what is followed."""
        others = words.vector or words.normal or words.back or words.plane or words.polar
        return bool(others) or bool(set(words.axes) - {"X", "Y", "Z", "IX", "IY", "IZ"}) or self.side != "R0"

    def _arc_points(self, kind: str, words: Words) -> list[Vector] | None:
        recorder = self.recorder
        place = recorder.place
        if place is None or not recorder.stands:
            return None
        end = list(place)
        for word, value in words.axes.items():
            if value is None:
                return None
            index = "XYZ".index(word[-1])
            end[index] = place[index] + value if word[0] == "I" else value
        start, last = (place[0], place[1]), (end[0], end[1])
        pole, turn = self._pole, words.turn
        if kind == "CR" and words.radius and words.radius[0] is not None:
            pole = pole_of_radius(start, last, words.radius[0], turn)
        elif kind == "CT":
            tangent = None if self._direction() is None else pole_of_tangent(start, last, self._direction() or (0, 0))
            pole, turn = (None, 0) if tangent is None else tangent
        elif words.radius or kind == "CR":
            return None
        if pole is None or turn == 0:
            return None
        arc = about_pole(start, last, pole, turn)
        if arc is None:
            return None
        angle = arc[1]
        around = points_on(start, pole, angle)
        count = len(around)
        # The tangent at the end is square to the radius there.
        self._leaving = (-turn * (around[-1][1] - pole[1]), turn * (around[-1][0] - pole[0]))
        rise = end[2] - place[2]
        points = [(x, y, place[2] + rise * number / count) for number, (x, y) in enumerate(around, start=1)]
        points[-1] = (end[0], end[1], end[2])
        return points

    def helix(self, words: Words, block: int) -> None:
        """CP: an arc about the pole by angle, several turns if it is incremental, climbing if Z is given."""
        recorder, place, pole = self.recorder, self.recorder.place, self._pole
        angle = words.polar.get("IPA")
        if angle is None or "PR" in words.polar or "IPR" in words.polar or "PA" in words.polar:
            if self.polar_end(words, block):
                words.polar = {}
                self.arc("C", words, block)
            else:
                recorder.move(dict.fromkeys("XYZ"), None, False, block)
            return
        self.wrong_words(words, block)
        rapid = self.begin(words, False, block)
        self._no_corner(block)
        step, height = words.axes.get("IZ"), words.axes.get("Z")
        other = set(words.axes) - {"Z", "IZ"} or words.vector or words.normal or words.back or self.side != "R0"
        wrong_way = words.turn != 0 and words.turn * angle < 0.0
        if place is None or pole is None or rapid or other or wrong_way or not recorder.stands:
            recorder.find("CF102", "CP block is not followed", block)
            recorder.move(dict.fromkeys("XYZ"), None, False, block)
        else:
            rise = step if step is not None else 0.0 if height is None else height - place[2]
            around = points_on((place[0], place[1]), pole, angle)
            last = len(around)
            recorder.through(
                [(x, y, place[2] + rise * number / last) for number, (x, y) in enumerate(around, start=1)], block
            )
            turn = 1 if angle > 0.0 else -1
            self._leaving = (-turn * (around[-1][1] - pole[1]), turn * (around[-1][0] - pole[0]))
        self.finish(words, block)

    def set_corner(self, kind: str, size: float | None, block: int) -> None:
        """RND or CHF: the corner that the line before and the line after make."""
        recorder = self.recorder
        self._no_corner(block)
        place, direction = recorder.place, self._line
        if size is None or place is None or direction is None or self.side != "R0" or not recorder.stands:
            recorder.find("CF102", f"{kind} block is not followed", block)
            recorder.lose_place(block)
        else:
            self.corner = Corner(kind, size, direction, place, block)

    @property
    def _line(self) -> Vector | None:
        """Programmed start of the last move, where that was a straight one at feed."""
        return None if self._leaving is not None else self.recorder.came_from()

    def _direction(self) -> tuple[float, float] | None:
        """Direction in the plane in which the last move arrived."""
        if self._leaving is not None:
            return self._leaving
        before, place = self.recorder.came_from(), self.recorder.place
        return None if before is None or place is None else (place[0] - before[0], place[1] - before[1])

    def _finish_corner(self, axes: dict[str, float | None], block: int) -> None:
        """The line after a corner is known: shorten the line before, and put the corner between them."""
        corner, self.corner = self.corner, None
        assert corner is not None
        before, place = corner.before, corner.corner
        after: list[float] | None = list(place)
        for word, value in axes.items():
            if value is None or word[-1] not in "XY" or after is None:
                after = None
                break
            index = "XYZ".index(word[-1])
            after[index] = place[index] + value if word[0] == "I" else value
        shape = rounded if corner.kind == "RND" else chamfered
        found = None
        if after is not None and before[2] == place[2]:
            found = shape((before[0], before[1]), (place[0], place[1]), (after[0], after[1]), corner.size)
        if found is None:
            self.recorder.find("CF102", f"{corner.kind} block is not followed", corner.block)
            self.recorder.lose_place(block)
            return
        start, points = found
        self.recorder.cut_short((*start, place[2]))
        self.recorder.through([(x, y, place[2]) for x, y in points], corner.block)
        # Increments count from the corner, which was the last programmed position.
        for word in [word for word in axes if word[0] == "I"]:
            value = axes.pop(word)
            axes[word[-1]] = None if value is None else value + place["XYZ".index(word[-1])]

    def _no_corner(self, block: int) -> None:
        if self.corner is not None:
            corner, self.corner = self.corner, None
            self.recorder.find("CF102", f"{corner.kind} block is not followed by a straight move", corner.block)
            self.recorder.lose_place(block)

    # --- result -----------------------------------------------------------------------------------------------------

    def result(self, called: Iterable[CalledProgram] = ()) -> Program:
        """What has been read."""
        recorder = self.recorder
        set_last = [setting.value for setting in recorder.tolerances if isinstance(setting.value, tuple)]
        return Program(
            name=self.name,
            header=self.header.header(),
            moves=recorder.moves(),
            cuts=tuple(recorder.cuts),
            tool_calls=tuple(recorder.tool_calls),
            letters="" if recorder.axes is None else recorder.axes,
            tolerance=set_last[-1] if set_last else None,
            unknown_moves=recorder.unknown_moves,
            findings=tuple(recorder.findings.values()),
            called=tuple(called),
            unknown=tuple(recorder.unknown),
            events=tuple(recorder.events),
            presets=tuple(recorder.presets),
            tolerances=tuple(recorder.tolerances),
            sides=tuple(recorder.sides),
            tilts=tuple(recorder.tilts),
        )
