"""One run: its training, its folder, and what can be done with that afterwards."""
