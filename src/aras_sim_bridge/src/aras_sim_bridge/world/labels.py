"""Numbers of links in label images, as Bullet has them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .model import Model


def make_label(body: int, index: int) -> int:
    """Of a link of a body by its index, -1 the root."""
    return body + ((index + 1) << 24)


def list_links_by_label(models: Mapping[str, Model]) -> dict[int, str]:
    """'model::link' by number, of models by name."""
    return {
        make_label(model.body_id, index): model.get_scoped_name(link)
        for model in models.values()
        for link, index in model.link_indices.items()
    }
