"""Numbers (labels) that identify links in label images, as in Bullet's segmentation masks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .model import Model


def make_label(body: int, index: int) -> int:
    """Return the label of a link from Bullet's body id and link index (-1 for a root)."""
    return body + ((index + 1) << 24)


def list_links_by_label(models: Mapping[str, Model]) -> dict[int, str]:
    """Return the name 'model::link' of each label."""
    return {
        make_label(model.body_id, index): model.get_scoped_name(link)
        for model in models.values()
        for link, index in model.link_indices.items()
    }
