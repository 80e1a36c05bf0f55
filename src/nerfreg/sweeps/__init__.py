"""Many runs by one command: each fails for itself, and what is complete is not done again."""
