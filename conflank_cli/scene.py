"""The scene: everything a stage needs to know besides the sweeps. It travels inside every artifact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.job import Job
from conflank_cli.once import Once
from conflank_cli.tool import Tool


def _no_faces() -> Once[tuple[DesignFace, ...]]:
    return Once(tuple)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The resolved job with the geometry it speaks of.

    A scene is equal to itself alone, so that what is made of it can be kept: see `Screen.of`.

    Attributes
    ----------
    job: the whole resolved job.
    part_name: name of the part for program headers.
    faces: the design faces in the job's order, regions cut out, sides resolved.
    tools: the tools of the drawer in the job's order.
    mesh: what nothing may touch (empty arrays for none), made when first asked for: faces are there before it.
    inputs: SHA-256 of every input file by file name.
    rest: what is left of design faces outside their regions, in pieces with the face's number; it may be cut no deeper
        than the design face itself.
    surfaces: the CAD surfaces behind the triangles of `mesh` that come from the part, made when first asked for; a face
        that cannot be converted has its triangles alone.
    """

    job: Job
    part_name: str
    faces: tuple[DesignFace, ...]
    tools: tuple[Tool, ...]
    mesh: Once[CheckMesh]
    inputs: Mapping[str, str]
    rest: tuple[DesignFace, ...] = ()
    surfaces: Once[tuple[DesignFace, ...]] = field(default_factory=_no_faces)

    @property
    def check(self) -> CheckMesh:
        """What nothing may touch. Raises what making its triangles raises."""
        return self.mesh()

    @property
    def neighbours(self) -> tuple[DesignFace, ...]:
        """The faces of the part that nothing may touch, as CAD surfaces, where they are known."""
        return self.surfaces()

    def checking(self, mesh: CheckMesh) -> Scene:
        """The scene with something else that nothing may touch."""
        return replace(self, mesh=Once(lambda: mesh))
