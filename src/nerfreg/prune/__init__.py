"""`nerfreg prune`: which regularizers a scene can do without, judged on training views that are held out."""
