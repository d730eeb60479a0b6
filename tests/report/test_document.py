"""The report as a file: what is in it, read back by a decoder of the test's own."""

import base64
import json
import re
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from conflank_cli.report import document
from conflank_cli.report.document import report_html
from conflank_cli.report.gap_map import face_grid, grid_shape
from conflank_cli.scene import Scene
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.posed import pose_program
from conflank_cli.verification.reader import read_program
from tests.report.test_gap_map import FACE, lying_cone
from tests.verification.scenes import T1, scene_of, triangles_of

PAGE = Path(document.__file__).parent / "page"


def page_of(scene: Scene, text: str) -> str:
    return report_html(scene, pose_program(text, scene), text, verify_program(text, scene, "TEST.H", 2000))


def scene() -> Scene:
    """The plane with a wall beside it and a block from elsewhere; 10 um are allowed."""
    wall = triangles_of([(0, 40, 0), (30, 40, 0), (30, 40, 9), (0, 40, 9)])
    block = triangles_of([(0, -20, 0), (30, -20, 0), (30, -20, 9), (0, -20, 9)], face=-1)
    both = type(wall)(
        np.concatenate([wall.vertices, block.vertices]),
        np.concatenate([wall.triangles, block.triangles + np.int32(len(wall.vertices))]),
        np.concatenate([wall.face, block.face]),
    )
    return scene_of(FACE, check=both)


@pytest.fixture(scope="module")
def page() -> str:
    return page_of(scene(), lying_cone(-0.004))


def script(page: str, name: str) -> str:
    found = re.search(rf'<script type="[^"]*" id="{name}">(.*?)</script>', page, re.S)
    assert found
    return found[1]


def arrays_of(page: str) -> tuple[dict, dict[str, np.ndarray]]:
    report = json.loads(script(page, "report"))
    raw = zlib.decompress(base64.b64decode(script(page, "arrays")))
    arrays = {}
    for name, entry in report["arrays"].items():
        size = int(entry["type"][1])
        planes = np.frombuffer(raw, np.uint8, entry["bytes"], entry["offset"]).reshape(size, -1)
        values = np.ascontiguousarray(planes.T).view(f"<{entry['type']}").reshape(-1)
        if entry.get("differences"):
            values = np.cumsum(values, dtype=values.dtype)
        if "step" in entry:
            values = entry["low"] + values.reshape(-1, 3) * entry["step"]
        arrays[name] = values
    return report, arrays


class Elements(HTMLParser):
    """Tags with their attributes; scripts and styles are opaque to it as they are to a browser."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "input", "br", "option", "li"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("option", "li"):
            assert self.open.pop() == tag


def elements(page: str) -> list[tuple[str, dict[str, str | None]]]:
    parser = Elements()
    parser.feed(page)
    assert parser.open == []
    return parser.found


def test_equal_inputs_give_equal_bytes(page: str) -> None:
    assert page_of(scene(), lying_cone(-0.004)) == page


def test_nothing_is_asked_of_a_network(page: str) -> None:
    for tag, attributes in elements(page):
        for name in ("src", "href", "action"):
            assert (attributes.get(name) or "data:").startswith("data:"), (tag, attributes)
    assert "@import" not in page and "url(" not in (PAGE / "page.css").read_text("utf-8")


def test_poses_are_those_of_the_reader(page: str) -> None:
    _, arrays = arrays_of(page)
    program = read_program(lying_cone(-0.004))
    poses = pose_program(lying_cone(-0.004), scene()).poses
    assert np.array_equal(arrays["tip"].reshape(-1, 3), poses.tip)
    assert np.array_equal(arrays["axis"].reshape(-1, 3), poses.axis)
    assert np.array_equal(arrays["block"], program.moves.block)
    assert np.array_equal(arrays["cut"], program.moves.cut)
    # 20 mm at 1000 mm/min, and a few milliseconds to speed up and brake.
    assert 1.2 < arrays["seconds"][program.moves.cut == 0].sum() < 1.21
    assert bytes(arrays["text"]).decode() == lying_cone(-0.004)


def test_the_gap_is_there_and_what_is_around(page: str) -> None:
    report, arrays = arrays_of(page)
    (face,) = report["faces"]
    gap = arrays["face0_gap"].reshape(face["grid"]) * report["gap_step_um"]
    x = np.linspace(0.0, 30.0, face["grid"][0])
    assert gap[(x > 5.0) & (x < 25.0), : face["grid"][1] // 2] == pytest.approx(-4.0, abs=0.011)
    assert gap[0, -1] > 10.0
    assert arrays["face0_inside"].min() == 255
    assert arrays["rest_vertices"][:, 1] == pytest.approx(40.0)
    assert arrays["obstacle_vertices"][:, 1] == pytest.approx(-20.0)
    assert len(arrays["rest_triangles"]) == len(arrays["obstacle_triangles"]) == 6
    assert report["tolerance"] == {"overcut_um": 10.0, "undercut_um": 10.0}
    flute = np.array(report["tools"][0]["parts"][0]["profile"])
    assert flute[0] == pytest.approx([0.0, 0.0]) and flute[-1, 1] == pytest.approx(T1.r_max)
    assert [part["kind"] for part in report["tools"][0]["parts"]] == ["flute", "shank", "holder"]


def test_every_cut_has_its_row_and_switches(page: str) -> None:
    layers = [attributes["data-layer"] for _, attributes in elements(page) if "data-layer" in attributes]
    assert {"ruled:0", "patch:0", "cutter", "holder", "path", "rapids", "places", "obstacles", "uncovered"} == set(
        layers
    )
    assert "sweep 1</button>" in page and "<td>20.00</td>" in page


def test_passes_stand_apart_from_sweeps() -> None:
    text = lying_cone(0.0).replace("; SWEEP 1", "; PASS 1")
    page = page_of(scene(), text)
    kinds = [attributes["data-kind"] for tag, attributes in elements(page) if tag == "section"]
    assert kinds == ["pass"]
    layers = [attributes.get("data-layer", "") for _, attributes in elements(page)]
    assert "patch:0" in layers and "ruled:0" not in layers
    assert "by sweeps alone" in page and "0.00 %" in page


def test_findings_jump_to_their_place() -> None:
    text = lying_cone(-0.05)
    page = page_of(scene(), text)
    verification = verify_program(text, scene(), "TEST.H", 2000)
    report, arrays = arrays_of(page)
    gouge = next(k for k, finding in enumerate(verification.findings) if finding.code == "CF201")
    place = report["places"][gouge]
    assert place["finding"] and place["point"] == list(verification.findings[gouge].place)
    assert arrays["block"][place["pose"]] == verification.findings[gouge].block
    assert f'data-place="{gouge}"' in page and "CF201 gouge" in page


def test_names_are_names_and_no_markup() -> None:
    odd = scene_of(FACE)
    odd = replace(odd, part_name="</script><b>x", inputs={"a&b.step": "0"})
    page = page_of(odd, lying_cone(0.0))
    assert "<b>x" not in page
    assert "&lt;/script&gt;&lt;b&gt;x" in page and "a&amp;b.step" in page
    assert json.loads(script(page, "report"))["part"] == "</script><b>x"


def test_a_program_without_a_pose_has_a_report_too() -> None:
    page = page_of(scene_of(FACE), "0 BEGIN PGM X MM\r\n1 END PGM X MM\r\n")
    report, arrays = arrays_of(page)
    assert len(arrays["block"]) == 0 and report["cuts"] == []
    assert "CF111" in page


def test_a_face_too_narrow_for_the_grid_has_a_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """A strip of a hundredth of a millimetre across the box of another."""
    strips = (np.array([[0.0, 2.0], [30.0, 29.99], [30.0, 30.0], [0.0, 2.01]]),)
    narrow = scene_of(replace(FACE, loops=strips))
    report, _ = arrays_of(page_of(narrow, lying_cone(0.0)))
    assert report["faces"][0]["normal"] == [0.0, 0.0, 1.0]
    grid = face_grid(replace(FACE, loops=(strips[0] * [1.0, 0.0] + [0.0, 16.0 + 1e-7],)), (5, 4))
    assert not grid.inside.any() and grid.about.all()


def test_grids_are_as_fine_as_asked_within_limits() -> None:
    assert grid_shape(FACE, 0.5, 10, 1000) == (60, 56)
    assert grid_shape(FACE, 0.5, 10, 50) == (50, 50)
    assert grid_shape(FACE, 10.0, 24, 50) == (24, 24)


def test_the_script_is_small_and_carries_its_licence() -> None:
    assert len((PAGE / "viewer.js").read_bytes()) <= 700_000
    assert b"MIT License" in (PAGE / "three-LICENSE.txt").read_bytes()
    text = (PAGE / "viewer.js").read_text("utf-8")
    assert "</script" not in text
    assert "Three.js Authors" in text and "SPDX-License-Identifier: MIT" in text
