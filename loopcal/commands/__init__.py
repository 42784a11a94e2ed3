"""The verbs of `loopcal` with their options and help, a file for each part of the work."""
