"""A data set's folder to campaigns: nothing missing, read, and held against what is published."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pa10cal.datasets.checksums import Differing, differing_files, refusal_of, refuse_missing
from pa10cal.datasets.dataset import DataSet, ImportedCampaign


def import_campaigns(
    dataset: DataSet, folder: Path, *, max_left_out: float, any_version: bool
) -> tuple[ImportedCampaign, ...]:
    """Read the campaigns of a data set.

    The content is read before the checksums are judged, since a message about a line says more
    than one about a file.

    Args:
        dataset: which.
        folder: the folder of its files.
        max_left_out: part of a file's rows that may be left out.
        any_version: whether files that are not the published ones will do; the provenance of the
            campaigns made of them then says so.

    Raises:
        RawDataError: when files are missing, cannot be read, or are not the published ones.
    """
    refuse_missing(folder, dataset.files)
    published = dataset.published
    differing: tuple[Differing, ...] = ()
    if published is not None:
        read = {name: published.sha256[name] for name in dataset.files}
        differing = differing_files(folder, read)
    campaigns = dataset.read(folder, max_left_out)
    if published is None or not differing:
        return campaigns
    if not any_version:
        raise refusal_of(
            differing,
            published.version,
            "fetch the data set again, or import it as it is with --any-version",
        )
    return tuple(_told(campaign, folder, differing) for campaign in campaigns)


def _told(
    campaign: ImportedCampaign, folder: Path, differing: tuple[Differing, ...]
) -> ImportedCampaign:
    """Describe a campaign which of its files are not the published ones."""
    own = {str(folder / file) for file in campaign.files}
    clauses = [
        f"{Path(each.place).name} is not the published file (SHA-256 {each.found})"
        for each in differing
        if each.place in own
    ]
    if not clauses:
        return campaign
    told = f"{campaign.provenance} But {'; '.join(clauses)}."
    return replace(campaign, provenance=told, notes=(*campaign.notes, *clauses))
