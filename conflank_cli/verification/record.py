"""What a program is judged against, written down: hashes of the inputs, and what the job asks for."""

from __future__ import annotations

import hashlib
from importlib.resources import files
from pathlib import PurePath

import msgspec

from conflank_cli import __version__
from conflank_cli.job import Job
from conflank_cli.scene import Scene
from conflank_cli.verification.result import Against, FileHash, Limits, Placement, Region

_MACHINES = "postprocessors.machines"
"""The package with the files of shipped machines, which are read as data."""


def against(scene: Scene) -> Against:
    """What every program of a scene is judged against.

    The same for a scene from a job file and for one from an artifact that was made of it. A scene that was made in
    memory has no files: their hashes are None then.
    """
    job = scene.job
    tolerance, margin, setup = job.tolerance, job.obstacles.margin, job.setup
    return Against(
        program_version=__version__,
        part=_file_hash(PurePath(job.part.file).name, scene),
        obstacles=tuple(_file_hash(name, scene) for name in job.obstacles.meshes),
        machine=_machine_hash(job),
        job_sha256=hashlib.sha256(msgspec.json.encode(job, order="sorted")).hexdigest(),
        limits=Limits(
            overcut_mm=tolerance.overcut,
            undercut_mm=tolerance.undercut,
            allowance_mm=tolerance.allowance,
            cutter_mm=margin.cutter,
            shank_mm=margin.shank,
            holder_mm=margin.holder,
            coverage=job.selection.coverage,
        ),
        regions=tuple(
            Region(face.number, design.side, design.region)
            for face, design in zip(scene.faces, job.part.design, strict=True)
        ),
        placement=Placement(
            datum=job.program.datum,
            rotate_deg=setup.rotate_deg,
            translate=setup.translate,
            copies_axis=setup.copies.axis,
            copies_count=setup.copies.count,
            copies=setup.copies.order,
        ),
    )


def _file_hash(name: str, scene: Scene) -> FileHash:
    return FileHash(name, scene.inputs.get(name))


def _machine_hash(job: Job) -> FileHash:
    """The machine's name, and the hash of its file: the text that travels with the job, or that of a shipped one."""
    machine = job.machine
    if machine.definition is not None:
        return FileHash(machine.name, hashlib.sha256(machine.definition.encode("utf-8")).hexdigest())
    # Looked for among the files that there are, so that no name leads out of the folder.
    shipped = {entry.name: entry for entry in files(_MACHINES).iterdir()}
    entry = shipped.get(f"{machine.name}.toml")
    return FileHash(machine.name, None if entry is None else hashlib.sha256(entry.read_bytes()).hexdigest())
