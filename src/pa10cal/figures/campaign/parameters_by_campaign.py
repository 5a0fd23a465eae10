"""Which campaign of a group determines which parameter, and whether they agree."""

from __future__ import annotations

from pa10cal.figures.parameter_names import written
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.results import Results
from pa10cal.figures.table import Table, figures, frame_of, shown

PICTURE = Picture(
    title="Parameters by campaign",
    needs=("general",),
    caption="""
The parameters of the robot that all campaigns of ``{name}`` share, each with its standard
uncertainty by all of them together and by each campaign alone, with base, tool and targets its
own. A parameter that one campaign leaves open may be determined by another. The second table
holds each campaign against all others: the chi-square of what they differ by, and the one
parameter that explains most of it.
""",
)

_UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3)}


def tabulate(results: Results) -> Table:
    """Return where every shared parameter comes from, and each campaign against the others."""
    group = results.general().group
    if group is None:
        raise NothingToShowError("it is one campaign")
    names = tuple(group.campaigns)
    rows, cells = [], []
    for name, found in group.parameters.items():
        unit, scale = _UNITS.get(found.unit, (found.unit, 1.0))
        alone = [found.std_alone[each] for each in names]
        by = ", ".join(found.determined_by) or "all together"
        rows.append((name, found.unit, figures(found.std, 4), *(figures(x, 4) for x in alone), by))
        told = [
            f"{scale * x:.4f}" if each in found.determined_by else "–"
            for each, x in zip(names, alone, strict=True)
        ]
        cells.append((written(name), unit, f"{scale * found.std:.4f}", *told, by))
    compared = []
    for name, each in group.campaigns.items():
        unit, scale = _UNITS.get(each.worst.unit, (each.worst.unit, 1.0))
        off, u = scale * each.worst.value, scale * each.worst.std
        compared.append(
            (
                name,
                str(each.poses),
                f"{each.rms_mm:.3f}",
                f"{each.alone_rms_mm:.3f}",
                f"{each.chi_square:.1f} for {each.dof:.0f}",
                f"{each.p_value:.2g}",
                f"{written(each.worst.name)}: {off:.3g} ± {u:.2g} {unit}",
                "yes" if each.contradicts else "no",
            )
        )
    header = ("parameter", "unit", "std", *(f"std {name}" for name in names), "determined by")
    against = ("campaign", "poses", "rms [mm]", "alone [mm]", "χ²", "p", "most by", "contradicts")
    return Table(
        title="Parameters by campaign",
        data=frame_of(header, rows),
        shown=(shown(header, cells), shown(against, compared, "Each campaign against the others")),
        notes=(
            "std: one standard uncertainty; a dash where the campaign alone does not determine "
            "the parameter. The CSV is in SI units.",
            "Campaigns contradict each other where chance does not explain the difference and "
            "parameters of its own take away a tenth of a campaign's squared error.",
        ),
    )
