"""Make the sample parts: `python make_parts.py [blisk_blade|impeller]...`, or `--facts` to print their surface facts.

Equal formulas give equal bytes: running this twice changes nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from blade_surfaces import Array, evaluate
from blisk_blade import fitted_patches, make_blisk_blade
from blisk_law import BliskLaw
from impeller import fitted_sides, make_impeller
from impeller_law import ImpellerLaw
from solids import NamedSolid, area, is_valid, volume
from step_file import read_step, step_text

from conflank_cli.geometry.surface import BSplineSurface

HERE = Path(__file__).resolve().parent
PARTS: dict[str, Callable[[], NamedSolid]] = {
    "blisk_blade": lambda: make_blisk_blade(BliskLaw()),
    "impeller": lambda: make_impeller(ImpellerLaw()),
}


def part_path(name: str) -> Path:
    """Where the STEP file of a part lies."""
    return HERE / name / f"{name}.step"


def curvatures(surface: BSplineSurface, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Both principal curvatures (1/mm, ascending, normal along S_u x S_v) and the area element on the grid u x v.

    Source: do Carmo, Differential Geometry of Curves and Surfaces (1976), section 3-3.
    """
    s_u, s_v = evaluate(surface, u, v, 1, 0), evaluate(surface, u, v, 0, 1)
    cross = np.cross(s_u, s_v)
    element = np.linalg.norm(cross, axis=-1)
    normal = cross / element[..., None]

    def dot(a: Array, b: Array) -> Array:
        return np.asarray(np.sum(a * b, axis=-1))

    e, f, g = dot(s_u, s_u), dot(s_u, s_v), dot(s_v, s_v)
    second = [dot(evaluate(surface, u, v, *order), normal) for order in ((2, 0), (1, 1), (0, 2))]
    gaussian = (second[0] * second[2] - second[1] ** 2) / element**2
    mean = (e * second[2] - 2.0 * f * second[1] + g * second[0]) / (2.0 * element**2)
    root = np.sqrt(np.maximum(mean**2 - gaussian, 0.0))
    return mean - root, mean + root, element


def design_surfaces() -> dict[tuple[str, str], BSplineSurface]:
    """The bicubic surfaces behind the design faces, by part and face."""
    flanks, _ = fitted_patches(BliskLaw())
    sides = fitted_sides(ImpellerLaw())
    return {
        (part, name): surfaces[name]
        for part, surfaces in (("blisk_blade", flanks), ("impeller", sides))
        for name in ("pressure", "suction")
    }


def facts() -> str:
    """A table of the design faces, as Markdown."""
    rows = [
        "| part | face | poles | area mm² | principal curvatures 1/mm | share of saddle points |",
        "|---|---|---|---|---|---|",
    ]
    solids = {name: read_step(part_path(name)) for name in PARTS}
    grid = np.linspace(0.0, 1.0, 201)
    for (part, face), surface in design_surfaces().items():
        # The impeller's surfaces are larger than the faces; x, h in [0, 1] is the blade up to its half thickness.
        low, high, element = curvatures(surface, grid, grid)
        saddle = float(np.sum(element * (low * high < 0.0)) / np.sum(element))
        rows.append(
            f"| {part} | {face} | {surface.poles.shape[0]} × {surface.poles.shape[1]} "
            f"| {area(solids[part].face(face)):.1f} "
            f"| {low.min():.4f} … {low.max():.4f}, {high.min():.4f} … {high.max():.4f} | {100.0 * saddle:.1f} % |"
        )
    for name, solid in solids.items():
        rows.append("")
        rows.append(
            f"{name}: {len(solid.names)} faces, volume {volume(solid.shape):.1f} mm³, "
            f"{'valid' if is_valid(solid.shape) else 'NOT valid'}."
        )
    return "\n".join(rows)


def main() -> None:
    """Write the parts named on the command line (all by default), or print the facts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="part", help=f"{' or '.join(PARTS)}; default: all")
    parser.add_argument("--facts", action="store_true", help="print a table of the surfaces instead of writing files")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.parts) - set(PARTS))
    if unknown:
        parser.error(f"no part named {', '.join(unknown)}; there are {', '.join(PARTS)}")
    if arguments.facts:
        print(facts())
        return
    for name in arguments.parts or PARTS:
        part_path(name).write_text(step_text(PARTS[name](), name), encoding="ascii", newline="\n")


if __name__ == "__main__":
    main()
