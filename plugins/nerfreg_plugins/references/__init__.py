"""Exact twins of the losses in mpmath numbers, for `nerfreg check` to compare with.

One module for each regularizer, with functions named after what they repeat. They take and return
(nested lists of) mpmath numbers, follow the formula literally, and leave it to the 150 digits that
`nerfreg check` sets to outlast every cancellation. They import no regularizer.
"""
