"""Verbs for recordings as files: what is in one, how well it is, repair, and other formats."""
