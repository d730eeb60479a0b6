"""What the report of the sample blade weighs, and what a browser makes of it.

Run with ``python -m benchmarks.report OUT`` on a folder that `conflank run` wrote for the sample blade's job. Without a
browser on this machine only the size is measured. The program has fewer poses than the 5,000 that are asked for: its
ways are cut into parts, and the page in the browser is that larger one. Without a graphics card the browser draws with
the processor: pictures a second are those of this machine, whatever else it does.
"""

from __future__ import annotations

import re
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import click
import numpy as np
import numpy.typing as npt
from rich.console import Console

from benchmarks.browser import Browser, browser_program
from benchmarks.verdicts import Verdict, measured, table_console
from conflank_cli.artifacts import read_plan
from conflank_cli.artifacts.npz import decode_coverage
from conflank_cli.formats import post_of
from conflank_cli.report.document import MESH_TRIANGLES, report_html
from conflank_cli.verification.posed import PosedProgram, pose_program
from conflank_cli.verification.poses import Poses
from conflank_cli.verification.result import from_json

POSES = 5000
LARGEST = 3_000_000  # bytes
FIRST_PICTURE = 2.0  # s
OPENINGS = 3
PLAYED = 5.0  # s


def densified(posed: PosedProgram, poses: int) -> PosedProgram:
    """The same program with every way between two poses cut into parts, so that there are at least so many poses."""
    moves = posed.poses.moves
    count = len(moves.block)
    parts = -(-poses // count)
    place = np.concatenate([np.arange(count - 1)[:, None] + np.arange(parts) / parts, [[count - 1.0] * parts]]).ravel()
    owner = np.ceil(place).astype(np.int64)

    def between(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        low = np.floor(place).astype(np.int64)
        share = (place - low).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1.0 - share) * values[low] + share * values[owner])

    dense = replace(
        moves,
        point=between(moves.point),
        rotary=between(moves.rotary),
        vector=between(moves.vector),
        feed=moves.feed[owner],
        rapid=moves.rapid[owner],
        block=moves.block[owner],
        cut=moves.cut[owner],
        tool=moves.tool[owner],
        interpolation=moves.interpolation[owner],
        joined=moves.joined[owner] & (np.arange(len(owner)) > 0),
    )

    def posed_anew(old: Poses) -> Poses:
        return replace(old, tip=between(old.tip), axis=between(old.axis), moves=dense)

    return replace(posed, poses=posed_anew(posed.poses), by_copy=tuple(posed_anew(each) for each in posed.by_copy))


def measure(out: Path, console: Console) -> tuple[list[Verdict], dict[str, Any]]:
    """Size of the page, time to the first picture, pictures a second."""
    data = (out / "plan.npz").read_bytes()
    scene = read_plan(out / "plan.npz").scene
    name = scene.job.program.name + post_of(scene.job).suffix
    text = (out / name).read_bytes().decode("ascii")
    verification = from_json((out / f"{name}.verification.json").read_bytes())
    posed = densified(pose_program(text, scene), POSES)
    start = time.process_time()
    page = report_html(scene, posed, text, verification, decode_coverage(data, "plan.npz"))
    seconds = time.process_time() - start
    size = len(page.encode())
    poses, sweeps = len(posed.poses.tip), len(verification.sweeps)
    what = f"{sweeps} sweeps, {MESH_TRIANGLES} triangles of the faces and {len(scene.check.triangles)} of the rest"
    verdicts = [
        Verdict(f"size, {poses} poses, {what}", "≤ 3.0 MB", f"{size / 1e6:.2f} MB", size <= LARGEST),
        Verdict("processor time to write it", "", f"{seconds:.1f} s", True),
    ]
    figures: dict[str, Any] = {"bytes": size, "poses": poses, "seconds": seconds}
    if browser_program() is None:
        console.print("no browser here: only the size is measured")
        return verdicts, figures
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "report.html"
        path.write_text(page, "utf-8")
        first = []
        for _ in range(OPENINGS):
            with Browser() as browser:
                browser.open(path)
                browser.settle()
                first.append(browser.run("conflank.firstPicture()") / 1e3)
                browser.run("conflank.play()")
                # What stands still is drawn for once before.
                first_moved = browser.run("conflank.pictures()") + 3
                while browser.run("conflank.pictures()") < first_moved:
                    time.sleep(0.05)
                before = browser.run("conflank.pictures()")
                begun, spent = time.perf_counter(), browser.processor_seconds()
                time.sleep(PLAYED)
                drawn = browser.run("conflank.pictures()") - before
                rate = drawn / (time.perf_counter() - begun)
                each = (browser.processor_seconds() - spent) / max(drawn, 1)
                moved = browser.run("conflank.index()")
                messages = browser.messages
    verdicts += [
        Verdict("first picture after opening, median of 3", "≤ 2 s", f"{median(first):.2f} s",
                median(first) <= FIRST_PICTURE),
        Verdict("errors and warnings of the page", "0", str(len(messages)), not messages),
        Verdict("poses passed while playing 5 s", "> 0", str(moved), moved > 0),
        Verdict("pictures a second, drawn by the processor", "", f"{rate:.1f}", True),
        Verdict("processor time of a picture while playing", "", f"{1e3 * each:.0f} ms", True),
    ]  # fmt: skip
    return verdicts, figures | {"first_picture_s": first, "pictures_a_second": rate, "seconds_a_picture": each}


@click.command()
@click.argument("out", type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(out: Path) -> None:
    """Measure the report of the run in OUT."""
    console = table_console()
    load = re.split(r"\s", Path("/proc/loadavg").read_text())[0] if Path("/proc/loadavg").exists() else "?"
    console.print(f"load of the machine {load}")
    measured(console, "report", {"report": lambda: measure(out, console)}, None)


if __name__ == "__main__":
    main()
