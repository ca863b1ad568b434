"""Fly Vigil's campaigns on a Ray cluster (docs/cluster.md)."""

from vigil_cluster.driver import CampaignError, fly

__all__ = ["CampaignError", "fly"]
