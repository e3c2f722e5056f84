"""A campaign of faults against the running graph; see campaign.py."""
