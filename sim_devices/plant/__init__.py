"""Nature: the mechanism, its flaws and its noise, as they really are."""
