"""Fault injection into the running graph; see campaign.py."""
