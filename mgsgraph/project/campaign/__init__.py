"""A campaign: many independent cases, adjusted one after the other or on a cluster, with a record of what is done."""
