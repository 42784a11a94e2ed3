"""From averaged poses to parameters: maximum likelihood, and the two papers' own methods."""
