"""Error and cost against run time of what nerfreg computes: `nerfreg bench`."""
