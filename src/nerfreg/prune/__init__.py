"""`nerfreg prune`: which regularizers a scene can do without, by held-out training views."""
