from __future__ import annotations

import msgspec
import pytest
from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeSphere, BRepPrimAPI_MakeTorus

from conflank_cli.cad.inspection import describe
from conflank_cli.cad.reader import read_part
from tests.cad import shapes


def test_curvatures_of_closed_forms(tmp_path):
    solid = shapes.compound(
        BRepPrimAPI_MakeSphere(4.0).Shape(),
        BRepPrimAPI_MakeTorus(10.0, 2.0).Shape(),
        BRepPrimAPI_MakeCylinder(5.0, 7.0).Shape(),
    )
    reports = describe(read_part(shapes.write_step(solid, tmp_path / "part.step")))
    by_kind = {report.kind: report for report in reports}
    sphere, torus, cylinder = (by_kind[kind] for kind in ("sphere", "torus", "cylinder"))
    assert sphere.curvature.least == pytest.approx(-0.25, rel=1e-6)
    assert sphere.curvature.greatest == pytest.approx(-0.25, rel=1e-6)
    assert sphere.size == pytest.approx((8.0, 8.0, 8.0), abs=0.05)
    # Across the tube -1/r; along the ring from 1/(R + r) bulging to 1/(R - r) hollow.
    assert torus.curvature.least == pytest.approx(-0.5, rel=1e-6)
    assert torus.curvature.greatest == pytest.approx(1.0 / 8.0, rel=1e-2)
    assert torus.closes_u and torus.closes_v
    assert cylinder.curvature.least == pytest.approx(-0.2, rel=1e-6)
    assert cylinder.curvature.high == pytest.approx(0.0, abs=1e-9)
    assert cylinder.closes_u and not cylinder.closes_v
    assert all(report.outside_known for report in reports)
    data = msgspec.json.decode(msgspec.json.encode(reports))
    assert [face["number"] for face in data] == list(range(5))


def test_a_bad_face_does_not_hide_the_others(tmp_path):
    path = shapes.write_brep(BRepPrimAPI_MakeCylinder(5.0, 7.0).Shape(), tmp_path / "part.brep")
    part = read_part(path)
    # Radius of the jacket struck out: its surface line is "2 x y z ... radius".
    lines = path.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("Surfaces"))
    jacket = next(i for i in range(at + 1, len(lines)) if lines[i].startswith("2 "))
    words = lines[jacket].split()
    lines[jacket] = " ".join([*words[:-1], "0"])
    path.write_text("\n".join(lines) + "\n")
    reports = describe(read_part(path))
    assert len(reports) == len(part.faces) == 3
    assert [bool(report.problem) for report in reports] == [True, False, False]
    assert reports[0].curvature is None
