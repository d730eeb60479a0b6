"""What a verification says that it was made against: each input by its own hash, and the same however it is called."""

from dataclasses import replace
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import pytest

import conflank_cli
from conflank_cli.artifacts.npz import decode_contents, encode_artifact
from conflank_cli.job import Copies, Design, Job, Machine, Margin, Obstacles, Program, Selection, Setup, Tolerance
from conflank_cli.scene import Scene
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.record import against
from conflank_cli.verification.result import Against, FileHash
from tests.verification.scenes import plane_face, scene_of

INPUTS = {"part.step": "a" * 64, "f/one.stl": "b" * 64, "two.stl": "c" * 64}


def scene(**tables: Any) -> Scene:
    """A scene of two faces whose inputs have hashes, with other tables in its job."""
    base = scene_of(plane_face((0.0, 9.0), (0.0, 5.0)), plane_face((0.0, 9.0), (0.0, 5.0), number=4))
    job: Job = msgspec.structs.replace(base.job, **tables)
    return replace(base, job=job, inputs=INPUTS)


def changed(one: Against, other: Against) -> set[str]:
    """Names of the parts of a record that differ, the job's hash apart."""
    return {name for name in Against.__struct_fields__ if getattr(one, name) != getattr(other, name)} - {"job_sha256"}


def test_every_input_has_its_hash() -> None:
    found = against(scene(obstacles=Obstacles(("f/one.stl", "two.stl"))))
    assert found.part == FileHash("part.step", "a" * 64)
    assert found.obstacles == (FileHash("f/one.stl", "b" * 64), FileHash("two.stl", "c" * 64))
    machine = files("postprocessors.machines").joinpath("ac-table.toml").read_bytes()
    assert found.machine == FileHash("ac-table", sha256(machine).hexdigest())
    assert found.program_version == conflank_cli.__version__


def test_a_machine_of_ones_own_is_hashed_as_its_file() -> None:
    text = 'name = "mine"\r\n# Fräskopf\r\n'
    found = against(scene(machine=Machine(name="mine", file="mine.toml", definition=text)))
    assert found.machine == FileHash("mine", sha256(text.encode()).hexdigest())


@pytest.mark.parametrize("name", ["none", "", "../ac-table", "ac-table.toml", "../machines/ac-table", "/etc/passwd"])
def test_no_machine_name_leads_out_of_the_folder(name: str) -> None:
    assert against(scene(machine=Machine(name=name))).machine.sha256 is None


def test_what_was_made_in_memory_has_no_hash() -> None:
    assert against(replace(scene(), inputs={})).part == FileHash("part.step", None)


CHANGES: dict[str, tuple[dict[str, Any], set[str]]] = {
    "overcut": ({"tolerance": Tolerance(0.011, 0.01)}, {"limits"}),
    "undercut": ({"tolerance": Tolerance(0.01, 0.011)}, {"limits"}),
    "allowance": ({"tolerance": Tolerance(0.01, 0.01, 0.2)}, {"limits"}),
    "coverage": ({"selection": Selection(coverage=0.8)}, {"limits"}),
    "margin to the cutter": ({"obstacles": Obstacles(margin=Margin(cutter=0.3))}, {"limits"}),
    "margin to the shank": ({"obstacles": Obstacles(margin=Margin(shank=0.3))}, {"limits"}),
    "margin to the holder": ({"obstacles": Obstacles(margin=Margin(holder=0.3))}, {"limits"}),
    "an obstacle": ({"obstacles": Obstacles(("two.stl",))}, {"obstacles"}),
    "another machine": ({"machine": Machine("bc-table")}, {"machine"}),
    "datum": ({"program": Program(datum=2)}, {"placement"}),
    "shift": ({"program": Program(datum=(1.0, 2.0, 3.0))}, {"placement"}),
    "turned": ({"setup": Setup((1.0, 0.0, 0.0))}, {"placement"}),
    "moved": ({"setup": Setup(translate=(0.0, 0.0, 1.0))}, {"placement"}),
    "copies": ({"setup": Setup(copies=Copies(count=3))}, {"placement"}),
    "where the datum stands": ({"machine": Machine(zero=(1.0, 2.0, 3.0))}, set()),
    "safe distance": ({"program": Program(name="OTHER")}, set()),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_changes_is_seen(name: str) -> None:
    """In the hash of the job whatever it is, and under its own key where it says what is right."""
    tables, keys = CHANGES[name]
    before, after = against(scene()), against(scene(**tables))
    assert changed(before, after) == keys
    assert before.job_sha256 != after.job_sha256


def test_the_copies_that_are_cut_are_named() -> None:
    found = against(scene(setup=Setup(copies=Copies(count=24, only=(5, 2))))).placement
    assert (found.copies_count, found.copies) == (24, (5, 2))


def test_regions_are_those_of_the_faces() -> None:
    base = scene()
    designs = (Design("blade", region=(0.0, 0.5, 0.0, 1.0)), Design(4, "inside"))
    part = msgspec.structs.replace(base.job.part, design=designs)
    found = against(scene(part=part)).regions
    assert [(each.face, each.side, each.region) for each in found] == [
        (0, "outside", (0.0, 0.5, 0.0, 1.0)),
        (4, "inside", (0.0, 1.0, 0.0, 1.0)),
    ]


def test_an_artifact_and_its_job_give_one_record() -> None:
    whole = scene(
        obstacles=Obstacles(("f/one.stl",)),
        program=Program(datum=(1.0, 2.0, 3.5), tool_numbers={"T1": 7}, options={"b": "2", "a": "1"}),
        machine=Machine("mine", "mine.toml", 'name = "mine"\r\n', (1.0, 2.0, 3.0), {"T1": 172.4}),
    )
    read = decode_contents(encode_artifact("plan", whole, [], {}), "plan.npz").scene
    assert msgspec.json.encode(against(read)) == msgspec.json.encode(against(whole))


def test_the_order_of_free_keys_is_no_difference() -> None:
    one, other = (scene(program=Program(options=options)) for options in ({"a": "1", "b": "2"}, {"b": "2", "a": "1"}))
    assert against(one) == against(other)


def test_a_verification_holds_it(tmp_path: Path) -> None:
    own = scene()
    text = "0 BEGIN PGM EMPTY MM\n1 END PGM EMPTY MM\n"
    assert verify_program(text, own, points_per_face=100).against == against(own)
    pattern = scene(setup=Setup(copies=Copies(count=3)))
    assert verify_program(text, pattern, points_per_face=100).against == against(pattern)
