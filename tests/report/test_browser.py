"""The report in a browser, where there is one: `make test-all` runs these."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.browser import Browser, browser_program
from conflank_cli.verification.posed import pose_program
from tests.report.test_document import page_of, scene
from tests.report.test_gap_map import lying_cone

TEXT = lying_cone(-0.05)
HERE = browser_program() is not None


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(page_of(scene(), TEXT), "utf-8")
    return path


@pytest.fixture(scope="module")
def browser(page: Path) -> Iterator[Browser]:
    with Browser() as found:
        found.open(page)
        yield found
        assert found.messages == []
        assert found.requests == [page.resolve().as_uri()]


if HERE:

    @pytest.mark.slow
    def test_the_sliders_pose_is_the_readers(browser: Browser) -> None:
        poses = pose_program(TEXT, scene()).poses
        assert browser.run("conflank.count") == len(poses.tip)
        for index in range(len(poses.tip)):
            browser.run(f"document.querySelector('#pose').value = {index}")
            browser.run("document.querySelector('#pose').dispatchEvent(new Event('input'))")
            pose = browser.run(f"conflank.pose({index})")
            assert browser.run("conflank.index()") == index
            assert pose["tip"] == poses.tip[index].tolist() and pose["axis"] == poses.axis[index].tolist()
            assert pose["block"] == poses.moves.block[index]
            drawn = np.array(browser.run("conflank.cutter()"))
            assert drawn[:3] == pytest.approx(poses.tip[index], abs=1e-9)
            # The quaternion turns z into the axis.
            x, y, z, w = drawn[3:]
            turned = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
            assert turned == pytest.approx(poses.axis[index], abs=1e-6)

    @pytest.mark.slow
    def test_switching_changes_what_is_seen(browser: Browser) -> None:
        browser.run("conflank.seek(2)")
        for layer in ("ruled:0", "path", "rapids", "places", "cutter", "obstacles"):
            seen = {}
            for on in ("true", "false"):
                browser.run(f"conflank.show('{layer}', {on})")
                browser.settle()
                assert browser.run(f"conflank.visible('{layer}')") is (on == "true")
                seen[on] = browser.picture()
            assert seen["true"] != seen["false"] or layer in ("obstacles", "rapids")
        browser.run("conflank.show('cutter', true)")
        browser.settle()
        before = browser.run("conflank.colours(0)")
        browser.run("conflank.show('patch:0', false)")
        browser.settle()
        without = browser.run("conflank.colours(0)")
        assert before != without and {tuple(without[k : k + 3]) for k in range(0, len(without), 4)} == {(141, 143, 147)}
        browser.run("conflank.show('patch:0', true)")
        browser.settle()
        assert browser.run("conflank.colours(0)") == before

    @pytest.mark.slow
    def test_a_finding_jumps_to_its_block(browser: Browser) -> None:
        browser.run("conflank.seek(conflank.count - 1)")
        browser.run("document.querySelector('[data-place]').click()")
        places = browser.run("JSON.parse(document.querySelector('#report').textContent).places")
        assert browser.run("conflank.index()") == places[0]["pose"] < browser.run("conflank.count") - 1
        assert browser.run("conflank.visible('places')") is True

    @pytest.mark.slow
    def test_keys_are_enough(browser: Browser) -> None:
        browser.run("document.querySelector('#pose').focus(); conflank.seek(1)")
        browser.press("ArrowRight")
        assert browser.run("conflank.index()") == 2
        browser.run("document.querySelector('#view').focus()")
        browser.settle()
        before = browser.run("conflank.pictures()")
        browser.press("ArrowLeft")
        browser.settle()
        assert browser.run("conflank.pictures()") > before
        browser.run("document.querySelector('#play').focus()")
        browser.press(" ")
        assert browser.run("conflank.playing()") is True
        browser.run("conflank.pause()")

    @pytest.mark.slow
    def test_without_webgl_there_are_still_pictures_and_words(page: Path) -> None:
        with Browser(webgl=False) as still:
            still.open(page)
            still.settle()
            assert not still.run("conflank.moves()")
            assert "no WebGL" in still.run("document.body.innerText")
            assert still.run("document.querySelector('#view').offsetHeight") == 0
            # Something is drawn, and it is another picture in another colouring.
            drawn = "document.querySelector('#still').toDataURL()"
            first = still.run(drawn)
            still.run("document.querySelector('#mode').value = 'cut'")
            still.run("document.querySelector('#mode').dispatchEvent(new Event('change'))")
            still.settle()
            assert len(first) > 5000 and still.run(drawn) != first
            still.run("document.querySelector('#pose').value = 1")
            still.run("document.querySelector('#pose').dispatchEvent(new Event('input'))")
            assert still.run("conflank.index()") == 1
            assert still.messages == []

    @pytest.mark.slow
    def test_the_cutter_alone_is_drawn_while_it_moves_and_all_at_rest(browser: Browser) -> None:
        """What is kept of the rest does not show: at rest the picture is that of the same pose reached otherwise."""
        rest = "new Promise((done) => setTimeout(() => requestAnimationFrame(done), 600))"
        browser.run("conflank.seek(0)")
        browser.run(rest)
        first = browser.picture()
        browser.run("conflank.seek(conflank.count - 1)")
        browser.settle()
        assert browser.picture() != first
        browser.run("conflank.seek(0)")
        browser.run(rest)
        assert browser.picture() == first
        count = browser.run("conflank.pictures()")
        browser.run(rest)
        assert browser.run("conflank.pictures()") == count

    @pytest.mark.slow
    def test_it_is_dark_where_that_is_preferred(browser: Browser) -> None:
        paper = "getComputedStyle(document.body).backgroundColor"
        browser.scheme("light")
        assert browser.run(paper) == "rgb(255, 255, 255)"
        browser.scheme("dark")
        assert browser.run(paper) == "rgb(20, 24, 30)"
        browser.run("document.querySelector('#theme').click()")
        assert browser.run(paper) == "rgb(255, 255, 255)"
        browser.run("document.querySelector('#theme').click()")
