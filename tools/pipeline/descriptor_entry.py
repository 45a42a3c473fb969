"""The place descriptor as a manifest names it."""

from __future__ import annotations

from maslam.descriptors.base import PlaceDescriptor
from maslam.mas.manifest import DescriptorEntry


def descriptor_entry(model: PlaceDescriptor) -> DescriptorEntry:
    """Its entry: what must be the same for all agents of a team."""
    return DescriptorEntry(
        name=model.name,
        sha256=model.sha256,
        dim=model.dim,
        threshold=model.candidate_threshold,
        strict_threshold=model.threshold,
        min_std=model.min_std,
    )
