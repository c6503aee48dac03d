"""A campaign: many independent cases, adjusted one after the other or on a cluster, with a record of what is done."""

from mgsgraph.campaign.record import AS_WRITTEN as AS_WRITTEN
from mgsgraph.campaign.record import Entry as Entry
from mgsgraph.campaign.record import Wishes as Wishes
from mgsgraph.campaign.run import Campaign as Campaign
from mgsgraph.campaign.run import run_campaign as run_campaign
