"""Reading parts: STEP, IGES and BREP through the CAD kernel, and NURBS as JSON."""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from conflank_cli.cad.part import FaceGeometry, Part, PartFace
from conflank_cli.cad.triangulation import triangulate
from conflank_cli.errors import InputError

STEP_END = b"END-ISO-10303-21;"
# How far from a wall "on it" ends, when solids are asked whether they reach to infinity.
INFINITE_POINT_MM = 1.0e-6
# What writers put where they have no name.
NO_NAME = {"", "none", "face", "shape", "advanced_face"}


class _Looks(NamedTuple):
    """Names and colours by shape: maps from a shape without placement to text."""

    name: Callable[[Any], str]
    colour: Callable[[Any], str]


def read_part(path: Path, scale: float = 1.0) -> Part:
    """Read a CAD file.

    Parameters
    ----------
    path: .step .stp .igs .iges .brep .json (the JSON form is described in `conflank_cli.cad.nurbs_json`).
    scale: factor on top of the file's own unit; the readers turn inches and the like into millimetres.

    Raises
    ------
    InputError: missing, damaged or incomplete file, a suffix nobody reads, or no faces. The geometry of a face is
        converted, and its faults reported, when it is first asked for.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    read = {
        ".step": _read_step,
        ".stp": _read_step,
        ".igs": _read_iges,
        ".iges": _read_iges,
        ".brep": _read_brep,
    }.get(suffix)
    if read is None and suffix != ".json":
        raise InputError(
            path.name,
            f"suffix {suffix!r}" if suffix else "no suffix",
            "one of .step .stp .igs .iges .brep .json",
            "Export the part in one of these formats.",
        )
    if not (math.isfinite(scale) and scale > 0.0):
        raise InputError(f"{path.name}: scale", str(scale), "a positive number", "Leave the scale out, or correct it.")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            str(path), f"no readable file ({error.strerror})", "a CAD file", "Check the name and the folder."
        ) from None
    if not data.strip():
        raise InputError(path.name, "an empty file", "a CAD file", "Export the part again.")
    sha256 = hashlib.sha256(data).hexdigest()
    if read is None:
        from conflank_cli.cad.nurbs_json import parse_faces

        return Part(path.stem, path.name, parse_faces(data, path.name, scale), sha256, scale)
    with _kernel_silent():
        try:
            shape, looks = read(path, data)
        except _kernel_failures() as error:
            raise _damaged(path.name, f"a file that the reader gives up on ({type(error).__name__})") from error
        faces = _faces(shape, looks, path.name, scale)
    if not faces:
        raise InputError(
            path.name,
            "no faces",
            "at least one face",
            "Export surfaces or solids; wires, points and triangles are not enough.",
        )
    return Part(path.stem, path.name, faces, sha256, scale, partial(triangulate, shape, scale, path.name))


@contextmanager
def _kernel_silent() -> Iterator[None]:
    """The kernel prints to stdout, which carries data only: away with it."""
    from OCP.Message import Message

    Message.DefaultMessenger_s().ChangePrinters().Clear()
    # Some of its parsers write past the messenger.
    try:
        kept = os.dup(1)
    except OSError:
        yield
        return
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(sink)
        os.close(kept)


def _kernel_failures() -> tuple[type[Exception], ...]:
    """What the kernel raises on damaged files."""
    from OCP.Standard import Standard_Failure

    return Standard_Failure, RuntimeError


def _damaged(where: str, found: str) -> InputError:
    return InputError(where, found, "a complete and sound CAD file", "Export the part again, or copy the file again.")


def _read_step(path: Path, data: bytes) -> tuple[Any, _Looks]:
    from OCP.IFSelect import IFSelect_RetDone
    from OCP.Interface import Interface_Static
    from OCP.STEPCAFControl import STEPCAFControl_Reader

    if b"ISO-10303-21" not in data[:2000]:
        raise _damaged(path.name, "no STEP header ISO-10303-21")
    if STEP_END not in re.sub(rb"\s+", b"", data[-2000:]):
        raise _damaged(path.name, "a STEP file that breaks off before END-ISO-10303-21")
    reader = STEPCAFControl_Reader()
    Interface_Static.SetIVal_s("read.stepcaf.subshapes.name", 1)
    Interface_Static.SetCVal_s("xstep.cascade.unit", "MM")
    reader.SetNameMode(True)
    reader.SetColorMode(True)
    document = _document()
    if reader.ReadFile(str(path)) != IFSelect_RetDone:
        raise _damaged(path.name, "a STEP file with syntax errors")
    basic = reader.ChangeReader()
    _refuse_failures(basic.WS().ModelCheckList(True), path.name, only_references=True)
    if basic.NbRootsForTransfer() == 0:
        raise InputError(path.name, "no shape", "at least one face", "Export surfaces or solids.")
    transferred = reader.Transfer(document)
    _refuse_failures(basic.WS().TransferReader().LastCheckList(), path.name, only_references=False)
    if not transferred:
        raise _damaged(path.name, "a STEP file whose shapes cannot be built")
    return basic.OneShape(), _looks(document)


def _read_iges(path: Path, data: bytes) -> tuple[Any, _Looks]:
    from OCP.IFSelect import IFSelect_RetDone
    from OCP.IGESCAFControl import IGESCAFControl_Reader
    from OCP.Interface import Interface_Static

    _check_iges_is_whole(path.name, data)
    reader = IGESCAFControl_Reader()
    Interface_Static.SetCVal_s("xstep.cascade.unit", "MM")
    reader.SetNameMode(True)
    reader.SetColorMode(True)
    document = _document()
    if reader.ReadFile(str(path)) != IFSelect_RetDone:
        raise _damaged(path.name, "an IGES file with syntax errors")
    _refuse_failures(reader.WS().ModelCheckList(True), path.name, only_references=True)
    if reader.NbRootsForTransfer() == 0:
        raise InputError(path.name, "no shape", "at least one face", "Export surfaces or solids.")
    transferred = reader.Transfer(document)
    _refuse_failures(reader.WS().TransferReader().LastCheckList(), path.name, only_references=False)
    if not transferred:
        raise _damaged(path.name, "an IGES file whose shapes cannot be built")
    return reader.OneShape(), _looks(document)


def _check_iges_is_whole(where: str, data: bytes) -> None:
    """The last line of an IGES file counts the lines of each section."""
    lines = [line for line in data.splitlines() if line.strip()]
    last = lines[-1].ljust(80)
    if last[72:73] != b"T":
        raise _damaged(where, "an IGES file that breaks off before its terminate section")
    for place in range(4):
        section, count = last[8 * place : 8 * place + 1], last[8 * place + 1 : 8 * place + 8]
        lines_there = sum(line[72:73] == section for line in lines)
        if count.strip().isdigit() and int(count) != lines_there:
            raise _damaged(where, f"{lines_there} lines in section {section.decode()}, where its end says {int(count)}")


def _read_brep(path: Path, data: bytes) -> tuple[Any, _Looks]:
    from OCP.BRep import BRep_Builder
    from OCP.BRepTools import BRepTools
    from OCP.TopoDS import TopoDS_Shape

    if b"CASCADE Topology V" not in data[:200]:
        raise _damaged(path.name, "no BREP header 'CASCADE Topology'")
    # The last line refers to the root shape: orientation, index, and the index of its placement.
    if not re.search(rb"\n[+-]\d+ \d+\s*$", data):
        raise _damaged(path.name, "a BREP file that breaks off before its root shape")
    shape = TopoDS_Shape()
    if not BRepTools.Read_s(shape, str(path), BRep_Builder()) or shape.IsNull():
        raise _damaged(path.name, "a BREP file that cannot be read")
    return shape, _Looks(lambda shape: "", lambda shape: "")


def _document() -> Any:
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document

    return TDocStd_Document(TCollection_ExtendedString("part"))


def _refuse_failures(checks: Any, where: str, only_references: bool) -> None:
    """Raise for the first failure in a list of checks.

    Parameters
    ----------
    only_references: look only for entities that refer to missing ones. Readers also call annotations and colours that
        they do not know failures, and these do no harm to the geometry.
    """
    checks.Start()
    while checks.More():
        check = checks.Value()
        for i in range(1, check.NbFails() + 1):
            text = check.CFail(i).strip()
            if not only_references or "Unresolved" in text:
                raise _damaged(f"{where}: entity {checks.Number()}" if checks.Number() else where, f"'{text}'")
        for i in range(1, check.NbWarnings() + 1):
            if "not mapped to TopoDS" in check.CWarning(i):
                raise _damaged(f"{where}: entity {checks.Number()}", f"'{check.CWarning(i).strip()}'")
        checks.Next()


def _looks(document: Any) -> _Looks:
    """Names and colours out of a document."""
    from OCP.collections import Sequence_TDF_Label
    from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
    from OCP.TDataStd import TDataStd_Name
    from OCP.TopAbs import TopAbs_FACE
    from OCP.TopExp import TopExp_Explorer
    from OCP.XCAFDoc import (
        XCAFDoc_ColorGen,
        XCAFDoc_ColorSurf,
        XCAFDoc_ColorTool,
        XCAFDoc_DocumentTool,
        XCAFDoc_ShapeTool,
    )

    names: dict[Any, str] = {}
    colours: dict[Any, str] = {}
    inherited: dict[Any, str] = {}

    def look(label: Any) -> None:
        shape = XCAFDoc_ShapeTool.GetShape_s(label)
        if shape.IsNull():
            return
        colour = ""
        found = Quantity_Color()
        for kind in (XCAFDoc_ColorSurf, XCAFDoc_ColorGen):
            if not colour and XCAFDoc_ColorTool.GetColor_s(label, kind, found):
                red, green, blue = (round(255.0 * x) for x in found.Values(Quantity_TypeOfColor.Quantity_TOC_sRGB))
                colour = f"#{red:02x}{green:02x}{blue:02x}"
        explorer = TopExp_Explorer(shape, TopAbs_FACE)
        if shape.ShapeType() == TopAbs_FACE:
            key = _key(shape)
            attribute = TDataStd_Name()
            if label.FindAttribute(TDataStd_Name.GetID_s(), attribute):
                text = attribute.Get().ToExtString().strip()
                if text.lower() not in NO_NAME:
                    names[key] = text
            if colour:
                colours[key] = colour
        elif colour:
            while explorer.More():
                inherited.setdefault(_key(explorer.Current()), colour)
                explorer.Next()

    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    labels = Sequence_TDF_Label()
    tool.GetShapes(labels)
    for i in range(1, labels.Length() + 1):
        parts = Sequence_TDF_Label()
        XCAFDoc_ShapeTool.GetSubShapes_s(labels.Value(i), parts)
        for j in range(1, parts.Length() + 1):
            look(parts.Value(j))
        look(labels.Value(i))
    return _Looks(
        lambda face: names.get(_key(face), ""),
        lambda face: colours.get(_key(face), inherited.get(_key(face), "")),
    )


def _key(shape: Any) -> Any:
    """What two placements of one shape have in common."""
    return shape.TShape()


def _faces(shape: Any, looks: _Looks, file: str, scale: float) -> tuple[PartFace, ...]:
    from OCP.BRepClass3d import BRepClass3d_SolidClassifier
    from OCP.TopAbs import TopAbs_FACE, TopAbs_OUT, TopAbs_REVERSED, TopAbs_SOLID
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    from conflank_cli.cad.conversion import surface_kind

    if shape is None or shape.IsNull():
        return ()
    outside: dict[Any, bool] = {}
    solids = TopExp_Explorer(shape, TopAbs_SOLID)
    while solids.More():
        # Metal that reaches to infinity is a solid turned inside out: its normals tell nothing.
        classifier = BRepClass3d_SolidClassifier(solids.Current())
        classifier.PerformInfinitePoint(INFINITE_POINT_MM)
        known = classifier.State() == TopAbs_OUT
        explorer = TopExp_Explorer(solids.Current(), TopAbs_FACE)
        while explorer.More():
            outside[_key(explorer.Current())] = known
            explorer.Next()
        solids.Next()
    faces: list[PartFace] = []
    explorer = TopExp_Explorer(shape, TopAbs_FACE)
    while explorer.More():
        face = TopoDS.Face(explorer.Current())
        number = len(faces)
        faces.append(
            PartFace(
                number,
                looks.name(face),
                looks.colour(face),
                surface_kind(face),
                outside.get(_key(face), False),
                -1 if face.Orientation() == TopAbs_REVERSED else 1,
                cache(partial(_convert, face, scale, f"{file}: face {number}")),
            )
        )
        explorer.Next()
    return tuple(faces)


def _convert(face: Any, scale: float, where: str) -> FaceGeometry:
    from conflank_cli.cad.conversion import convert_face

    try:
        with _kernel_silent():
            return convert_face(face, scale, where)
    except _kernel_failures() as error:
        raise InputError(
            where,
            f"a face that cannot be converted ({type(error).__name__}: {error})",
            "a sound face",
            "Repair it in CAD.",
        ) from error
