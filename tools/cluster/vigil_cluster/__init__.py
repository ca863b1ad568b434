"""Fly Vigil's campaigns on a Ray cluster (docs/cluster.md)."""

from vigil_cluster.campaign import Campaign, CampaignError

__all__ = ["Campaign", "CampaignError"]
