"""STEP files (AP214) with named faces, byte for byte the same whenever the geometry is the same."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from OCP.collections import Sequence_TDF_Label
from OCP.IFSelect import IFSelect_RetDone
from OCP.Interface import Interface_Static
from OCP.Message import Message
from OCP.STEPCAFControl import STEPCAFControl_Reader, STEPCAFControl_Writer
from OCP.STEPControl import STEPControl_AsIs
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.XCAFDoc import XCAFDoc_DocumentTool
from solids import NamedSolid, faces_of

TIME_STAMP = "2020-01-01T00:00:00"
"""Any fixed moment: a STEP header must have one, and equal geometry must give equal bytes."""


def _document() -> TDocStd_Document:
    return TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))


def step_text(part: NamedSolid, product: str) -> str:
    """The STEP file of a solid; the names of its faces become the names of their ADVANCED_FACE entities."""
    Message.DefaultMessenger_s().ChangePrinters().Clear()
    document = _document()
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    label = shapes.AddShape(part.shape, False)
    TDataStd_Name.Set_s(label, TCollection_ExtendedString(product))
    for name, face in part.named():
        if name:
            TDataStd_Name.Set_s(shapes.AddSubShape(label, face), TCollection_ExtendedString(name))
    writer = STEPCAFControl_Writer()
    Interface_Static.SetCVal_s("write.step.schema", "AP214IS")
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    Interface_Static.SetCVal_s("write.step.product.name", product)
    Interface_Static.SetIVal_s("write.stepcaf.subshapes.name", 1)
    # Readers rebuild curves in parameter space from the curves in space; without them the file is a third smaller.
    Interface_Static.SetIVal_s("write.surfacecurve.mode", 0)
    writer.SetNameMode(True)
    if not writer.Transfer(document, STEPControl_AsIs):
        raise RuntimeError(f"{product}: Open CASCADE could not translate the solid to STEP.")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.step"
        if writer.Write(str(path)) != IFSelect_RetDone:
            raise RuntimeError(f"{product}: Open CASCADE could not write the STEP file.")
        text = path.read_text(encoding="ascii")
    return _without_circumstance(text, product)


def _without_circumstance(text: str, product: str) -> str:
    """Replace what depends on when and with which release the file was written."""
    header = (
        f"FILE_NAME('{product}','{TIME_STAMP}',('conflank'),('conflank'),\n  'conflank sample parts','conflank','');"
    )
    text, found = re.subn(r"FILE_NAME\(.*?\);", header, text, count=1, flags=re.DOTALL)
    if found != 1:
        raise RuntimeError(f"{product}: the STEP file has no FILE_NAME entry.")
    return re.sub(r"'Open CASCADE STEP translator [^']*'", f"'{product}'", text)


def read_step(path: Path) -> NamedSolid:
    """Read a file written by `step_text`, with the names of its faces."""
    Message.DefaultMessenger_s().ChangePrinters().Clear()
    document = _document()
    # The reader's constructor registers the parameter; before it, setting the value has no effect.
    reader = STEPCAFControl_Reader()
    Interface_Static.SetIVal_s("read.stepcaf.subshapes.name", 1)
    reader.SetNameMode(True)
    if reader.ReadFile(str(path)) != IFSelect_RetDone or not reader.Transfer(document):
        raise RuntimeError(f"{path}: not a STEP file that Open CASCADE can read.")
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    free = Sequence_TDF_Label()
    shapes.GetFreeShapes(free)
    shape = shapes.GetShape_s(free.Value(1))
    subs = Sequence_TDF_Label()
    shapes.GetSubShapes_s(free.Value(1), subs)
    known = []
    for sub in subs:
        name = TDataStd_Name()
        if sub.FindAttribute(TDataStd_Name.GetID_s(), name):
            known.append((name.Get().ToExtString(), shapes.GetShape_s(sub)))
    names = (next((name for name, other in known if face.IsSame(other)), "") for face in faces_of(shape))
    return NamedSolid(shape, tuple(names))
