"""Command `import`."""

from __future__ import annotations

from pathlib import Path

from pa10cal.campaign.options import IngestOptions

#: Rows left out that are shown one by one; all of them are in the campaign's left_out.csv.
SHOWN = 10


def import_data(
    dataset: str,
    folder: Path,
    *,
    out: Path,
    any_version: bool = False,
    only: tuple[str, ...] = (),
    settings: IngestOptions = IngestOptions(),
) -> None:
    """Turn a data set of another layout into campaigns.

    Args:
        dataset: name of the data set.
        folder: folder of its files.
        out: folder of campaigns to write to.
        any_version: accept files that are not the published ones, and note it in the provenance.
        only: names of the campaigns to write; all of them unless given.
        settings: section ingest.

    Examples:
        pa10cal import ipa-robot-accuracy data/ipa --out data/raw
    """
    from pa10cal.datasets.campaign_folder import write_campaigns
    from pa10cal.datasets.dataset import AsItIs, dataset_named
    from pa10cal.datasets.importing import import_campaigns
    from pa10cal.errors import RawDataError

    campaigns = import_campaigns(
        dataset_named(dataset),
        folder,
        max_left_out=settings.max_quarantined_fraction,
        any_version=any_version,
    )
    names = [campaign.name for campaign in campaigns]
    if unknown := [name for name in only if name not in names]:
        raise RawDataError(
            "the data set has no such campaign",
            where="--only",
            value=", ".join(unknown),
            allowed=", ".join(names),
            remedy="correct the name",
        )
    campaigns = tuple(each for each in campaigns if not only or each.name in only)
    places = write_campaigns(campaigns, out)
    for campaign, place in zip(campaigns, places, strict=True):
        readings = campaign.readings
        told = (
            f"{readings.path.name}, read as it is"
            if isinstance(readings, AsItIs)
            else f"{len(campaign.left_out)} rows left out"
        )
        parts = [told, *campaign.notes]
        print(f"{place}: {'; '.join(parts)}")
        for row in campaign.left_out[:SHOWN]:
            print(f"  left out: {row.file}:{row.line}: {row.reason} {row.value}".rstrip())
        if len(campaign.left_out) > SHOWN:
            print(f"  … and {len(campaign.left_out) - SHOWN} more in {place / 'left_out.csv'}")
