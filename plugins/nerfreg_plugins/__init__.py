"""The regularizers that come with nerfreg, one module each.

They are registered by entry points, as those of any other package are.
"""
