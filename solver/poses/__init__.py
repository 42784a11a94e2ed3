"""Which poses tell most: selection with a certificate."""
