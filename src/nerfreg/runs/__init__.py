"""One run: its training, its folder, and what can be done with that afterwards.

What a verb of the command line does is one function here:

- `train`: train, score at times that are evenly spaced on a logarithmic scale, and save everything.
- `evaluate`: score a run's checkpoint again.
- `render`: render test views, or videos along a camera path.
- `replay`: render a step that training left out again, and show what is not finite.
- `citations`: the sources of everything that a run used.

These are made of:

- `load`: the machine's threads and device, and a run read back from its folder.
- `files`: the names of the files in a run's folder.
- `results`: what `results.json` and `metrics.jsonl` hold.
- `pictures`: rendered test views for scoring, and pictures of them.
- `recording`: the file of a step that training left out.

Nothing here imports a tool (sweeps, checks, prune, reports, bench); they build on this package.
"""
