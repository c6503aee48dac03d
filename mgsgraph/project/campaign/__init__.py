"""A campaign: many independent cases, adjusted one after the other or on a cluster, with a record of what is done."""

from mgsgraph.project.campaign.record import AS_WRITTEN as AS_WRITTEN
from mgsgraph.project.campaign.record import CampaignEntry as CampaignEntry
from mgsgraph.project.campaign.record import Overrides as Overrides
from mgsgraph.project.campaign.run import Campaign as Campaign
from mgsgraph.project.campaign.run import run_campaign as run_campaign
