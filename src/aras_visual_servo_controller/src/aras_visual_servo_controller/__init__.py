"""Visual servoing of the ARAS robot."""
