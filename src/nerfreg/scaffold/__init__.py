"""A new package with a regularizer in it, from templates (`nerfreg new-plugin`)."""
