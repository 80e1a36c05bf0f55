"""The regularizers that come with nerfreg, one file each; registered by entry points, as anybody's are."""
