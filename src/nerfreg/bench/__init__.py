"""Error against run time of what nerfreg computes: the work-precision diagrams of `nerfreg bench`."""
