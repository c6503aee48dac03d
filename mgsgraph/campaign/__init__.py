"""A campaign: many independent cases, adjusted one after the other or on a cluster, with a record of what is done."""

from mgsgraph.campaign.entry import AS_WRITTEN as AS_WRITTEN
from mgsgraph.campaign.entry import Entry as Entry
from mgsgraph.campaign.entry import Wishes as Wishes
from mgsgraph.campaign.run import Campaign as Campaign
from mgsgraph.campaign.run import run_campaign as run_campaign
